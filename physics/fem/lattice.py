"""Tetrahedra that fill the cells of a regular grid, five each, as Frank 2010's mesher does (Spillmann 2006)."""

from __future__ import annotations

import numpy as np

_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
_EVEN = np.array([[0, 4, 2, 1], [6, 2, 4, 7], [5, 1, 7, 4], [3, 1, 2, 7], [1, 4, 2, 7]])
"""Corners of the five tetrahedra of a cell, as rows of `_CORNERS`."""
_ODD = (_EVEN ^ 4)[:, [0, 2, 1, 3]]
"""Of its neighbours: mirrored, so that the diagonals of shared faces agree."""


def fill_cells(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and tetrahedra of some cells of a grid.

    Args:
        inside: which cells, shape [I, J, K], bool.

    Returns:
        the nodes' grid coordinates, shape [N, 3], int64; corners of the tetrahedra, shape [5·cells, 4].
    """
    cells = np.argwhere(inside)
    shape = np.array(inside.shape) + 1
    at = np.ravel_multi_index(tuple((cells[:, None] + _CORNERS).transpose(2, 0, 1)), tuple(shape))
    even = cells.sum(axis=1) % 2 == 0
    tetrahedra = np.where(even[:, None, None], at[:, _EVEN], at[:, _ODD]).reshape(-1, 4)
    used, corners = np.unique(tetrahedra, return_inverse=True)
    return np.stack(np.unravel_index(used, tuple(shape)), axis=1), corners.reshape(-1, 4)


def box(lengths: tuple[float, float, float], cells: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A block from the origin on.

    Args:
        lengths: of its sides [m].
        cells: along them.

    Returns:
        nodes, shape [N, 3] [m]; corners of the tetrahedra, shape [E, 4].
    """
    places, corners = fill_cells(np.ones(cells, bool))
    return places * (np.asarray(lengths) / np.asarray(cells)), corners
