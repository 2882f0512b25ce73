"""Results of a sequence beside a robot, in its own frame and metres: particles as VTK and PLY, and tables.

`particles_N.vtk` and `particles_N.ply` hold every frame's particles where they are; `particles.csv` the last one's, and
`parameters.csv` a line a frame. What isn't known is not a number there.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from palpate.common.output import replacing_own, require_own, write_own
from palpate.common.tables import to_csv
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import open_sequence
from palpate.data.source.sequence_checks import require_fit
from palpate.estimators.estimate import NINETY
from palpate.estimators.online.particle_field import YOUNG, ParticleField
from palpate.estimators.online.sequence import SequenceTissue
from palpate.estimators.online.settings import OnlineSettings
from palpate.results.store import make_output, writing

PLACES = ("rest_x", "rest_y", "rest_z", "x", "y", "z")
"""Of particles.csv, before what is found at each [m]."""


def write_sequence(path: Path, settings: OnlineSettings, folder: Path, done: Callable[[], None]) -> tuple[str, int]:
    """Follow a sequence's tissue, and write what is found.

    Args:
        path: sequence.yaml.
        settings: of the estimator.
        folder: of the results; files in it that this program wrote are replaced.
        done: called after every frame.

    Returns:
        The last frame's verdict, and how many frames there are.

    Raises:
        InputError: the sequence can't be used.
        OutputError: the folder can't be written, or holds a user's file by one of the names.
    """
    try:
        from meshio import Mesh
    except ImportError as error:
        raise InputError(f"{printable(path)} is a sequence, which needs meshio; install 'palpate[robot]'.") from error
    sequence, rows, columns, verdict = open_sequence(path), [], {}, ""
    require_fit(sequence)
    tissue = SequenceTissue(sequence, settings)
    make_output(folder)
    with writing(folder):
        require_own(folder / "particles.csv", folder / "parameters.csv")
        for frame, field in tissue.fields():
            number, verdict, values = sequence.numbers[frame], field.verdict, _values(field)
            rows.append({"frame": number, "time_s": float(sequence.times[frame]), "verdict": verdict} | field.numbers())
            cells: dict[str, Any] = {"triangle": field.faces.astype(np.int32)}
            inner: dict[str, Any] = {"tetra": field.tetrahedra.astype(np.int32)} if len(field.tetrahedra) else {}
            for ending, kept in (("vtk", cells | inner), ("ply", cells)):
                with replacing_own(folder / f"particles_{number:06d}.{ending}") as partial:
                    Mesh(field.positions, kept, values).write(partial)
            columns = dict(zip(PLACES, np.column_stack([field.rest, field.positions]).T, strict=True)) | values
            done()
        particles = [dict(zip(columns, row, strict=True)) for row in np.stack([*columns.values()], 1).tolist()]
        for name, table in (("particles.csv", particles), ("parameters.csv", rows)):
            write_own(folder / name, to_csv(table, [*dict.fromkeys(column for row in table for column in row)]))
    return verdict, len(rows)


def _values(field: ParticleField) -> dict[str, Any]:
    """Of every particle: both stiffnesses with the ends of their intervals where they are known, and E."""
    found: dict[str, Any] = {}
    for name, fitted, log_sd, known in (
        ("stiffness", field.distance, field.distance_log_sd, field.known),
        ("shape_stiffness", field.shape, field.shape_log_sd, field.shape_known),
    ):
        value, factor = np.where(known, fitted, np.nan), np.exp(NINETY * log_sd)
        found |= {name: value, f"{name}_low": value / factor, f"{name}_high": value * factor}
        found[f"simulated_{name}"] = fitted
    young = np.full((len(YOUNG), len(field.rest)), np.nan) if field.young is None else field.young
    return found | dict(zip(YOUNG, young, strict=True))
