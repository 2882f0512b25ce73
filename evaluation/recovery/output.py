"""What a run of the benchmark leaves behind: table.csv, details.csv, figures, and lines on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from data.command_line import say
from evaluation.recovery import details as recovery_details
from evaluation.recovery import scores as recovery_scores
from evaluation.recovery.scores import Scores, table_rows
from evaluation.recovery.store import replace_text
from evaluation.tables import to_csv
from results.store import writing

SHOWN_FAILURES = 8
TABLE_WIDTH = 150
"""Width of the printed table where there is no terminal."""


def write_results(output: Path, scores: Sequence[Scores]) -> list[dict[str, object]]:
    """Write tables and figures; returns the rows of `table.csv`.

    Raises:
        OutputError: they can't be written.
    """
    from evaluation.recovery.figures import figures

    rows = [row for item in scores for row in table_rows(item)]
    replace_text(output / "table.csv", to_csv(rows, recovery_scores.COLUMNS, ".6g"))
    details = [row for item in scores for row in recovery_details.detail_rows(item)]
    replace_text(output / "details.csv", to_csv(details, recovery_details.COLUMNS, ".6g"))
    with writing(output):
        (output / "figures").mkdir(exist_ok=True)
        for name, figure in figures(scores):
            figure.savefig(output / "figures" / name)
    return rows


def show(rows: Sequence[dict[str, object]], scores: Sequence[Scores], console: Console) -> None:
    """Print the table, and what could not be estimated."""
    table = Table(*recovery_scores.COLUMNS)
    for row in rows:
        if row["n"]:
            cells = [row[name] for name in recovery_scores.COLUMNS]
            table.add_row(
                *(f"{cell:.3g}" if isinstance(cell, float) else str("" if cell is None else cell) for cell in cells)
            )
    # A pipe has no width of its own, and 80 columns would cut the names.
    Console(stderr=True, width=None if console.is_terminal else TABLE_WIDTH).print(table)
    for item in scores:
        total = len(item.rows) + len(item.failed)
        line = (
            f"{item.estimator} on {item.suite}: {len(item.rows)} of {total} clips estimated, σ {item.noise.sigma:.3g}"
        )
        say(console, line)
        reasons = Counter(row.status for row in item.failed)
        for row in item.failed[:SHOWN_FAILURES]:
            text = f"  clip {row.index} ({row.regime}): {row.status}, {row.reason}"
            say(console, text, "yellow")
        if len(item.failed) > SHOWN_FAILURES:
            say(console, f"  {len(item.failed)} in all: {dict(reasons)}", "yellow")
