"""What a run of the benchmark leaves behind: table.csv, details.csv, figures, and lines on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from data.command_line import say
from evaluation.recovery import details, grips, scores, slabs
from evaluation.recovery.evaluate import OK, Recovery
from evaluation.recovery.grips import GripRecovery
from evaluation.recovery.scores import Bound, Scores
from evaluation.recovery.slabs import SlabRecovery
from evaluation.recovery.store import replace_text
from evaluation.tables import to_cell, to_csv
from physics.ownership import replacing_own
from results.store import OutputError, writing

SHOWN_FAILURES = 8
TABLE_WIDTH = 150
"""Width of the printed table where there is no terminal."""


def finish(rows: Sequence[Recovery], output: Path, console: Console, status: int, bound: Bound = Bound()) -> int:  # noqa: B008 (immutable)
    """Write and print what there is; returns the exit status.

    Args:
        rows: results in the order of tables.
        output: folder of the results.
        console: says what was not estimated.
        status: exit status so far.
        bound: what errors are compared with.
    """
    if not rows:
        return status or 1
    judged = scores.score_all(rows, bound)
    try:
        table = write_results(output, judged)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    show(table, judged, console)
    say(console, f"written: {output}/table.csv, details.csv, figures/")
    if not any(row.status == OK for row in rows):
        say(console, "No clip could be estimated.", "red")
        return status or 1
    return status


def finish_grips(rows: Sequence[GripRecovery], output: Path, console: Console, status: int) -> int:
    """Write and print what there is of suites of grips; returns the exit status.

    Args:
        rows: results.
        output: folder of the results.
        console: says what was not estimated.
        status: exit status so far.
    """
    return _finish_table(rows, grips.grip_rows(rows), grips.COLUMNS, output / "grips.csv", console, status)


def finish_slabs(rows: Sequence[SlabRecovery], output: Path, console: Console, status: int) -> int:
    """The same of suites of slabs."""
    return _finish_table(rows, slabs.slab_rows(rows), slabs.COLUMNS, output / "slabs.csv", console, status)


def _finish_table(
    rows: Sequence[GripRecovery | SlabRecovery],
    cells: Sequence[Mapping[str, object]],
    columns: Sequence[str],
    path: Path,
    console: Console,
    status: int,
) -> int:
    if not rows:
        return status or 1
    try:
        replace_text(path, to_csv(cells, columns, ".6g"))
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    table = Table(*columns)
    for row in cells:
        table.add_row(*(to_cell(row.get(name), ".3g") for name in columns))
    Console(stderr=True, width=None if console.is_terminal else TABLE_WIDTH).print(table)
    for row in [row for row in rows if row.status != OK][:SHOWN_FAILURES]:
        say(console, f"  {row.suite}, clip {row.index}: {row.status}, {row.reason}", "yellow")
    say(console, f"written: {path}")
    return status


def write_results(output: Path, judged: Sequence[Scores]) -> list[dict[str, object]]:
    """Write tables and figures; returns the rows of `table.csv`.

    Raises:
        OutputError: they can't be written.
    """
    from evaluation.recovery.figures import figures

    rows = [row for item in judged for row in scores.table_rows(item)]
    replace_text(output / "table.csv", to_csv(rows, scores.COLUMNS, ".6g"))
    more = [row for item in judged for row in details.detail_rows(item)]
    replace_text(output / "details.csv", to_csv(more, details.COLUMNS, ".6g"))
    with writing(output):
        (output / "figures").mkdir(exist_ok=True)
        for name, figure in figures(judged):
            with replacing_own(output / "figures" / name) as partial:
                figure.savefig(partial)
    return rows


def show(rows: Sequence[dict[str, object]], judged: Sequence[Scores], console: Console) -> None:
    """Print the table, and what could not be estimated."""
    table = Table(*scores.COLUMNS)
    for row in rows:
        if row["n"]:
            table.add_row(*(to_cell(cell, ".3g") for cell in row.values()))
    # A pipe has no width of its own, and 80 columns would cut the names.
    Console(stderr=True, width=None if console.is_terminal else TABLE_WIDTH).print(table)
    for item in judged:
        total = len(item.rows) + len(item.failed)
        text = f"{item.estimator} on {item.suite}: {len(item.rows)} of {total} clips estimated, σ {item.noise[0]:.3g}"
        say(console, text)
        for row in item.failed[:SHOWN_FAILURES]:
            say(console, f"  clip {row.index} ({row.regime}): {row.status}, {row.reason}", "yellow")
        if len(item.failed) > SHOWN_FAILURES:
            reasons = dict(Counter(row.status for row in item.failed))
            say(console, f"  {len(item.failed)} in all: {reasons}", "yellow")
