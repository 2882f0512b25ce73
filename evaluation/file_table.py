"""What every file of other people's data gives: table.csv (file, measure, value), written anew as each is done."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from rich.console import Console

from palpate.common.command_line import path_option, say
from palpate.common.doors import interruptible
from palpate.common.output import replacing_own, require_own
from palpate.common.tables import to_csv
from palpate.data.source.layout import InputError
from palpate.results.store import writing

COLUMNS = ("file", "measure", "value")


def folder_parser(program: str, documentation: str | None) -> argparse.ArgumentParser:
    """Command line of a door that judges the files under a folder."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {program}",
        description=documentation,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 all files judged; 1 some could not be; 2 wrong usage; 130 interrupted.",
    )
    parser.add_argument("--data", type=path_option, required=True, metavar="DIR", help="folder of the data")
    parser.add_argument("--output", type=path_option, required=True, metavar="OUT", help="folder of the table")
    return parser


class FileTable:
    """Rows of table.csv. A file that can't be judged has one that says why, and the others go on.

    Args:
        output: folder of the table.
        console: for what went wrong.

    Raises:
        OutputError: a table that this program did not write is there, or nothing can be written.
    """

    def __init__(self, output: Path, console: Console) -> None:
        self.rows: list[dict[str, object]] = []
        self.status = 0
        """Exit status so far."""
        self._file, self._console = output / "table.csv", console
        with writing(output):
            require_own(self._file)

    def judge(self, name: str, work: Callable[[], Mapping[str, object]]) -> None:
        """Add the measures that some work gives for a file, or why it gives none.

        Raises:
            OutputError: the table can't be written.
        """
        try:
            with interruptible():
                measures = work()
        except Exception as error:  # of one file; the others' answers must not be lost
            told = str(error) if isinstance(error, ValueError) else f"failed ({type(error).__name__}: {error})"
            measures, self.status = {"status": told}, 1
            say(self._console, told if isinstance(error, InputError) else f"{name}: {told}", "red")
        self.add(name, measures)

    def add(self, name: str, measures: Mapping[str, object]) -> None:
        """Add measures of a file, or of several.

        Raises:
            OutputError: the table can't be written.
        """
        self.rows.extend({"file": name, "measure": measure, "value": value} for measure, value in measures.items())
        with writing(self._file.parent):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with replacing_own(self._file) as partial:
                partial.write_text(to_csv(self.rows, COLUMNS, ".6g"), encoding="utf-8")

    def show(self) -> None:
        """Print all rows."""
        for row in self.rows:
            value = row["value"]
            print(f"{row['file']}: {row['measure']}: {f'{value:.4g}' if isinstance(value, float) else value}")
        say(self._console, f"written: {self._file}")
