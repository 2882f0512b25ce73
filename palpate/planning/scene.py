"""The file of a scene to plan in.

Without a mesh it is a plane that an instrument's tip, a disc, moves in, with tissue that gives way and obstacles that
don't. Tissue is upright blocks, such as folds or curtains; the plane cuts them at the tip's height. With a mesh it is
in space: a user's body, and a straight instrument that comes through a port.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, from_mapping, read_mapping
from palpate.estimators.palpated import palpated_young

Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class SoftObject(Checked):
    """A block of tissue: what its table of costs depends on, its place aside.

    Raises:
        ValueError: numbers that can't be, nothing held.
    """

    size: tuple[float, float, float]
    """Width, thickness and height [m]."""
    young: Annotated[float, 1.0, 1e12]
    """Young's modulus E [Pa]."""
    poisson: Annotated[float, 0, 0.499] = 0.45
    held: tuple[Literal["bottom", "top", "left", "right"], ...] = ("top",)
    """Sides that don't move."""
    longest: Annotated[float, 1e-15, 0.1] = 0.04
    """Distance over which tissue is pushed along until it lets the tip by [m], 10 cm at most."""
    cells: tuple[int, int, int] = (6, 1, 5)
    """Number of cells of the mesh along width, thickness and height, of quadratic elements."""

    def __post_init__(self) -> None:
        if not all(1e-4 <= size <= 10 for size in self.size):
            raise ValueError("size is to be 0.0001 to 10 m.")
        super().__post_init__()
        if not self.held:
            raise ValueError("held is empty; name one side at least.")
        if min(self.cells) < 1 or math.prod(self.cells) > 4000:
            raise ValueError("cells are to be positive, and their product 4000 at most.")

    @property
    def height(self) -> float:
        """Height of the plane over the foot [m]: half of the block's."""
        return self.size[2] / 2


@dataclass(frozen=True)
class Placed:
    """Place of a block in the plane.

    Raises:
        ValueError: a size that can't be.
    """

    centre: Pair
    """[m]."""
    size: Pair
    """Width and thickness [m]."""
    degrees: float = 0.0
    """Angle of the width from the x axis, anticlockwise."""

    def __post_init__(self) -> None:
        if min(self.size) <= 0:
            raise ValueError("its size is not positive; give width and thickness in m.")

    @property
    def half(self) -> np.ndarray:
        """Half of its size, shape [2] [m]."""
        return np.array(self.size) / 2

    def inside_frame(self, points: np.ndarray) -> np.ndarray:
        """Return points of the plane [..., 2] in the block's frame."""
        return (points - self.centre) @ self._axes

    def outside_frame(self, points: np.ndarray) -> np.ndarray:
        """Return points of the block's frame [..., 2] in the plane."""
        return points @ self._axes.T + self.centre

    def clearance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance of points [..., 2] of the plane from the block, negative within, shape [...] [m]."""
        beyond = np.abs(self.inside_frame(points)) - self.half
        return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)

    def met(self, starts: np.ndarray, ends: np.ndarray, radius: float, close: float = 1e-5) -> np.ndarray:
        """Return the distance that a disc goes on straight lines until it touches, shape [K] [m]; infinite where it
        never does.

        Steps of the distance that is left (sphere tracing, Hart 1996).

        Args:
            starts, ends: of the lines, shape [K, 2] [m].
            radius: of the disc [m].
            close: distance that counts as contact [m].
        """
        lengths = np.linalg.norm(ends - starts, axis=1)
        ways = (ends - starts) / np.maximum(lengths, 1e-12)[:, None]
        way, touched = np.zeros(len(starts)), np.full(len(starts), np.inf)
        open_lines = np.arange(len(starts))
        for _ in range(400):
            left = self.clearance(starts[open_lines] + way[open_lines, None] * ways[open_lines]) - radius
            there = left < close
            touched[open_lines[there]] = way[open_lines[there]]
            way[open_lines] += np.maximum(left, close)
            open_lines = open_lines[~there & (way[open_lines] <= lengths[open_lines])]
            if not len(open_lines):
                break
        return touched

    @property
    def _axes(self) -> np.ndarray:
        turn = np.radians(self.degrees)
        return np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])


@dataclass(frozen=True)
class Piece:
    """A piece of tissue in the file."""

    kind: str
    centre: Pair
    degrees: float = 0.0


@dataclass(frozen=True)
class PlanScene(Checked):
    """Fields of the file of a plane.

    Raises:
        ValueError: numbers that can't be, tissue of a kind that there is not.
    """

    area: tuple[Pair, Pair]
    """Lower left and upper right corner of the plane's part that may be used [m]."""
    start: Pair
    goal: Pair
    """Goal of the tip [m]."""
    objects: dict[str, SoftObject]
    """Kinds of tissue by name."""
    tissue: tuple[Piece, ...]
    obstacles: tuple[Placed, ...] = ()
    """Obstacles that never give way."""
    tip_radius: Positive = 0.005
    """[m]."""
    alpha: Annotated[float, 0, 1] = 0.5
    """α, from the shortest way to the gentlest: cost is α·deformation [mJ] + (1 - α)·way [mm]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.area[0][0] >= self.area[1][0] or self.area[0][1] >= self.area[1][1]:
            raise ValueError("area's first corner is to be below and left of its second.")
        for piece in self.tissue:
            if piece.kind not in self.objects:
                raise ValueError(f"there is no object '{piece.kind}' of tissue; objects has {list(self.objects)}.")

    @property
    def pieces(self) -> list[tuple[str, Placed]]:
        """Kind and place of every piece of tissue."""
        objects = self.objects
        return [(each.kind, Placed(each.centre, objects[each.kind].size[:2], each.degrees)) for each in self.tissue]


@dataclass(frozen=True)
class SpaceScene(Checked):
    """Fields of the file of a scene in space.

    In it `calibration`, a file of palpate calibrate next to it, may tell young and young_log_sd.

    Raises:
        ValueError: numbers that can't be.
    """

    mesh: str
    """The body's closed surface, next to this file: PLY, STL, OBJ, or what else trimesh reads."""
    start: Triple
    goal: Triple
    """Goal of the tip's centre [m]."""
    port: Triple
    """Point through which the shaft goes [m]."""
    limit_N: Positive
    """Limit of the force on the instrument: the upper end of its interval keeps below it all along the path."""
    young: Positive
    """Young's modulus E [Pa]."""
    young_log_sd: NotNegative = 0.0
    """Standard deviation of its logarithm."""
    unit: Literal["m", "cm", "mm"] = "m"
    """Unit of the mesh's file; all else is in metres."""
    poisson: Annotated[float, 0, 0.499] = 0.45
    tip_radius: Annotated[float, 1e-15, 0.025] = 0.0025
    """Radius of the tip, a ball, and of the shaft [m], 2.5 cm at most."""
    alpha: Annotated[float, 0, 1] = 0.5
    """α: cost is α·deformation [mJ] + (1 - α)·way [mm]."""
    speed: Positive = 0.01
    """Speed of the tip [m/s]."""


def read_plan_scene(path: Path, alpha: float | None = None) -> PlanScene | SpaceScene:
    """Read a scene; one with a mesh is in space.

    Args:
        path: YAML file.
        alpha: 0 = the shortest path, 1 = the gentlest; None = as the file has it.

    Raises:
        InputError: it, or its calibration, can't be read, or can't be.
    """
    where, values = printable(path), read_mapping(path, "a scene to plan in")
    if alpha is not None:
        values["alpha"] = alpha
    if "mesh" not in values:
        return from_mapping(PlanScene, values, where)
    if "calibration" in values:
        if "young" in values:
            raise InputError(f"{where}: young and calibration each tell E; give one.")
        values["young"], values["young_log_sd"] = palpated_young(path.parent / str(values.pop("calibration")))
    scene = from_mapping(SpaceScene, values, where)
    mesh = path.parent / scene.mesh
    if not mesh.is_file():
        raise InputError(f"{where}: there is no mesh {printable(mesh)}; give its file.")
    return replace(scene, mesh=str(mesh))
