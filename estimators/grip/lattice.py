"""Followed points as the nodes of a sheet, and fields over it that a few numbers give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

KNOT = 7
"""Distance between knots, in grid spacings of the points."""
TYPICAL_ANCHOR, SPREAD = 0.01, 3.0
"""Foundation over spring stiffness of tissue, and the standard deviation of its logarithm: almost anything."""
LEVEL = 0.1
"""Standard deviation of the mean log stiffness: with the foundation's it would only be a unit."""


def continued(points: np.ndarray, spacing: int, beyond: int) -> np.ndarray:
    """Nodes of the sheet, shape [M, 2] [px]: the points [N, 2], and behind them what is not seen.

    Tissue goes on behind the instrument and beyond the picture's edges; a sheet with a hole there, or that ends there,
    is pulled along with too little force.

    Args:
        beyond: how far it goes on beyond the points, in their spacings.
    """
    cells = np.rint(points / spacing).astype(np.int64)
    low, high = cells.min(axis=0) - beyond, cells.max(axis=0) + beyond
    hidden = np.ones(high - low + 1, bool)
    hidden[tuple((cells - low).T)] = False
    offset = points[0] - cells[0] * spacing
    return np.concatenate([points, (np.argwhere(hidden) + low) * spacing + offset])


def lattice_springs(points: np.ndarray, spacing: int) -> np.ndarray:
    """Pairs of neighbours on a square grid, diagonals included, shape [S, 2]; points [N, 2] (column, row) [px]."""
    cells = np.rint(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    number = np.full(cells.max(axis=0) + 2, -1)
    number[cells[:, 0], cells[:, 1]] = np.arange(len(cells))
    pairs = []
    for right, down in ((1, 0), (0, 1), (1, 1), (1, -1)):
        other = cells + np.array([right, down])
        # Below 0 the index wraps round to the last row, which is empty.
        found = number[other[:, 0], other[:, 1]]
        pairs.append(np.column_stack([np.arange(len(cells)), found])[found >= 0])
    return np.concatenate(pairs)


@dataclass(frozen=True, eq=False)
class Fields:
    """Log stiffness and log foundation of a sheet as linear functions of P numbers with a normal prior."""

    stiffness: csr_array
    """Log stiffness of every node from the numbers, shape [N, P]."""
    anchor: csr_array
    """Log foundation (over stiffness 1) of every node, shape [N, P]."""
    mean: np.ndarray
    """Of the prior, shape [P]."""
    precision: np.ndarray
    """Of the prior, shape [P, P]."""


def uniform(count: int) -> Fields:
    """One number: the foundation of N nodes whose stiffness is 1."""
    ones = csr_array(np.ones((count, 1)))
    return Fields(csr_array((count, 1)), ones, np.array([np.log(TYPICAL_ANCHOR)]), np.array([[SPREAD**-2]]))


def knotted(nodes: np.ndarray, count: int, spacing: int, roughness: float) -> Fields:
    """Both fields bilinear between knots, which span the points; beyond these as at their edge.

    Args:
        nodes: shape [N, 2] [px].
        count: so many of them, the first ones, are points.
        spacing: of the points [px].
        roughness: standard deviation of the difference between neighbouring knots.
    """
    points = nodes[:count]
    low, extent = points.min(axis=0), np.maximum(np.ptp(points, axis=0), spacing)
    shape = np.maximum(np.rint(extent / (KNOT * spacing)).astype(int), 1) + 1
    weights = bilinear(np.clip((nodes - low) / extent, 0, 1) * (shape - 1), shape)
    knots = int(np.prod(shape))
    smooth, level = smoothness(shape) / roughness**2, np.full((knots, knots), knots**-2.0)
    nothing = np.zeros(weights.shape)
    precision = np.zeros((2 * knots, 2 * knots))
    precision[:knots, :knots] = smooth + level / LEVEL**2
    precision[knots:, knots:] = smooth + level / SPREAD**2
    return Fields(
        csr_array(np.hstack([weights.toarray(), nothing])),
        csr_array(np.hstack([nothing, weights.toarray()])),
        np.repeat([0.0, np.log(TYPICAL_ANCHOR)], knots),
        precision,
    )


def smoothness(shape: np.ndarray) -> np.ndarray:
    """Sum of the squared differences between neighbours on a grid of K knots, as a matrix [K, K]."""
    number = np.arange(int(np.prod(shape))).reshape(tuple(shape))
    pairs = np.concatenate(
        [
            np.column_stack([number[1:].ravel(), number[:-1].ravel()]),
            np.column_stack([number[:, 1:].ravel(), number[:, :-1].ravel()]),
        ]
    )
    difference = np.zeros((len(pairs), number.size))
    rows = np.arange(len(pairs))
    difference[rows, pairs[:, 0]], difference[rows, pairs[:, 1]] = 1, -1
    return difference.T @ difference


def bilinear(places: np.ndarray, shape: np.ndarray) -> csr_array:
    """Weights of the knots of a grid at places [N, 2] in its units, shape [N, product of shape]."""
    corner = np.clip(places.astype(int), 0, np.maximum(shape - 2, 0))
    share = places - corner
    rows, columns, values = [], [], []
    for step in np.ndindex(2, 2):
        rows.append(np.arange(len(places)))
        columns.append(np.ravel_multi_index(tuple((corner + step).T), tuple(shape)))
        values.append(np.where(step, share, 1 - share).prod(axis=1))
    flat = [np.concatenate(part) for part in (values, rows, columns)]
    return csr_array((flat[0], (flat[1], flat[2])), (len(places), int(np.prod(shape))))
