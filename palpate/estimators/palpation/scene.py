"""The file that `palpate calibrate palpation` reads: a surface at rest, how it is held, and what was pressed on it."""

import codecs
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from palpate.common.files import read_file
from palpate.common.settings import LARGEST, Checked
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, from_mapping, read_mapping
from palpate.data.source.table import read_columns
from palpate.estimators.palpation.bench import Palpation
from palpate.estimators.palpation.skin import Skin, cover
from palpate.physics.fem import NoBody, make_solid, mesh_surface
from palpate.physics.fem.curved import curve
from palpate.physics.fem.meshing import around

FEWEST = 12
"""Points of a surface that is fitted, by three numbers, and moved, by six."""
BODY = 2.0
"""Largest body that is taken for metres [m]."""
Row = tuple[float, float, float, float]


@dataclass(frozen=True)
class SceneFile(Checked):
    """Fields of the file.

    Raises:
        ValueError: numbers that can't be.
    """

    held_axis: Literal["x", "y", "z"]
    """Axis along which `held_below` counts."""
    held_below: float
    """Height below which the body stands still, as on a table [m]."""
    palpations: tuple[dict[str, Any], ...]
    """Palpations, each with the fields of `PalpationFile`."""
    surface: str
    """The surface at rest that encloses the body, an .obj file next to this one [m]."""
    # Cells along the longest side; unknowns grow with their cube.
    cells: Annotated[int, 2, 24] = 8
    """Number of cells of the mesh along the surface's longest side."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.palpations:
            raise ValueError("palpations is empty; give one at least.")


@dataclass(frozen=True, kw_only=True)
class PalpationFile:
    """Fields of a palpation; the rest is `Palpation`'s.

    Raises:
        ValueError: numbers that can't be.
    """

    force: tuple[float, float, float]
    contact: tuple[float, float, float]
    points: str
    """CSV file next to this one, with columns x, y, z [m], in the sensor's frame."""
    pose: tuple[Row, Row, Row, Row] = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    """Pose of the sensor as it is believed."""
    tool_radius: float = Palpation.tool_radius
    hole: float = Palpation.hole
    pose_shift: float = Palpation.pose_shift
    pose_turn: float = Palpation.pose_turn

    def __post_init__(self) -> None:
        turn, shift = np.array(self.pose)[:3, :3], np.array(self.pose)[:3, 3]
        # No sensor is farther away than 10 m.
        if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0 or np.abs(shift).max() > 10.0:
            raise ValueError("pose is no rotation and shift; give the rows of a rigid 4 × 4 matrix, in metres.")
        lengths = self.tool_radius, self.hole, self.pose_shift
        if min(*lengths, self.pose_turn) <= 0 or max(lengths) > BODY / 2:
            raise ValueError("tool_radius, hole, pose_shift and pose_turn are to be positive, lengths in metres.")
        if not 1e-6 <= np.linalg.norm(self.force) <= 1e4:
            raise ValueError("force is to be 1e-06 to 10000 N; give what the tool pressed with.")


@dataclass(frozen=True, eq=False)
class Scene:
    """Scene as read from its file."""

    skin: Skin
    held: np.ndarray
    """Mask of the nodes' components that are fixed, shape [N, 3], bool."""
    palpations: list[Palpation]


def read_scene(path: Path) -> Scene:
    """Read a scene, and lay its surface on a mesh that fills it.

    Raises:
        InputError: it, or a file that it names, can't be read or can't be.
    """
    scene = from_mapping(SceneFile, read_mapping(path, "a palpation scene"), printable(path))
    file, axis = path.parent / scene.surface, "xyz".index(scene.held_axis)
    vertices, triangles = read_obj(file)
    _require_metres(file, vertices)
    given = enumerate(scene.palpations, start=1)
    palpations = [_palpation(each, f"{printable(path)}, palpation {number}", path.parent) for number, each in given]
    radius, floor = min(each.tool_radius for each in palpations), (axis, scene.held_below)
    # With edges of 0.6 radii under the tool a slab's E was off by 1.5 % (docs/reports/palpation.md).
    crowded = around(np.array([each.contact for each in palpations]), radius, 0.6 * radius)
    try:
        meshed = mesh_surface(vertices, triangles, cells=scene.cells, floor=floor, longest=crowded)
    except NoBody as error:
        raise InputError(f"{printable(file)}: {error}") from error
    body = make_solid(meshed.nodes, meshed.tetrahedra, order=2)
    low = body.rest[:, axis]
    # Nodes at a body's own base are drawn to it only nearly.
    base = scene.held_below + (1e-9 if low.min() >= scene.held_below - 1e-9 else 0.0)
    still = low <= base
    if (count := int(still.sum())) < 3:
        raise InputError(f"{printable(path)}: {count} nodes lie below held_below; raise it (lowest {low.min():.4g} m).")
    body = curve(body, vertices[triangles], still)
    held = np.repeat(still[:, None], 3, axis=1)
    return Scene(cover(body, vertices, triangles, vertices[:, axis] <= base), held, palpations)


def _palpation(values: dict[str, Any], where: str, folder: Path) -> Palpation:
    each = from_mapping(PalpationFile, values, where)
    points = read_columns(file := folder / each.points, ("x", "y", "z"), "table of points")
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < FEWEST:
        raise InputError(f"{printable(file)} holds {len(points)} points; give {FEWEST} or more of the pressed surface.")
    _require_metres(file, points)
    sizes = each.tool_radius, each.hole, each.pose_shift, each.pose_turn
    return Palpation(np.array(each.force), np.array(each.contact), points, np.array(each.pose, np.float64), *sizes)


def _require_metres(path: Path, points: np.ndarray) -> None:
    """Raise an InputError for points on a body [P, 3] in another unit; a few that are far off don't count."""
    size = float(np.ptp(np.quantile(points, (0.05, 0.95), axis=0), axis=0).max())
    if size > BODY:
        raise InputError(f"{printable(path)} is {size:.3g} m wide; give all lengths of the scene in metres.")


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read vertices [V, 3] and triangles [F, 3] of a Wavefront file; faces of more corners are fanned out.

    Raises:
        InputError: it can't be read, or holds no triangle.
    """
    import trimesh  # takes a second

    try:
        # Largest file of a surface [bytes].
        content = io.BytesIO(read_file(path, (2**26)).removeprefix(codecs.BOM_UTF8))
        how = {"process": False, "maintain_order": True, "skip_materials": True}
        mesh = trimesh.load_mesh(content, file_type="obj", **how)
    except Exception as error:  # the library's on broken content have nothing in common
        why = getattr(error, "strerror", None) or "a line is not as it should be"
        raise InputError(f"{printable(path)} is no .obj surface ({why}); give lines v x y z and f i j k.") from error
    places, faces = np.array(mesh.vertices), np.array(mesh.faces)
    if not len(faces) or faces.min() < 0 or faces.max() >= len(places) or not (np.abs(places) <= LARGEST).all():
        raise InputError(f"{printable(path)} holds no triangles of its own finite vertices; give lines v and f.")
    return places, faces
