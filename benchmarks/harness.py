"""Parts that every evaluation shares: an experiment maps a case to dictionaries, and the rest stands here once.

An `Experiment` is a frozen dataclass whose fields are its options. `run` reads them from the command line, does the
cases that no earlier run has done, and writes the tables that the experiment makes of all rows. It keeps every row of
results as a line of results.jsonl, so that the same command continues an interrupted run.
"""

import json
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.common.command_line import progress_bars, say
from palpate.common.doors import INTERRUPTED, interruptible, plain
from palpate.common.files import as_json, read_file
from palpate.common.options import options
from palpate.common.output import require_own, write_own
from palpate.common.provenance import code_digest
from palpate.common.tables import to_cell
from palpate.common.workers import WorkerLost, run_tasks
from palpate.data.source.layout import InputError, read_mapping
from palpate.models.onnx_session import ModelFileError
from palpate.results.store import RECORD, OutputError, make_output, writing

RESULTS = "results.jsonl"
MOST_BYTES = 2**27
"""Largest size of a file of results; tens of thousands are smaller."""
OK = "ok"
"""Status of a case without a problem."""

Row = dict[str, Any]
"""Results of one case by name: texts, numbers and arrays; what does not exist is left out."""


@dataclass(frozen=True)
class Report:
    """Summary that an experiment makes of its rows."""

    tables: Mapping[str, pd.DataFrame]
    """Tables by the name of their file."""
    shown: Sequence[pd.DataFrame] = ()
    """Tables that are printed."""
    lines: Sequence[tuple[str, str]] = ()
    """Lines on the terminal, each with its style."""
    failed: bool = False
    """True if the program ends with status 1."""


@dataclass(frozen=True)
class Experiment:
    """Experiment that `run` runs. Its fields are options; it raises a ValueError where they don't belong together.

    A field `workers` is the number of processes; 0 = in this one, as without it.
    """

    output: Path
    """folder of the results"""

    keys: ClassVar[tuple[str, ...]] = ("file",)
    """Fields of a row that identify it."""
    work: ClassVar[Callable[[Any], list[Row]]]
    """Function from a case to its rows, importable by its name; a case that breaks something has a row that says so."""
    writes: ClassVar[Sequence[str]] = ("table.csv",)
    """Names of files known before the work, which may not replace a user's."""

    @property
    def wanted(self) -> Collection[Any]:
        """Keys of the cases, where each has one row."""
        raise NotImplementedError

    def record(self) -> Mapping[str, Any]:
        """Everything that results depend on, as `Store` takes it."""
        return {}

    def cases(self, done: Mapping[tuple, Row]) -> tuple[list[Any], int]:
        """Cases that are left, each the experiment and a key; and the number of all cases."""
        return [(self, key) for key in self.wanted if key not in done], len(self.wanted)

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """Summaries written of all rows in the folder, which may be more than this run asks for."""
        raise NotImplementedError


def run(kind: type[Experiment], arguments: Sequence[str] | None, program: str, documentation: str | None) -> int:
    """Run an experiment from the command line.

    Args:
        kind: class of the experiment.
        arguments: command line; None = the program's own.
        program: name of the program.
        documentation: text of `--help`.

    Returns:
        Exit status: 0 done; 1 failed; 2 wrong usage; 130 interrupted.
    """
    experiment: Experiment = options(kind, arguments, program, documentation)
    console = Console(stderr=True)
    refused = (InputError, ModelFileError, OutputError, WorkerLost)  # what ends any experiment with a sentence
    try:
        with writing(experiment.output):
            require_own(*(experiment.output / name for name in experiment.writes))
        store = Store(experiment.output, experiment.record(), experiment.keys)
    except refused as error:
        say(console, str(error), "red")
        return 2
    status = 0
    try:
        with interruptible(), progress_bars(console) as progress:
            cases, total = experiment.cases(store.rows)
            bar = progress.add_task("cases", total=total, completed=total - len(cases))
            for rows in run_tasks(kind.work, cases, getattr(experiment, "workers", 0)):
                store.append(rows)
                progress.advance(bar)
    except KeyboardInterrupt:
        say(console, "Interrupted; what is finished is kept, and the same command continues.", "yellow")
        status = INTERRUPTED
    except refused as error:
        say(console, f"{error} What is finished is kept.", "red")
        status = 1
    if not store.rows:
        return status or 1
    report = experiment.report(store.rows)
    try:
        names = write(experiment.output, report)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    for frame in report.shown:
        show(frame)
    for text, style in report.lines:
        say(console, text, style)
    say(console, f"written: {experiment.output}/{', '.join(names)}")
    return status or int(report.failed)


class Store:
    """Rows of one folder.

    Args:
        output: the folder; made when it is not there.
        wanted: record of everything the results depend on, JSON-able. A later run may leave out or add
            entries, but common ones must be equal.
        keys: fields that tell a row from all others.

    Raises:
        OutputError: the folder can't be used, or holds results that depend on something else.
        InputError: its record can't be read.
    """

    def __init__(self, output: Path, wanted: Mapping[str, Any], keys: tuple[str, ...]) -> None:
        self.output, self._keys, self._results = output, keys, output / RESULTS
        make_output(output)
        wanted = json.loads(as_json({"code": code_digest(), **wanted}))
        path = output / RECORD
        with writing(output):
            require_own(path)
        recorded = read_mapping(path, "a record of a benchmark") if path.exists() else {}
        for name, value in wanted.items():
            if recorded.get(name, value) != value:
                raise OutputError(f"{output}: holds results of another {name}; choose another --output.")
        self.rows: dict[tuple, Row] = {}
        """Rows by their key, in the order in which they came."""
        if self._results.exists():
            with writing(output):  # a killed run leaves a last line without its end
                os.truncate(self._results, read_file(self._results, MOST_BYTES).rfind(b"\n") + 1)
            self.rows = read_results(self._results, keys)
        with writing(output):
            write_own(path, as_json({**recorded, **wanted}, indent=2) + "\n")

    def append(self, rows: Iterable[Row]) -> None:
        """Keep rows, each in place of one of the same key; they are on disk when this returns."""
        lines = [as_json(row) for row in rows]
        with writing(self.output), self._results.open("a", encoding="utf-8") as file:
            file.write("".join(f"{line}\n" for line in lines))
            file.flush()
            os.fsync(file.fileno())
        self.rows |= dict(_parsed(line, self._keys) for line in lines)


def _parsed(line: str | bytes, keys: tuple[str, ...]) -> tuple[tuple, Row]:
    """Key and row of a line: lists are arrays, null is NaN in a list, and else left out."""
    row = {name: value for name, value in json.loads(line).items() if value is not None}
    for name, value in row.items():
        if isinstance(value, list):
            array = np.array(value)
            row[name] = array.astype(np.float64) if array.dtype == object else array
    return tuple(row[name] for name in keys), row


def read_results(path: Path, keys: tuple[str, ...]) -> dict[tuple, Row]:
    """Rows of a file by what tells them from others, the last one of each key.

    Raises:
        OutputError: a line is not a row.
        OSError: the file can't be read.
    """
    found: dict[tuple, Row] = {}
    for number, line in enumerate(read_file(path, MOST_BYTES).splitlines(), 1):
        try:
            key, row = _parsed(line, keys)
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
            problem = f"{path}: line {number} is not a result"
            raise OutputError(f"{problem}; remove it or choose another --output.") from error
        found[key] = row
    return found


def write(output: Path, report: Report) -> list[str]:
    """Write tables; returns their names.

    Raises:
        OutputError: they can't be written, or a user's file is there.
    """
    with writing(output):
        require_own(*(output / name for name in report.tables))
        for name, frame in report.tables.items():
            write_own(output / name, csv_of(frame))
    return [*report.tables]


def csv_of(frame: pd.DataFrame) -> str:
    """A table as CSV: six digits, and empty cells for what doesn't exist."""
    return frame.map(lambda value: to_cell(value, ".6g")).to_csv(index=False, lineterminator="\n")


def show(frame: pd.DataFrame) -> None:
    """Print a table."""
    console = Console()
    table = Table(*map(str, frame.columns))
    for row in frame.itertuples(index=False):
        table.add_row(*(Text(plain(to_cell(cell, ".3g"))) for cell in row))
    # Width of a printed table where there is no terminal: a pipe has none of its own, and 80 columns would cut names.
    Console(width=None if console.is_terminal else 150).print(table)


def attempted(work: Callable[[], Row]) -> Row:
    """Result of some work, or the reason for none: an error in one case is a result, and the others go on."""
    try:
        with interruptible():
            return work()
    except Exception as error:
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        return {"status": "error", "reason": reason}


def measured(case: tuple[str, str, Callable[[], Row]]) -> list[Row]:
    """Measures of one case, by name, or the reason for none as a sentence: the other cases go on."""
    key, name, work = case
    row = attempted(work)
    return [{key: name, **({"status": row["reason"]} if "reason" in row else row)}]


@dataclass(frozen=True)
class Measurements(Experiment):
    """Base of experiments that measure one file, or the like, after the other; table.csv has a row for every measure.

    `wanted` names the cases. A measure `status` that isn't OK is the sentence that says what failed.
    """

    work: ClassVar = staticmethod(measured)

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Measurements to make, by the name of each case, in the order of the table."""
        raise NotImplementedError

    def cases(self, done: Mapping[tuple, Row]) -> tuple[list[Any], int]:
        """Cases without measures; what failed is tried again."""
        known, wanted = {name for (name,), row in done.items() if row.get("status", OK) == OK}, self.wanted
        return [(*self.keys, *case) for case in wanted.items() if case[0] not in known], len(wanted)

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """The table, and what failed."""
        (key,), found = self.keys, [rows[name,] for name in self.wanted if (name,) in rows]
        cells = [(row[key], name, value) for row in found for name, value in row.items() if name != key]
        frame = pd.DataFrame(cells, columns=(key, "measure", "value"))
        failed = [(f"{row[key]}: {row['status']}", "red") for row in found if row.get("status", OK) != OK]
        return Report({"table.csv": frame}, [frame], failed, failed=bool(failed))
