"""Results of the benchmark on disk: a line each, appended as clips are done, so that an interrupted run continues."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.recovery.evaluate import Recovery
from evaluation.recovery.grips import GripRecovery
from evaluation.recovery.slabs import SlabRecovery
from physics.files import as_json, read_file, replacing
from physics.ownership import replacing_own
from physics.provenance import code_digest
from results.store import OutputError, writing

RESULTS = "results.jsonl"
FILES: dict[type, str] = {Recovery: RESULTS, GripRecovery: "grips.jsonl", SlabRecovery: "slabs.jsonl"}
"""By the kind of results."""
RECORD = "run.json"
FORMAT_VERSION = 4
MOST_BYTES = 2**27
"""Of a file of results; tens of thousands are smaller."""
BEGINNING = b'{"suite": "'
"""Of every line of results."""


class RecoveryStore:
    """Results of one folder, of one kind.

    Args:
        output: the folder; made when it is not there.
        kind: of the results, one of `FILES`; each has a file of its own.
        wanted: what the results depend on, JSON-able. A later run may leave a part out or add one, but what both have
            must be the same.

    Raises:
        OutputError: the folder can't be used, or holds results that depend on something else.
    """

    def __init__(self, output: Path, wanted: Mapping[str, Any], kind: type = Recovery) -> None:
        self.output = output
        self._results = output / FILES[kind]
        with writing(output):
            if output.exists() and not output.is_dir():
                raise OutputError(f"{output}: is a file; give a folder as --output.")
            output.mkdir(parents=True, exist_ok=True)
        code, wanted = code_digest(), json.loads(as_json({"format": FORMAT_VERSION, **wanted}))
        recorded = self._recorded()
        for name, value in wanted.items():
            if recorded.get(name, value) != value:
                raise OutputError(
                    f"{output}: holds results of another {name}; run with the same arguments or choose another "
                    "--output."
                )
        with writing(output):
            if self._results.exists():
                _cut_unfinished(self._results)
        self.rows = read_results(self._results, kind) if self._results.exists() else []
        """Results in the order in which they came."""
        self.outdated = bool(self.rows) and recorded.get("code", code) != code
        """Whether earlier results come from another version of the program."""
        with writing(output), replacing(output / RECORD) as partial:
            partial.write_text(as_json({"code": code, **recorded, **wanted}, indent=2) + "\n", encoding="utf-8")

    @property
    def done(self) -> set[tuple[str, int, str]]:
        """Suite, clip and estimator of every result."""
        return {row.key for row in self.rows}

    def append(self, rows: Iterable[Recovery | GripRecovery | SlabRecovery]) -> None:
        """Keep results that are not there yet; they are on disk when this returns."""
        done = self.done
        rows = [row for row in rows if row.key not in done]
        text = "".join(as_json(vars(row)) + "\n" for row in rows)
        with writing(self.output), self._results.open("a", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        self.rows += rows

    def _recorded(self) -> dict[str, Any]:
        path = self.output / RECORD
        if not path.exists():
            if self._results.exists():
                raise OutputError(f"{self.output}: holds results without {RECORD}; choose another --output.")
            return {}
        try:
            record = json.loads(read_file(path))
        except (OSError, ValueError, RecursionError) as error:
            raise OutputError(f"{path}: is not readable; remove the folder or choose another --output.") from error
        if not isinstance(record, dict) or not {"code", "format", "seed"} <= set(record):
            raise OutputError(f"{path}: belongs to something else; choose another --output.")
        return record


def read_results(path: Path, kind: type = Recovery) -> list[Any]:
    """Results of a file, all of one kind, each once, in the order in which they came.

    Raises:
        OutputError: a line is not a result.
        OSError: the file can't be read.
    """
    found: dict[tuple[str, int, str], Any] = {}
    for number, line in enumerate(read_file(path, MOST_BYTES).splitlines(), 1):
        try:
            known: dict[str, Any] = {
                name: np.array(value) if isinstance(value, list) else value
                for name, value in json.loads(line).items()
                if value is not None
            }
            row = kind(**known)
            found.setdefault(row.key, row)
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise OutputError(
                f"{path}: line {number} is not a result; remove that line or choose another --output."
            ) from error
    return list(found.values())


def _cut_unfinished(path: Path) -> None:
    """Remove a last line that a killed run left without its end; one that doesn't begin as ours do stays."""
    data = read_file(path, MOST_BYTES)
    complete = data.rfind(b"\n") + 1
    cut = data[complete:]
    if cut and BEGINNING.startswith(cut[: len(BEGINNING)]):
        os.truncate(path, complete)


def replace_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Raises:
        OutputError: it can't be written, or a user's file is there.
    """
    with writing(path.parent), replacing_own(path) as partial:
        partial.write_text(text, encoding="utf-8")
