"""Tables that doors write, read again."""

import csv
from pathlib import Path


def read_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file, their columns in its order."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def read_measures(path: Path) -> dict[tuple[str, str], str]:
    """Values of a table of measures, by the case's name and the measure's."""
    rows = read_rows(path)
    name, *others = rows[0]
    assert others == ["measure", "value"]
    return {(row[name], row["measure"]): row["value"] for row in rows}
