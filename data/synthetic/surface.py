"""View of the deformed tissue sheet: exact depth and, for every pixel, the rest position of the visible tissue point.

Each grid vertex carries the patch of tissue up to half-way to its neighbours, which sinks as much as it does. Steep
ramps join the patches. So the depth of a grid pixel is its own vertex's, also in a full-size map resized to the grid: a
dent is often only two or three vertices wide. The patches are drawn with a z-buffer.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.data.synthetic.scene import NEAREST_DEPTH, Scene
from palpate.data.synthetic.truth import TrueMotion

HALF_PATCH = 0.49
"""Half-width of a vertex's patch as a share of a grid cell."""


@dataclass(frozen=True)
class SheetView:
    """The sheet in the camera's view in one frame, without the tool."""

    depth: np.ndarray
    """z of every pixel, shape [H, W], float32 [scene units]."""
    rest_u: np.ndarray
    """Column where the visible tissue point lay at rest, shape [H, W], float32 [px]."""
    rest_v: np.ndarray
    """Row where the visible tissue point lay at rest, shape [H, W], float32 [px]."""
    region: tuple[slice, slice]
    """Rows and columns outside which nothing has moved."""


def rest_view(scene: Scene) -> SheetView:
    """The sheet at rest."""
    camera = scene.camera
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    depth = scene.sheet.depth((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy)
    return SheetView(*(part.astype(np.float32) for part in (depth, columns, rows)), (slice(0, 0), slice(0, 0)))


def deformed_view(scene: Scene, motion: TrueMotion, frame: int, rest: SheetView) -> SheetView:
    """The sheet in a frame: the rest view with the moving region drawn anew."""
    displacement = np.zeros((*scene.mesh.grid_shape, 3))
    displacement[tuple(scene.mesh.pixels[motion.moving].T)] = motion.field[frame]
    # Smallest displacement that is drawn [scene units].
    moved = np.abs(displacement).max(axis=2) > 1e-5
    if not moved.any():
        return rest
    (top, left), (bottom, right) = _moved_range(scene, displacement, moved)
    nodes, at_rest = _lattice(scene, displacement, (top, bottom), (left, right))
    region, (inverse, weighted_u, weighted_v) = _rasterise(nodes, at_rest, (scene.camera.width, scene.camera.height))
    drawn = inverse > 0
    depth, map_u, map_v = rest.depth.copy(), rest.rest_u.copy(), rest.rest_v.copy()
    depth[region][drawn] = 1 / inverse[drawn]
    map_u[region][drawn] = weighted_u[drawn] / inverse[drawn]
    map_v[region][drawn] = weighted_v[drawn] / inverse[drawn]
    return SheetView(depth, map_u, map_v, region)


def _moved_range(scene: Scene, displacement: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last row and column to be drawn anew, shape [2] each; outside the grid where its edge moves inwards."""
    low, high = (f(np.argwhere(moved), axis=0) for f in (np.min, np.max))
    last = np.array(moved.shape) - 1
    shift = scene.grid_camera.fx * np.abs(displacement[..., :2]).max() / NEAREST_DEPTH
    beyond = np.where((low == 0) | (high == last), math.ceil(shift) + 1, 0)
    return np.maximum(low - 2, -beyond), np.minimum(high + 2, last + beyond)


def _lattice(
    scene: Scene, displacement: np.ndarray, rows: tuple[int, int], columns: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Deformed sheet over an inclusive range of the grid, four nodes a vertex; outside the grid it moves as its edge.

    Returns:
        Column, row [px] and z [scene units] of the nodes in the picture, shape [3, h, w], and their column and row at
        rest [px], shape [2, h, w].
    """
    camera, cell = scene.grid_camera, scene.settings.cell
    row, column = np.arange(rows[0], rows[1] + 1), np.arange(columns[0], columns[1] + 1)
    ray = np.stack(np.meshgrid((column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy))
    depth = scene.sheet.depth(*ray)
    height, width = scene.mesh.grid_shape
    moved = displacement[np.ix_(np.clip(row, 0, height - 1), np.clip(column, 0, width - 1))]
    after = depth + moved[..., 2]
    nodes = []
    node_ray = np.stack(np.meshgrid(_patch_edges(column) - camera.cx, _patch_edges(row) - camera.cy))
    node_ray /= np.array([camera.fx, camera.fy])[:, None, None]
    rest = np.empty_like(node_ray)
    for axis, (focal, center) in enumerate(((camera.fx, camera.cx), (camera.fy, camera.cy))):
        shift = focal * ((ray[axis] * depth + moved[..., axis]) / after - ray[axis])
        at_rest = node_ray[axis] * focal + center + 0.5
        nodes.append((at_rest + _between(_between(shift, 0), 1)) * cell[axis] - 0.5)
        rest[axis] = at_rest * cell[axis] - 0.5
    sunk = np.repeat(np.repeat(moved[..., 2], 2, axis=0), 2, axis=1)
    return np.stack((*nodes, scene.sheet.depth(*node_ray) + sunk)), rest


def _patch_edges(vertices: np.ndarray) -> np.ndarray:
    """Both edges of each vertex's patch along one axis [grid px], shape [2 n]."""
    return (vertices[:, None] + np.array([-HALF_PATCH, HALF_PATCH])).ravel()


def _between(values: np.ndarray, axis: int) -> np.ndarray:
    """Values at both edges of each patch along an axis, interpolated between the vertices; shape [..., 2 n, ...]."""
    values = np.moveaxis(values, axis, 0)
    before, after = np.concatenate((values[:1], values[:-1])), np.concatenate((values[1:], values[-1:]))
    edges = np.stack([(1 - HALF_PATCH) * values + HALF_PATCH * neighbour for neighbour in (before, after)], axis=1)
    return np.moveaxis(edges.reshape(-1, *values.shape[1:]), 0, axis)


def _rasterise(
    nodes: np.ndarray, attributes: np.ndarray, size: tuple[int, int]
) -> tuple[tuple[slice, slice], np.ndarray]:
    """Draw a lattice with a z-buffer.

    Args:
        nodes: column, row [px] and z [scene units] of the lattice's nodes, shape [3, h, w].
        attributes: values of the nodes, shape [K, h, w].
        size: width and height of the picture [px].

    Returns:
        The region of the picture that the lattice covers, and over it 1/z (0 where nothing is drawn) and each attribute
        over z, shape [1 + K, rows, columns]; these are linear in the picture.
    """
    u, v, depth = nodes.reshape(3, -1)
    values = np.stack([np.ones_like(depth), *attributes.reshape(len(attributes), -1)]) / depth
    index = np.arange(u.size).reshape(nodes.shape[1:])
    corners = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    first, below, opposite, right_of = (corner.ravel() for corner in corners)
    triangles = np.concatenate((np.stack((first, below, opposite)), np.stack((first, opposite, right_of))), axis=1)
    left, right = max(math.ceil(u.min()), 0), min(math.floor(u.max()), size[0] - 1)
    top, bottom = max(math.ceil(v.min()), 0), min(math.floor(v.max()), size[1] - 1)
    shape = (bottom - top + 1, right - left + 1)
    pixel, weights, triangle = _covered(u[triangles] - left, v[triangles] - top, shape)
    candidates = np.einsum("cn,kcn->kn", weights, values[:, triangles[:, triangle]])
    nearest = np.zeros(shape[0] * shape[1])
    np.maximum.at(nearest, pixel, candidates[0])
    winner = candidates[0] == nearest[pixel]
    drawn = np.zeros((len(values), nearest.size), np.float32)
    drawn[:, pixel[winner]] = candidates[:, winner]
    return (slice(top, bottom + 1), slice(left, right + 1)), drawn.reshape(-1, *shape)


def _covered(u: np.ndarray, v: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels that triangles cover.

    Args:
        u: columns of the corners, shape [3, F].
        v: rows of the corners, shape [3, F].

    Returns:
        Flat pixel [N], barycentric weights [3, N] and triangle [N] of every pixel centre inside a triangle.
    """
    tolerance = 1e-6  # so that pixels on a common edge belong to both triangles
    left, right = np.ceil(u.min(axis=0) - tolerance), np.floor(u.max(axis=0) + tolerance)
    top, bottom = np.ceil(v.min(axis=0) - tolerance), np.floor(v.max(axis=0) + tolerance)
    left, right = np.maximum(left, 0), np.minimum(right, shape[1] - 1)
    top, bottom = np.maximum(top, 0), np.minimum(bottom, shape[0] - 1)
    across = np.maximum(right - left + 1, 0).astype(np.int64)
    counts = across * np.maximum(bottom - top + 1, 0).astype(np.int64)
    triangle = np.repeat(np.arange(u.shape[1]), counts)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(counts) - counts, counts)
    column = left[triangle] + within % across[triangle]
    row = top[triangle] + within // across[triangle]
    du, dv = u[:, triangle] - column, v[:, triangle] - row
    areas = np.stack([du[i] * dv[j] - du[j] * dv[i] for i, j in ((1, 2), (2, 0), (0, 1))])
    total = areas.sum(axis=0)
    weights = areas / np.where(total == 0, np.inf, total)
    inside = (weights >= -tolerance).all(axis=0) & (total != 0)
    pixel = (row[inside] * shape[1] + column[inside]).astype(np.int64)
    return pixel, weights[:, inside], triangle[inside]
