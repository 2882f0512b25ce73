"""Springs of a grid mesh as a stencil on the pixel grid, laid out so that loops over columns become vector code.

A row of the grid is a block of planes, each `pitch` numbers long, one number a column. The pitch is a constant of the
compiled code: every plane then lies at a known distance from the others, which is what lets the compiler vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.physics.jit import kernel
from palpate.physics.mesh import Mesh
from palpate.physics.msd.reference import NORM_GUARD

PITCHES = (80, 144, 272, 528, 1040)
"""Row lengths for which code is compiled on demand; no powers of two, whose planes would share cache sets."""

REST, LENGTH, LINK, MOBILE, REST_PLANES = 0, 3, 6, 9, 10
"""Planes of the rest shape: positions x, y, z; lengths and presence of the springs right, down, diagonal; may move."""


class GridLayout(NamedTuple):
    """A window of the grid around the load, padded by one pixel on every side."""

    pitch: int
    """Numbers a plane and row."""
    rest: np.ndarray
    """Rest shape, shape [rows·REST_PLANES·pitch]."""
    first: np.ndarray
    """First column with a vertex in each padded row and one more, shape [rows + 1], int64.

    Behind ``last`` where there is none."""
    last: np.ndarray
    """Last column with a vertex in each of them, shape [rows + 1], int64."""
    centre: tuple[int, int]
    """Padded row and column of the load's first vertex."""
    corner: tuple[int, int]
    """Grid row and column of the padded window's first pixel."""


def grid_layout(mesh: Mesh, vertex: int, mobile: np.ndarray, reach: int, dtype: np.dtype) -> GridLayout | None:
    """Lay out what lies within ``reach`` pixels of a vertex.

    Args:
        mesh: the mesh.
        vertex: the window's centre.
        mobile: vertices that may move, shape [N], bool.
        reach: rows and columns around it that matter.
        dtype: float32 or float64.

    Returns:
        None where the mesh isn't a grid mesh (springs other than right, down and down-right, two vertices on one pixel)
        or the window is wider than the compiled code allows.
    """
    pixels = np.ascontiguousarray(mesh.pixels, dtype=np.int32)
    centre = pixels[vertex].astype(np.int64)
    low = np.maximum([pixels[:, axis].min() for axis in (0, 1)], centre - reach)
    high = np.minimum([pixels[:, axis].max() for axis in (0, 1)], centre + reach)
    rows, columns = (high - low + 1).tolist()
    pitch = next((size for size in PITCHES if size >= columns + 3), None)
    if pitch is None:
        return None
    vertices = np.ascontiguousarray(mesh.vertices, dtype=dtype)
    springs = np.ascontiguousarray(mesh.springs, dtype=np.int32)
    places = pixels - (low - 1).astype(np.int32)
    mobile = np.ascontiguousarray(mobile, dtype=bool)
    regular, rest, first, last = _filled(
        vertices, springs, places, mobile, rows, columns, pitch, dtype.type(NORM_GUARD)
    )
    if not regular:
        return None
    row, column = (centre - low + 1).tolist()
    return GridLayout(pitch, rest, first, last, (row, column), (int(low[0]) - 1, int(low[1]) - 1))


def places(layout: GridLayout, mesh: Mesh, vertices: np.ndarray, planes: int) -> np.ndarray:
    """Where vertices [M] of the window lie in the first plane of a state of ``planes`` planes, shape [M], int64."""
    row, column = mesh.pixels[vertices].astype(np.int64).T
    return (row - layout.corner[0]) * planes * layout.pitch + column - layout.corner[1]


@kernel
def _filled(vertices, springs, pixels, mobile, rows, columns, pitch, guard):
    """Whether vertices [N, 3] and springs [S, 2] form a grid mesh; then its planes, first and last columns."""
    block = REST_PLANES * pitch
    rest, taken = np.zeros((rows + 2) * block, vertices.dtype), np.zeros((rows + 2) * pitch, np.bool_)
    first, last = np.full(rows + 3, columns + 2), np.full(rows + 3, -1)
    for vertex in range(vertices.shape[0]):
        row, column = pixels[vertex, 0], pixels[vertex, 1]
        if 1 <= row <= rows and 1 <= column <= columns:
            if taken[row * pitch + column]:
                return False, rest, first, last
            taken[row * pitch + column] = True
            place = row * block + column
            for axis in range(3):
                rest[place + (REST + axis) * pitch] = vertices[vertex, axis]
            rest[place + MOBILE * pitch] = mobile[vertex]
            first[row] = min(first[row], column)
            last[row] = max(last[row], column)
    for spring in range(springs.shape[0]):
        start, end = springs[spring, 0], springs[spring, 1]
        if pixels[end, 0] < pixels[start, 0] or (
            pixels[end, 0] == pixels[start, 0] and pixels[end, 1] < pixels[start, 1]
        ):
            start, end = end, start
        row, column = pixels[start, 0], pixels[start, 1]
        down, right = pixels[end, 0] - row, pixels[end, 1] - column
        if not (0 <= down <= 1 and 0 <= right <= 1 and down + right > 0):
            return False, rest, first, last
        if row < 1 or row + down > rows or column < 1 or column + right > columns:
            continue
        kind = 2 * down + right - 1
        near = row * block + column
        far = near + down * block + right
        squared = guard
        for axis in range(3):
            side = rest[far + axis * pitch] - rest[near + axis * pitch]
            squared += side * side
        rest[near + (LENGTH + kind) * pitch] = np.sqrt(squared)
        rest[near + (LINK + kind) * pitch] += 1
    return True, rest, first, last
