"""results.json: all contacts and frames of a clip with intervals and covariances, as results.schema.json describes."""

from __future__ import annotations

from typing import Any

from palpate.common.files import as_json
from palpate.estimators.estimate import PressResult
from palpate.estimators.records import CONTACTS, FRAMES
from palpate.estimators.result import UNITS, Table
from palpate.results import store
from palpate.results.artefacts.base import Artefact
from palpate.results.calibrated import CALIBRATED

VERSION = 1
"""Version of the schema; it grows where a reader of the version before would fail."""


class ResultFile(Artefact):
    """Frames are written as they come, so that memory doesn't grow with the clip."""

    name = store.RESULTS

    def open(self) -> None:
        self._contacts: list[dict[str, Any]] = []
        self._separator = "\n"
        self._file = self.path.open("w", encoding="utf-8")
        notice = "Research software, not a medical device."
        head = {"version": VERSION, "notice": notice, "clip": self.clip.source.name, "fps": self.clip.fps}
        self._file.write(as_json(head | {"units": UNITS})[:-1] + ', "frames": [')

    def frame(self, estimate, image, labels) -> None:
        self._file.write(self._separator + as_json(_values(FRAMES, estimate) | _covariance(estimate.estimate)))
        self._separator = ",\n"

    def contact(self, run) -> None:
        self._contacts.append(_values(CONTACTS, *run.rows) | _covariance(run.estimate))

    def finish(self) -> None:
        rows: Any = (self.clip.calibration and self.clip.calibration.rows) or [None] * len(self._contacts)
        newtons = ({"newtons": None if row is None else _values(CALIBRATED, row)} for row in rows)
        contacts = [contact | more for contact, more in zip(self._contacts, newtons, strict=True)]
        self._file.write(f'\n], "contacts": {as_json(contacts)}}}\n')

    def close(self) -> None:
        self._file.close()


def _values(table: Table, *rows: Any) -> dict[str, Any]:
    """Return values of a table's row by column, with the digits of the CSV file; None where nothing is known."""
    known, found = table.known(*rows), dict[str, Any]()
    for name, cell in zip(table.columns, table.row(*rows), strict=True):
        value = known.get(name)
        found[name] = float(cell) if isinstance(value, float) else cell if isinstance(value, str) else value
    return found | {"determined": found["determined"].split(";") if found["determined"] else []}


def _covariance(press: PressResult | None) -> dict[str, Any]:
    return {"covariance": None if press is None else press.covariance}
