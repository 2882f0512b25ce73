"""Tables of a clip: parameters.csv, interactions.csv, calibrated.csv."""

import csv
from typing import Any

from palpate.estimators.records import CONTACTS, FRAMES
from palpate.estimators.result import Table
from palpate.results import store
from palpate.results.artefacts.base import Artefact
from palpate.results.calibrated import CALIBRATED


class TableFile(Artefact):
    """CSV file of a table, row by row."""

    table: Table
    described = False
    """True if run.json describes the columns."""

    def open(self) -> None:
        self._file = self.path.open("w", encoding="utf-8", errors="replace", newline="")
        self._rows = csv.writer(self._file)
        self._rows.writerow(self.table.columns)
        self.columns = self.table.columns if self.described else None

    def write(self, *row: Any) -> None:
        """Append a row of these objects."""
        self._rows.writerow(self.table.row(*row))

    def close(self) -> None:
        self._file.close()


class FrameTable(TableFile):
    """parameters.csv: a row a frame."""

    name, described = store.TABLE, True

    def open(self) -> None:
        self.table = FRAMES if self.clip.alarm is not None else FRAMES.without("alarm")
        super().open()

    def frame(self, estimate, image, labels) -> None:
        self.write(estimate)


class ContactTable(TableFile):
    """interactions.csv: a row a contact."""

    name, table, described = store.INTERACTIONS, CONTACTS, True

    def contact(self, run) -> None:
        self.write(*run.rows)


class CalibratedTable(TableFile):
    """calibrated.csv: a contact in newtons."""

    name, option, table = store.CALIBRATED, "force_scale", CALIBRATED

    def finish(self) -> None:
        for row in self.clip.calibration.rows if self.clip.calibration else ():
            self.write(row)
