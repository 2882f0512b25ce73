"""From a depth map and a label map to a contact: clouds, contact pair, mesh, normal (Bini 2026, section 3.2.2).

Camera frame: x right, y down, z forward. Lengths are scene units: depth divided by the clip's one fixed scale, so
that z is in (0, 1] and 0 means "no depth". Label maps hold 0 = other, 1 = tissue, 2 = tool, 255 = outside the picture.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Annotated, Literal, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.data.contact.outlines import tool_depth
from palpate.data.contact.surface import smooth_surface
from palpate.data.labels import TISSUE, TOOL
from palpate.data.source.camera import MOST_SIDE, Camera, back_project
from palpate.physics.mesh import Mesh, contact_normal, grid_mesh, nearest_vertex

LEAST_NOISE = 3e-4
"""Least noise of depth [scene units]: fitting planes to curved tissue errs by about 2e-4."""


class GeometryStatus(Exception):
    """A frame has no usable contact; `status` is one of the per-frame statuses, `detail` a sentence."""

    def __init__(self, status: str, detail: str, distance: float = math.nan) -> None:
        super().__init__(detail)
        self.status, self.detail, self.distance = status, detail, distance


def find_contact(tool: np.ndarray, tissue: np.ndarray, *, two_pass: bool = False) -> tuple[int, int, float]:
    """Closest pair (g*, b*) = argmin ‖g - b‖ of two clouds, by a KD-tree on the tissue (Bini 2026, equation 4).

    Args:
        tool: G, shape [N, 3], N at least 1 [scene units].
        tissue: B, shape [M, 3], M at least 1 [scene units].
        two_pass: the paper's search for N > 1000: 1000 evenly spaced tool points, then the 1000 tool points nearest to
            the winner. It can miss the closest pair when that is far from every point of the first pass.

    Returns:
        Rows of g* in the tool cloud and of b* in the tissue cloud, and d* = ‖g* - b*‖ [scene units].
    """
    tree, candidates = KDTree(tissue), np.arange(len(tool))
    if two_pass and len(tool) > 1000:
        coarse = np.linspace(0, len(tool) - 1, 1000).round().astype(int)
        winner = coarse[np.argmin(tree.query(tool[coarse])[0])]
        candidates = KDTree(tool).query(tool[winner], k=1000)[1]
    distances, nearest = tree.query(tool[candidates])
    best = int(np.argmin(distances))
    return int(candidates[best]), int(nearest[best]), float(distances[best])


@dataclass(frozen=True)
class GeometrySettings(Checked, group="geometry."):
    """Settings by which a depth map becomes a mesh and a contact."""

    height: Annotated[int, 8, MOST_SIDE] = 120
    """Rows of the grid on which everything is computed, the network's input (Bini 2026, section 3.4)."""
    width: Annotated[int, 8, MOST_SIDE] = 214
    """Columns of the grid."""
    max_edge: Positive = 0.05
    """Longest edge of a mesh triangle [scene units] (Bini 2026, section 3.2.2)."""
    smoothing: NotNegative = 0.0
    """Standard deviation of the weights that smooth the tissue's depth before mesh and contact [grid pixels]; 0 leaves
    it as it is (paper). Noisy or rounded depth needs 3 to 6."""
    keep: Annotated[float, 0.01, 1] = 1.0
    """Share of the mesh's vertices that decimation keeps; the paper names 0.3 and used 1."""
    contact: Literal["touching", "nearest"] = "touching"
    """Criterion of contact. touching: masks touch or clouds are close, and the tool doesn't hover
    (`data.contact.evidence`); the contact is at the outlines. nearest (paper): tool and tissue are visible; the contact
    is the closest pair of points (equation 4), also while the tool comes and goes."""
    contact_pixels: NotNegative = 2.0
    """Largest distance of masks that touch [grid pixels]; neighbours are 1 apart, 0 switches the criterion off."""
    contact_distance: NotNegative = 0.02
    """Largest distance of clouds that touch [scene units]; 0 switches the criterion off."""
    two_pass: bool = False
    """Search the contact pair in the paper's two passes instead of exactly."""
    force_direction: Literal["normal", "displacement"] = "normal"
    """Axis of the force: the surface normal (paper), or the observed motion of the contact (see `force_direction`)."""
    displacement: Literal["tracked", "redetected"] = "tracked"
    """Observed displacement: of the same tissue point, or between the two frames' contact points (paper)."""
    rigid_motion: Literal["keep", "subtract"] = "keep"
    """Treatment of the common motion of tissue far from the contact (the camera's) in the displacement."""
    min_tool_pixels: Annotated[int, 1, MOST_SIDE**2] = 8
    """Smallest number of tool pixels on the grid; with fewer a frame is `no_tool`."""
    min_tissue_pixels: Annotated[int, 1, MOST_SIDE**2] = 50
    """Smallest number of tissue pixels on the grid; with fewer a frame is `no_tissue`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.smoothing > self.width:
            raise ValueError(f"geometry.smoothing is {self.smoothing}; give at most the grid's width, {self.width}.")
        if self.contact_pixels == 0 and self.contact_distance == 0:
            raise ValueError("geometry.contact_pixels and geometry.contact_distance are both 0; set one of them.")


class RestTissue(NamedTuple):
    """The tissue before it was touched."""

    depth: np.ndarray
    """Depth z, shape [h, w] [scene units]."""
    known: np.ndarray
    """Mask of tissue whose depth is known, hidden by the tool now or not, shape [h, w], bool."""
    beyond: np.ndarray
    """Mask of pixels that showed other things than tissue, bool [h, w]: there the tissue ends, even if hidden now."""


@dataclass(frozen=True)
class FrameGeometry:
    """Input of the simulator from one frame in contact (Bini 2026, section 3.2.2); the mesh is made on demand."""

    make_mesh: Callable[[], Mesh]
    """Function that returns the tissue's surface."""
    tool_point: np.ndarray
    """Tool's point g* of the contact pair, shape [3] [scene units]; NaN if the tool has no depth."""
    tissue_point: np.ndarray
    """Tissue's point b* of the contact pair, shape [3] [scene units]."""
    distance: float
    """Distance d* of the contact pair [scene units]; NaN if the tool has no depth."""
    pixel: tuple[int, int]
    """Grid pixel (u, v) of b*."""
    touching: bool
    """True if the masks touch."""
    noise: float = math.nan
    """Standard deviation of the tissue's depth about its smoothed surface [scene units]; NaN without smoothing."""
    surface: np.ndarray | None = None
    """Depth of the visible tissue by which the mesh is made, shape [h, w] [scene units]; None = another."""

    @cached_property
    def mesh(self) -> Mesh:
        """Tissue surface."""
        return self.make_mesh()

    @cached_property
    def vertex(self) -> int:
        """Mesh vertex idx* nearest to the contact point."""
        return nearest_vertex(self.mesh, self.tissue_point)

    @cached_property
    def normal(self) -> np.ndarray:
        """Contact normal n*, shape [3], unit length, towards the camera (equations 5-8)."""
        return contact_normal(self.mesh, self.vertex)


def frame_geometry(
    depth: np.ndarray, labels: np.ndarray, camera: Camera, settings: GeometrySettings, rest: RestTissue | None = None,
    ends: np.ndarray | None = None,
) -> FrameGeometry:  # fmt: skip
    """Contact and mesh of one frame.

    With `contact` touching a frame is in contact if the masks touch or the clouds are close. If the masks touch, only
    pixels along the touching outline can form the contact pair: monocular depth of a shiny tool is often wrong, its
    outline seldom. With nearest, the paper's, the closest pair over all points counts, however far apart it is.

    Args:
        depth: z, shape [h, w] [scene units], 0 = invalid.
        labels: label map, shape [h, w].
        camera: intrinsics of the grid.
        rest: the tissue at rest; None = as it is visible. The mesh covers all of it, the contact lies on
            what is visible.
        ends: the parts of the tool that may touch, bool [h, w]; None = all of it, as with nearest.

    Raises:
        GeometryStatus: `no_tool`, `no_tissue`, `bad_depth` or `no_contact`, in this order.
    """
    tool, tissue = labels == TOOL, labels == TISSUE
    _require_pixels(tool, tissue, depth, settings)
    if ends is not None and settings.contact == "touching" and (tool & ends).any():
        tool = tool & ends
    rest, noise = smooth_rest(depth, labels, settings, rest)
    sheet = back_project(rest.depth, camera)
    points = np.where(tissue[..., None], sheet, back_project(depth, camera))
    reach = settings.contact_pixels
    touching = reach > 0 and bool((distance_transform_edt(~tissue)[tool] <= reach).any())
    outlined = touching and settings.contact == "touching"
    if not touching and settings.contact == "touching":
        points = np.where(tool[..., None], back_project(tool_depth(depth, tool), camera), points)
    pair = _outline_pair(points, tool, tissue, settings) if outlined else _cloud_pair(points, tool, tissue, settings)
    (tool_row, tool_column), (row, column) = pair
    make_mesh, _ = _mesh_around(row, column, sheet, labels, settings, rest)
    tissue_point = points[row, column]
    tool_point = points[tool_row, tool_column] if depth[tool_row, tool_column] > 0 else np.full(3, np.nan, np.float32)
    distance = float(np.linalg.norm(tool_point - tissue_point))
    pixel = int(column), int(row)
    return FrameGeometry(make_mesh, tool_point, tissue_point, distance, pixel, touching, noise, rest.depth)


def dent_geometry(
    depth: np.ndarray, labels: np.ndarray, pixel: tuple[int, int], camera: Camera, settings: GeometrySettings,
    rest: RestTissue | None = None,
) -> FrameGeometry:  # fmt: skip
    """Mesh of the tissue with its contact at a grid pixel (u, v), where a dent is; the others as in `frame_geometry`.

    Raises:
        GeometryStatus: `bad_depth` where the tissue gives no mesh.
    """
    rest, noise = smooth_rest(depth, labels, settings, rest)
    sheet = back_project(rest.depth, camera)
    column, row = pixel
    make_mesh, inside = _mesh_around(row, column, sheet, labels, settings, rest)
    if not inside:
        row, column = make_mesh().pixels[nearest_vertex(make_mesh(), sheet[row, column])].tolist()
    nowhere, point = np.full(3, np.nan, np.float32), sheet[row, column]
    return FrameGeometry(make_mesh, nowhere, point, math.nan, (column, row), False, noise, rest.depth)


def smooth_rest(
    depth: np.ndarray, labels: np.ndarray, settings: GeometrySettings, rest: RestTissue | None = None
) -> tuple[RestTissue, float]:
    """The tissue at rest, smoothed as the settings say, and the noise as in `FrameGeometry`.

    Args:
        depth, labels: depth and labels of a frame, as in `frame_geometry`.
        settings: `smoothing` counts.
        rest: the tissue at rest; None = as it is visible.
    """
    if rest is None:
        tissue = labels == TISSUE
        rest = RestTissue(depth, tissue & (depth > 0), np.zeros_like(tissue))
    if settings.smoothing == 0:
        return rest, math.nan
    resting, noise = smooth_surface(rest.depth, rest.known, settings.smoothing)
    return rest._replace(depth=resting), max(noise, LEAST_NOISE)


def tissue_mesh(sheet: np.ndarray, labels: np.ndarray, settings: GeometrySettings, rest: RestTissue) -> Mesh:
    """Mesh of the tissue at rest; behind the tool it goes on.

    Args:
        sheet: the tissue's points on the grid, shape [h, w, 3] [scene units].
        labels: label map, shape [h, w].
        settings: `max_edge` and `keep` count.
        rest: known tissue.

    Raises:
        GeometryStatus: `bad_depth` where no triangle is left.
    """
    hidden = (labels == TOOL) & ~rest.known & ~rest.beyond
    mesh = grid_mesh(sheet, rest.known, occluder=hidden, max_edge=settings.max_edge, keep=settings.keep)
    if len(mesh.vertices) == 0:
        raise GeometryStatus("bad_depth", "The tissue's depth is so rough that no mesh triangle is short enough.")
    return mesh


def _mesh_around(
    row: int, column: int, sheet: np.ndarray, labels: np.ndarray, settings: GeometrySettings, rest: RestTissue
) -> tuple[Callable[[], Mesh], bool]:
    """Return a cached function for the mesh of `tissue_mesh`, and whether a grid pixel is known to be its vertex."""
    make_mesh = cache(partial(tissue_mesh, sheet, labels, settings, rest))
    top, left = max(row - 2, 0), max(column - 2, 0)
    around = np.s_[top : row + 3, left : column + 3]
    pixels = grid_mesh(sheet[around], rest.known[around], max_edge=settings.max_edge).pixels.tolist()
    if settings.keep < 1 or not pixels:
        make_mesh()  # without any triangle there is an error at once
        return make_mesh, False
    return make_mesh, [row - top, column - left] in pixels


def move_contact(geometry: FrameGeometry, pixel: tuple[int, int]) -> FrameGeometry:
    """Return the frame with the mesh's vertex at the grid pixel (u, v) as its contact."""
    vertex = int(np.flatnonzero((geometry.mesh.pixels == pixel[::-1]).all(axis=1))[0])
    point = geometry.mesh.vertices[vertex]
    distance = float(np.linalg.norm(geometry.tool_point - point))
    return dataclasses.replace(geometry, tissue_point=point, distance=distance, pixel=pixel)


def force_direction(normal: np.ndarray, displacement: np.ndarray | None, settings: GeometrySettings) -> np.ndarray:
    """Unit vector d of the force F·d.

    `normal`: d = n, so that F < 0 presses into the tissue (Bini 2026, section 3.3). `displacement`: d is the axis of
    the observed motion, oriented so that d·n ≥ 0; F < 0 still presses and F > 0 pulls, so traction is representable
    once `bounds.force` allows F > 0. Motions shorter than 1e-4 scene units have no axis and fall back to the normal.

    Args:
        normal: n, shape [3], towards the camera.
        displacement: observed motion of the contact, shape [3] [scene units], or None.

    Returns:
        Shape [3], float32.
    """
    length = 0.0 if displacement is None else float(np.linalg.norm(displacement))
    if settings.force_direction == "normal" or displacement is None or not length > 1e-4:
        return np.asarray(normal, np.float32)
    axis = np.asarray(displacement, np.float64) / length
    return (axis if axis @ normal >= 0 else -axis).astype(np.float32)


def _require_pixels(tool: np.ndarray, tissue: np.ndarray, depth: np.ndarray, settings: GeometrySettings) -> None:
    if tool.sum() < settings.min_tool_pixels:
        raise GeometryStatus("no_tool", f"{tool.sum()} tool pixels, fewer than {settings.min_tool_pixels}.")
    if tissue.sum() < settings.min_tissue_pixels:
        raise GeometryStatus("no_tissue", f"{tissue.sum()} tissue pixels, fewer than {settings.min_tissue_pixels}.")
    valid = int((tissue & (depth > 0)).sum())
    if valid < settings.min_tissue_pixels:
        raise GeometryStatus("bad_depth", f"{valid} tissue pixels have depth, fewer than {settings.min_tissue_pixels}.")


Pixels = tuple[np.ndarray, np.ndarray]
"""Pixels of the tool and of the tissue, row and column each."""


def _outline_pair(points: np.ndarray, tool: np.ndarray, tissue: np.ndarray, settings: GeometrySettings) -> Pixels:
    """Pixels (row, column) of g* and b* among those along the outline where the masks touch."""
    reach = settings.contact_pixels
    to_tool, nearest_tool = distance_transform_edt(~tool, return_indices=True)
    with_depth = tissue & (points[..., 2] > 0)
    closest = float(to_tool[with_depth].min())
    if closest > 5.0 * reach:
        raise GeometryStatus("bad_depth", f"No tissue within {closest:.0f} pixels of the tool has a depth.")
    # Stereo depth has holes along outlines: then the nearest pixels with a depth stand in for the touching ones.
    near_tissue = np.argwhere(with_depth & (to_tool <= max(reach, closest)))
    near_tool = np.argwhere(tool & (points[..., 2] > 0) & (distance_transform_edt(~tissue) <= reach))
    if len(near_tool) == 0:
        pixel = near_tissue[np.argmin(to_tool[tuple(near_tissue.T)])]
        return nearest_tool[:, pixel[0], pixel[1]], pixel
    clouds = points[tuple(near_tool.T)], points[tuple(near_tissue.T)]
    tool_row, tissue_row, _ = find_contact(*clouds, two_pass=settings.two_pass)
    return near_tool[tool_row], near_tissue[tissue_row]


def _cloud_pair(points: np.ndarray, tool: np.ndarray, tissue: np.ndarray, settings: GeometrySettings) -> Pixels:
    """Pixels (row, column) of g* and b* among all; only `contact` nearest lets them be beyond the contact distance."""
    valid = points[..., 2] > 0
    tool_pixels, tissue_pixels = np.argwhere(tool & valid), np.argwhere(tissue & valid)
    if len(tool_pixels) == 0:
        raise GeometryStatus("bad_depth", "The tool has no depth, and its outline does not tell where it touches.")
    clouds = points[tuple(tool_pixels.T)], points[tuple(tissue_pixels.T)]
    tool_row, tissue_row, distance = find_contact(*clouds, two_pass=settings.two_pass)
    if settings.contact == "touching" and distance > settings.contact_distance:
        detail = f"The tool is {distance:.3g} scene units from the tissue, more than {settings.contact_distance:g}."
        raise GeometryStatus("no_contact", detail, distance)
    return tool_pixels[tool_row], tissue_pixels[tissue_row]
