"""Triangulated tissue surface from a depth grid: vertices, springs, held rim, contact; and matrices of any springs.

Source: Bini 2026, section 3.2.2 (grid triangulation, edge filter, decimation, equations 4 to 8).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.sparse import coo_array, csr_array
from scipy.spatial import Delaunay, KDTree

NORM_GUARD = 1e-18
"""Addend under square roots of squared lengths, so that a length of zero has a gradient."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A spring mesh in camera coordinates, every vertex of which is a pixel of the depth grid."""

    vertices: np.ndarray
    """Positions at rest, shape [N, 3], float32 [scene units]."""
    triangles: np.ndarray
    """Vertex indices, shape [F, 3], int32."""
    springs: np.ndarray
    """Unique edges of the triangles, shape [S, 2], int32, the smaller index first."""
    rim: np.ndarray
    """Vertices that are held, unless they are pressed, shape [N], bool; edges against the occluder aren't rim."""
    pixels: np.ndarray
    """Row and column of every vertex in the grid, shape [N, 2], int32."""
    grid_shape: tuple[int, int]
    """Height and width of the grid [px]."""

    @cached_property
    def grids(self) -> dict[Any, Any]:
        """Layouts of the mesh by their type of number, kept for the next rollout (`msd.grid_layout`); not pickled."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "grids"}


def grid_mesh(
    points: np.ndarray,
    valid: np.ndarray,
    occluder: np.ndarray | None = None,
    max_edge: float = 0.05,
    keep: float = 1.0,
    *,
    alternating: bool = False,
) -> Mesh:
    """Triangulate the valid pixels of a back-projected depth grid (Bini 2026, section 3.2.2).

    Every 2×2 cell gives two triangles, split along the diagonal from top left to bottom right. Vertices that no
    triangle uses are left out, so the mesh may be empty.

    Args:
        points: camera coordinates of the pixels, shape [H, W, 3] [scene units].
        valid: pixels that show tissue with a valid depth, shape [H, W], bool.
        occluder: pixels that hide tissue (the tool), shape [H, W], bool.
        max_edge: triangles with a longer edge span a depth discontinuity and are dropped [scene units].
        keep: share of the pixels that are kept as vertices, in (0, 1]; the paper's decimation is 0.3.
        alternating: every other cell is split along its other diagonal, where all pixels are kept: no direction is then
            stiffer than the one across it.

    Raises:
        ValueError: shapes that don't fit.
    """
    points = np.asarray(points, dtype=np.float32)
    valid = np.asarray(valid, dtype=bool)
    if points.ndim != 3 or points.shape[2] != 3 or valid.shape != points.shape[:2]:
        raise ValueError(f"points have shape {points.shape} and valid {valid.shape}; give [H, W, 3] and [H, W].")
    if occluder is not None and np.shape(occluder) != valid.shape:
        raise ValueError(f"occluder has shape {np.shape(occluder)}; give the grid's shape {valid.shape}.")
    valid = valid & np.isfinite(points).all(axis=2)
    triangles = _grid_triangles(valid, alternating) if keep == 1 else _decimated_triangles(valid, keep)
    corners = points.reshape(-1, 3)[triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    return _compact(points, triangles[(lengths <= max_edge).all(axis=1)], occluder, 1 / math.sqrt(keep))


def nearest_vertex(mesh: Mesh, point: np.ndarray) -> int:
    """Index of the vertex nearest to a point (Bini 2026, equation 4).

    Args:
        mesh: a mesh of at least one vertex.
        point: position, shape [3] [scene units].

    Raises:
        ValueError: the mesh is empty.
    """
    if len(mesh.vertices) == 0:
        raise ValueError("the mesh has no vertices; a contact needs tissue with valid depth.")
    return int(np.argmin(np.square(mesh.vertices - np.asarray(point)).sum(axis=1)))


def holding(corners: np.ndarray, points: np.ndarray, candidates: int) -> tuple[np.ndarray, np.ndarray]:
    """Simplex that holds each point, or else is the least way off, and where in it that is.

    Args:
        corners: corners of triangles in a plane or of tetrahedra, shape [F, D + 1, D]; none is flat.
        points: shape [P, D].
        candidates: number of simplices compared, those whose centres are closest.

    Returns:
        shapes [P] and, as barycentric coordinates, [P, D + 1].
    """
    count = min(candidates, len(corners))
    near = KDTree(corners.mean(axis=1)).query(points, k=count)[1].reshape(len(points), count)
    inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    inner = np.einsum("pkj,pkji->pki", points[:, None] - corners[near, 0], inverse[near])
    shares = np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)
    best, rows = shares.min(axis=2).argmax(axis=1), np.arange(len(points))
    return near[rows, best], shares[rows, best]


def grid_springs(shape: tuple[int, int], down: int, right: int) -> np.ndarray:
    """Springs [S, 2] of a grid's nodes, numbered row by row, to nodes some rows below and columns to the right."""
    number = np.arange(math.prod(shape)).reshape(shape)
    here = number[: shape[0] - down, max(-right, 0) : shape[1] - max(right, 0)]
    there = number[down:, max(right, 0) : shape[1] - max(-right, 0)]
    return np.stack([here.ravel(), there.ravel()], axis=1)


def incidence(springs: np.ndarray, count: int) -> csr_array:
    """Matrix that sums forces of springs [S, 2] at `count` nodes, shape [count, S]: 1 at the first of each, else -1."""
    number, signs = np.arange(len(springs)), np.repeat([1.0, -1.0], len(springs))
    return csr_array((signs, (springs.T.ravel(), np.tile(number, 2))), shape=(count, len(springs)))


def laplacian(springs: np.ndarray, stiffness: np.ndarray, anchor: np.ndarray) -> csr_array:
    """K of nodes that springs and a foundation hold, each axis alone, shape [N, N].

    Args:
        springs: node indices, shape [S, 2].
        stiffness: stiffness of each spring, shape [S].
        anchor: stiffness of every node's foundation, shape [N].
    """
    (one, two), number = springs.T, np.arange(len(anchor) + 1)
    ties = coo_array((np.tile(stiffness, 2), (np.r_[one, two], np.r_[two, one])), (len(anchor), len(anchor))).tocsr()
    return csr_array((ties.sum(axis=1) + anchor, number[:-1], number)) - ties


def crosses(corners: np.ndarray) -> np.ndarray:
    """Twice the area times the normal of triangles [..., 3, 3], towards where they are anticlockwise, [..., 3]."""
    return np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])


def contact_normal(mesh: Mesh, vertex: int) -> np.ndarray:
    """Unit normal at a vertex: area-weighted mean of the incident faces' normals (Bini 2026, equations 5 to 8).

    Oriented towards the camera, which sits at the origin. Where the faces have no area or cancel out, the
    direction to the camera stands in.

    Returns:
        Unit vector, shape [3], float64.
    """
    position = mesh.vertices[vertex].astype(np.float64)
    incident = mesh.triangles[(mesh.triangles == vertex).any(axis=1)]
    corners = mesh.vertices[incident].astype(np.float64)
    normals = crosses(corners)
    # What a camera sees faces it, whichever way the triangle is wound.
    normals *= np.where((normals * corners[:, 0]).sum(axis=1, keepdims=True) > 0, -1.0, 1.0)
    normal = normals.sum(axis=0)
    length = np.linalg.norm(normal)
    if length < np.finfo(np.float32).tiny:
        normal, length = -position, np.linalg.norm(position)
    return normal / length if length > 0 else np.array([0.0, 0.0, -1.0])


def _grid_triangles(valid: np.ndarray, alternating: bool) -> np.ndarray:
    """Triangles [F, 3] of flat pixel indices: two a 2×2 cell, where all three pixels are valid."""
    index = np.arange(valid.size).reshape(valid.shape)
    top_left, top_right = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    bottom_left, bottom_right = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    lower = np.stack([top_left, bottom_left, bottom_right], axis=1)
    upper = np.stack([top_left, bottom_right, top_right], axis=1)
    if alternating:
        other = (np.indices(index[1:, 1:].shape).sum(axis=0) % 2 == 1).reshape(-1, 1)
        lower = np.where(other, np.stack([top_left, bottom_left, top_right], axis=1), lower)
        upper = np.where(other, np.stack([top_right, bottom_left, bottom_right], axis=1), upper)
    triangles = np.concatenate([lower, upper])
    return triangles[valid.ravel()[triangles].all(axis=1)]


def _decimated_triangles(valid: np.ndarray, keep: float) -> np.ndarray:
    """Delaunay triangles [F, 3] of flat pixel indices over an evenly spaced share of the valid pixels."""
    spacing = 1 / math.sqrt(keep)
    kept = np.zeros_like(valid)
    rows, columns = (np.round(np.arange(0, size - 0.5, spacing)).astype(int) for size in valid.shape)
    kept[np.ix_(rows[rows < valid.shape[0]], columns[columns < valid.shape[1]])] = True
    pixels = np.argwhere(kept & valid)
    if len(pixels) < 3 or np.linalg.matrix_rank(pixels - pixels[0]) < 2:
        return np.empty((0, 3), dtype=np.int64)
    triangles = Delaunay(pixels).simplices
    corners = pixels[triangles]
    # Delaunay fills the convex hull: drop what bridges a hole, a gap or a bay of the mask.
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    probes = np.concatenate([middles, corners.mean(axis=1, keepdims=True)], axis=1)
    rows, columns = np.floor(probes + 0.5).astype(int).transpose(2, 0, 1)
    inside = valid[rows, columns].all(axis=1)
    short = (np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2) <= 3 * spacing).all(axis=1)
    return (pixels[:, 0] * valid.shape[1] + pixels[:, 1])[triangles[inside & short]]


def _compact(points: np.ndarray, triangles: np.ndarray, occluder: np.ndarray | None, spacing: float) -> Mesh:
    """Number the used pixels and derive springs and rim; ``triangles`` [F, 3] holds flat pixel indices."""
    height, width = points.shape[:2]
    shown = np.zeros(height * width, bool)
    shown[triangles] = True
    used, triangles = np.flatnonzero(shown), (np.cumsum(shown) - 1)[triangles].astype(np.int32)
    pixels = np.stack(np.unravel_index(used, (height, width)), axis=1).astype(np.int32)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys, counts = np.unique(edges[:, 0].astype(np.int64) * len(used) + edges[:, 1], return_counts=True)
    springs = np.stack([keys // max(len(used), 1), keys % max(len(used), 1)], axis=1)
    rim = np.zeros(len(used), dtype=bool)
    rim[springs[counts == 1]] = True
    if occluder is not None and np.any(occluder):
        # A boundary within two pixels of the occluder is hidden: resizing leaves up to one invalid pixel between both.
        reach = 2 * math.ceil(2 * spacing) + 1
        hidden = maximum_filter(np.asarray(occluder, dtype=bool).view(np.uint8), reach, mode="constant") > 0
        rim &= ~hidden[pixels[:, 0], pixels[:, 1]]
    vertices = points.reshape(-1, 3)[used]
    return Mesh(vertices, triangles, springs.astype(np.int32), rim, pixels, grid_shape=(height, width))


def focal_length(mesh: Mesh) -> np.ndarray:
    """Focal lengths along x and y, from the places of the mesh's vertices in its grid, shape [2] [grid pixels]."""
    some = np.s_[:: max(1, len(mesh.vertices) // 1000)]  # all lie on the same two lines
    rays = mesh.vertices[some, :2].astype(np.float64) / mesh.vertices[some, 2:]
    places = mesh.pixels[some, ::-1].astype(np.float64)
    rays, places = rays - rays.mean(axis=0), places - places.mean(axis=0)
    return (rays * places).sum(axis=0) / np.square(rays).sum(axis=0)
