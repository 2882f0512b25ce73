"""Tables as CSV."""

import csv
import io
from collections.abc import Mapping, Sequence


def to_csv(rows: Sequence[Mapping[str, object]], columns: Sequence[str] | None = None, form: str = "") -> str:
    """Return rows as CSV; what doesn't exist, or is not a number, stays empty.

    Args:
        rows: cells by column.
        columns: in order; None = those of the first row.
        form: of numbers, as `format` takes it; empty = all their digits.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, columns or list(rows[0]), restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: to_cell(value, form) for key, value in row.items()} for row in rows)
    return text.getvalue()


def to_cell(value: object, form: str = "") -> str:
    """Return a value as text: numbers as `format` takes them, empty where there is none."""
    if value is None or value != value:
        return ""
    return format(value, form) if isinstance(value, float) else str(value)
