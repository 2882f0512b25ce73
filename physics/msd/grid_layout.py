"""Rest shape of a grid mesh as planes of the pixel grid, and the part of it that a rollout computes.

The whole grid depends on nothing but the mesh, so it is laid out once and kept there; a rollout cuts its window out.
"""

from typing import NamedTuple

import numpy as np

from palpate.physics.jit import kernel
from palpate.physics.mesh import NORM_GUARD, Mesh

PITCHES = (80, 144, 272, 528, 1040)
"""Row lengths for which code is compiled on demand; no powers of two, whose planes would share cache sets."""

REST, LENGTH, LINK, MOBILE, REST_PLANES = 0, 3, 6, 9, 10
"""Planes of the rest shape: positions x, y, z; lengths and presence of the springs right, down, diagonal; may move."""


class GridLayout(NamedTuple):
    """A window of the grid around the load, and the pixels around the window."""

    pitch: int
    """Numbers a plane and row."""
    rest: np.ndarray
    """Rest shape, shape [rows·REST_PLANES·pitch]."""
    first: np.ndarray
    """First column from which vertices are computed in each row and one more, shape [rows + 1], int64.

    Behind ``last`` where there are none."""
    last: np.ndarray
    """Last column of them, shape [rows + 1], int64."""
    centre: tuple[int, int]
    """Row and column of the load's first vertex."""
    corner: tuple[int, int]
    """Grid row and column of the first pixel."""


class WholeGrid(NamedTuple):
    """Rest shape of a mesh without a load, padded by one pixel on every side."""

    rest: np.ndarray
    """Planes of the rest shape, shape [rows, REST_PLANES, columns]; the rim doesn't move."""
    first: np.ndarray
    """First column with a vertex in each row and one more, shape [rows + 1], int64; behind ``last`` if none has."""
    last: np.ndarray
    """Last column with a vertex, shape [rows + 1], int64."""
    corner: np.ndarray
    """Grid row and column of the first pixel, shape [2]."""


def grid_layout(mesh: Mesh, pressed: np.ndarray, reach: int, dtype: np.dtype) -> GridLayout | None:
    """Lay out the grid within ``reach`` pixels of a load.

    Args:
        mesh: the mesh.
        pressed: loaded vertices, which may move even on the rim; the first one is the window's centre, shape [P].
        reach: rows and columns around it that matter; all loaded vertices are in them.
        dtype: float32 or float64.

    Returns:
        None if the window is wider than the compiled code allows, or the mesh isn't a grid mesh: it has springs other
        than right, down and down-right, or two vertices on one pixel.
    """
    grid = _whole_grid(mesh, dtype)
    if grid is None:
        return None
    centre = mesh.pixels[pressed[0]] - grid.corner
    high = np.minimum(np.array(grid.rest.shape)[[0, 2]] - 2, centre + reach)
    low = np.maximum(1, centre - reach)
    rows, columns = (high - low + 3).tolist()
    pitch = next((size for size in PITCHES if size > columns), None)
    if pitch is None:
        return None
    (top, left), corner = (low - 1).tolist(), grid.corner + low - 1
    rest = np.zeros((rows, REST_PLANES, pitch), dtype)
    rest[:, :, :columns] = grid.rest[top : top + rows, :, left : left + columns]
    row, column = (mesh.pixels[pressed] - corner).T
    rest[row, MOBILE, column] = 1
    first = np.maximum(grid.first[top : top + rows + 1] - left, 1)
    last = np.minimum(grid.last[top : top + rows + 1] - left, columns - 2)
    return GridLayout(pitch, rest.ravel(), first, last, tuple((centre - low + 1).tolist()), tuple(corner.tolist()))


def places(layout: GridLayout, mesh: Mesh, vertices: np.ndarray, planes: int) -> np.ndarray:
    """Places of the window's vertices [M] in the first plane of a state of ``planes`` planes, shape [M], int64."""
    row, column = mesh.pixels[vertices].astype(np.int64).T
    return (row - layout.corner[0]) * planes * layout.pitch + column - layout.corner[1]


def _whole_grid(mesh: Mesh, dtype: np.dtype) -> WholeGrid | None:
    """Return the grid that is kept with a mesh, laid out at the first call; None where the mesh is no grid."""
    grids = mesh.grids
    if dtype not in grids:
        pixels = np.ascontiguousarray(mesh.pixels.T, dtype=np.int32)
        corner = pixels.min(axis=1) - 1
        rows, columns = (pixels.max(axis=1) - corner + 2).tolist()
        given = (mesh.vertices, dtype), (mesh.springs, np.int32), (pixels.T - corner, np.int32), (~mesh.rim, bool)
        arrays = (np.ascontiguousarray(values, dtype=kind) for values, kind in given)
        regular, rest, *ends = _filled(*arrays, rows, columns, dtype.type(NORM_GUARD))
        grids[dtype] = WholeGrid(rest.reshape(rows, REST_PLANES, columns), *ends, corner) if regular else None
    return grids[dtype]


@kernel
def _filled(vertices, springs, pixels, mobile, rows, columns, guard):
    """Return whether vertices [N, 3] and springs [S, 2] form a grid mesh; then its planes, first and last columns."""
    block = REST_PLANES * columns
    rest, taken = np.zeros(rows * block, vertices.dtype), np.zeros(rows * columns, np.bool_)
    first, last = np.full(rows + 1, columns), np.full(rows + 1, -1)
    for vertex in range(vertices.shape[0]):
        row, column = pixels[vertex, 0], pixels[vertex, 1]
        if taken[row * columns + column]:
            return False, rest, first, last
        taken[row * columns + column] = True
        place = row * block + column
        for axis in range(3):
            rest[place + (REST + axis) * columns] = vertices[vertex, axis]
        rest[place + MOBILE * columns] = mobile[vertex]
        first[row] = min(first[row], column)
        last[row] = max(last[row], column)
    for spring in range(springs.shape[0]):
        start, end = springs[spring, 0], springs[spring, 1]
        if (pixels[end, 0], pixels[end, 1]) < (pixels[start, 0], pixels[start, 1]):
            start, end = end, start
        row, column = pixels[start, 0], pixels[start, 1]
        down, right = pixels[end, 0] - row, pixels[end, 1] - column
        if not (0 <= down <= 1 and 0 <= right <= 1 and down + right > 0):
            return False, rest, first, last
        kind = 2 * down + right - 1
        near = row * block + column
        far = near + down * block + right
        squared = guard
        for axis in range(3):
            side = rest[far + axis * columns] - rest[near + axis * columns]
            squared += side * side
        rest[near + (LENGTH + kind) * columns] = np.sqrt(squared)
        rest[near + (LINK + kind) * columns] += 1
    return True, rest, first, last
