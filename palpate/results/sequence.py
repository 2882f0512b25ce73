"""Results of a sequence beside a robot, in its own frame and metres: particles as VTK, and tables.

`particles_N.vtk` hold every frame's particles where they are; `particles.csv` the last one's, and `parameters.csv` a
line a frame. What isn't known is not a number there.
"""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.common.options import filled, flag_of
from palpate.common.provenance import __version__, code_digest
from palpate.common.tables import to_csv
from palpate.data.source.frames import name_of
from palpate.data.source.images import printable
from palpate.data.source.sequence import Sequence, open_sequence
from palpate.data.source.sequence_checks import require_fit
from palpate.estimators.contract import Preparation
from palpate.estimators.online.particle_field import ParticleField
from palpate.estimators.online.sequence import SequenceTissue
from palpate.estimators.records import FRAMES
from palpate.estimators.result import ENDS, Quantity, values_of
from palpate.results import store
from palpate.results.record import FORMAT_VERSION, head_of, sha256_of

if TYPE_CHECKING:
    from palpate.results.run import Batch


def causes_of(sequence: Sequence, estimator: Mapping[str, Any]) -> dict[str, Any]:
    """Return dependencies of a sequence's results: hashes of all its files, the estimator's settings, and the code.

    Raises:
        OSError: a file can't be read.
    """
    named = (getattr(sequence.given, name) for name in ("poses", "times", "points", "camera"))
    files = [sequence.path, *sequence.files, *(sequence.path.parent / name for name in named if name is not None)]
    found = {"sequence": [*map(sha256_of, files)], "numbers": sequence.numbers, "estimator": dict(estimator)}
    return found | {"format": FORMAT_VERSION, "code": code_digest(), "program": __version__}


class SequenceClip:
    """A sequence beside a robot that is to be estimated.

    Args:
        path: of the sequence.
        batch: with the options and the estimator.

    Raises:
        ValueError: the sequence can't be used, or not with these options.
    """

    files = (store.TABLE, "particles.csv", store.RECORD)
    length, remarks = 0, ()

    def __init__(self, path: Path, batch: Batch) -> None:
        estimator: Any = batch.estimator
        if not estimator.tells_field:
            raise ValueError(f"{printable(path)} is a sequence, which is for --estimator online; give that.")
        chosen = filled(Preparation, vars(batch.options))
        for field in dataclasses.fields(chosen):
            if getattr(chosen, field.name) not in (None, field.default) and field.name not in ("threads", "device"):
                row = f"is for videos, and {printable(path)} is a sequence; leave it out"
                raise ValueError(f"{flag_of(field.name)} {row}.")
        self.name, self._sequence, self._settings = name_of(path), open_sequence(path), estimator.settings
        require_fit(self._sequence)
        self.causes = causes_of(self._sequence, estimator.described)
        """Everything that the results depend on."""

    def write(self, folder: Path, done: Callable[[], None]) -> dict[str, Any]:
        """Follow the tissue and write what is found; returns run.json's content.

        Args:
            folder: of the results; files in it that this program wrote are replaced.
            done: called after every frame.

        Raises:
            InputError: the sequence can't be used.
            OutputError: the folder can't be written, or holds a user's file by one of the names.
        """
        from meshio import Mesh  # takes a quarter of a second

        rows, columns, verdict, started = [], {}, "", time.perf_counter()
        sequence, causes = self._sequence, self.causes
        tissue = SequenceTissue(sequence, self._settings)
        with store.writing(folder):
            partial = store.partial_folder(folder)
            for frame, field in tissue.fields():
                number, verdict, values = sequence.numbers[frame], field.verdict, _values(field)
                first = {"frame": number, "time_s": float(sequence.times[frame]), "verdict": verdict}
                # Columns of how much is known come before those of stiffness.
                rows.append(
                    first | dict(sorted(values_of(field.numbers).items(), key=lambda item: "stiffness" in item[0]))
                )
                cells: dict[str, Any] = {"triangle": field.faces.astype(np.int32)}
                inner: dict[str, Any] = {"tetra": field.tetrahedra.astype(np.int32)} if len(field.tetrahedra) else {}
                Mesh(field.positions, cells | inner, values).write(partial / f"particles_{number:06d}.vtk")
                places = dict(zip(("rest_x", "rest_y", "rest_z"), field.rest.T, strict=True))
                columns = places | dict(zip("xyz", field.positions.T, strict=True)) | values
                done()
            particles = [dict(zip(columns, row, strict=True)) for row in np.stack([*columns.values()], 1).tolist()]
            for name, table in (("particles.csv", particles), (store.TABLE, rows)):
                text = to_csv(table, [*dict.fromkeys(column for row in table for column in row)])
                (partial / name).write_text(text, encoding="utf-8", newline="")
            empty = f"{tissue.unseen} of {len(sequence.gripped)} frames show no tissue: their clouds are empty"
            texts = {name: FRAMES.columns.get(name, "").replace("scene units", "m") for row in rows for name in row}
            record = head_of("sequence", causes) | {
                "input": {
                    "path": str(sequence.path.resolve()),
                    "sha256": causes["sequence"],
                    "frames": len(rows),
                    "fps": 1 / float(np.median(np.diff(sequence.times))),
                },
                "statuses": {"ok": len(rows)},
                "verdicts": Counter(row["verdict"] for row in rows),
                "contacts": {verdict: 1},
                "units": {"length": "m", "time": "s"},
                "columns": {store.TABLE: texts},
                "warnings": [empty] * (tissue.unseen > 0),
                "timings_s": {"total": round(time.perf_counter() - started, 4)},
            }
            store.write_record(partial, record)
            store.publish(partial, folder)
        return record


def _values(field: ParticleField) -> dict[str, Any]:
    """Return both stiffnesses with the ends of their intervals where they are known."""
    found: dict[str, Any] = {}
    for column, fitted in field.maps.items():
        name = column.removeprefix("distance_")
        value = Quantity(np.where(fitted.known, fitted.value, np.nan), fitted.log_sd)
        found |= {f"{name}{end}": value.end(side) for end, side in ENDS.items()}
        found[f"simulated_{name}"] = fitted.value
    return found
