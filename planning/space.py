"""The file of a scene in space: a user's body, and a straight instrument that comes through a port."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from palpate.common.settings import require_numbers
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, from_mapping
from palpate.estimators.palpated import palpated_young

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class SpaceScene:
    """Fields of the file; in it `calibration`, a file of calibrate.py next to it, may tell young and young_log_sd.

    Raises:
        ValueError: numbers that can't be.
    """

    mesh: str
    """The body's closed surface, next to this file: PLY, STL, OBJ, or what else trimesh reads."""
    start: Triple
    goal: Triple
    """Of the tip's centre [m]."""
    port: Triple
    """Which the shaft goes through [m]."""
    limit_N: float
    """Of the force on the instrument: the upper end of its interval keeps below it all along the path."""
    young: float
    """E [Pa]."""
    young_log_sd: float = 0.0
    """Standard deviation of its logarithm."""
    unit: Literal["m", "cm", "mm"] = "m"
    """Of the mesh's file; all else is in metres."""
    poisson: float = 0.45
    tip_radius: float = 0.0025
    """Of the tip, a ball, and of the shaft [m], 2.5 cm at most."""
    alpha: float = 0.5
    """α: cost is α·deformation [mJ] + (1 - α)·way [mm]."""
    speed: float = 0.01
    """Of the tip [m/s]."""
    frame: str = "map"
    """Name of the mesh's frame in path.json."""

    def __post_init__(self) -> None:
        positive = ("limit_N", "young", "tip_radius", "speed")
        require_numbers(self, positive=positive, not_negative=("young_log_sd",))
        if not (0 <= self.alpha <= 1 and 0 <= self.poisson < 0.5 and self.tip_radius <= 0.025):
            raise ValueError("alpha is to be 0 to 1, poisson from 0 to below 0.5, tip_radius 0.025 m at most.")


def read_space_scene(path: Path, values: dict[str, Any], alpha: float | None = None) -> SpaceScene:
    """A scene in space from the mapping in its file; alpha, where given, instead of the file's.

    Raises:
        InputError: it, or its calibration, can't be.
    """
    if "calibration" in values:
        if "young" in values:
            raise InputError(f"{printable(path)}: young and calibration each tell E; give one.")
        values = dict(values)
        young, log_sd = palpated_young(path.parent / str(values.pop("calibration")))
        values |= {"young": young, "young_log_sd": log_sd}
    scene = from_mapping(SpaceScene, values, printable(path))
    if not (path.parent / scene.mesh).is_file():
        raise InputError(f"{printable(path)}: there is no mesh {printable(path.parent / scene.mesh)}; give its file.")
    return replace(scene, mesh=str(path.parent / scene.mesh), alpha=scene.alpha if alpha is None else alpha)
