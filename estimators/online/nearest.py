"""Nearest neighbours among the points of a surface by a flat grid: exact, and several times as fast as a tree.

A tree is built for many dimensions and any scatter. Tissue's surface fills two of its three axes evenly, so that a grid
of the two along which it is widest has a point a cell, and costs little enough to be made anew when the points move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.physics.jit import inlined, kernel

STRAYS = 0.02
"""The grid spans the points but for such a share at either end of an axis: what lies beyond belongs to its border, so
that strays don't widen the cells."""
BEGUN = 0.7
"""Radius of the first search, in cells: half a square's diagonal."""


@dataclass(frozen=True, eq=False)
class Grid:
    """n points by the cells that they lie in; made by `grid_of`."""

    points: np.ndarray
    """Ordered by cell, shape [n, 3]."""
    indices: np.ndarray
    """Which of the points given each is, shape [n]."""
    starts: np.ndarray
    """First point of every cell and their number, shape [rows · columns + 1]."""
    frame: tuple[int, int, float, float, float, int, int]
    """The two axes, where the cells begin along them, a cell's side, and how many cells along both."""

    def nearest(self, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squared distance [m] and index [m] of the point nearest to each of m places [m, 3]; of equals the first.

        Raises:
            ValueError: a place that is not finite.
        """
        _require_finite(queries)
        squared, index = np.empty(len(queries)), np.empty(len(queries), np.int64)
        search(np.ascontiguousarray(queries), self.points, self.indices, self.starts, self.frame, squared, index)
        return squared, index


def grid_of(points: np.ndarray) -> Grid:
    """Sort points [n, 3], one at least, into cells.

    Raises:
        ValueError: a point that is not finite, for which no cell can be told.
    """
    _require_finite(points)
    ordered, beyond = np.sort(points, axis=0), int(STRAYS * len(points))
    begin, spread = ordered[beyond], ordered[-1 - beyond] - ordered[beyond]
    first, second = (int(axis) for axis in np.argsort(-spread, kind="stable")[:2])
    wide, high = float(spread[first]), float(spread[second])
    side = max(np.sqrt(wide * high / len(points)), wide / len(points)) or 1.0
    counts = int(wide / side) + 1, int(high / side) + 1
    frame = first, second, float(begin[first]), float(begin[second]), float(side), *counts
    cell = np.empty(len(points), np.int64)
    place(points, frame, cell)
    indices = np.argsort(cell, kind="stable")
    starts = np.zeros(counts[0] * counts[1] + 1, np.int64)
    np.cumsum(np.bincount(cell, minlength=len(starts) - 1), out=starts[1:])
    return Grid(points[indices], indices, starts, frame)


def gathered(points: np.ndarray, index: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """How many of the points [m, 3] have each index below `count`, shape [count], and their sums, shape [count, 3]."""
    counts, sums = np.zeros(count), np.zeros((count, 3))
    gather(points, index, counts, sums)
    return counts, sums


def _require_finite(points: np.ndarray) -> None:
    if not np.isfinite(points).all():
        raise ValueError("a point to match is not finite: what is simulated has diverged, or a depth is no number.")


@inlined
def _along(value, low, side, count):
    """Cell of a coordinate: never less where that is more, so that no point between two lies outside of theirs."""
    return int(min(max((value - low) / side, 0.0), count - 1.0))


@kernel
def place(points, frame, cell):
    """Cell of every point [n, 3], written to `cell` [n]."""
    first, second, low, bottom, side, rows, columns = frame
    for index in range(points.shape[0]):
        row = _along(points[index, first], low, side, rows)
        cell[index] = row * columns + _along(points[index, second], bottom, side, columns)


@kernel
def search(queries, points, indices, starts, frame, squared, index):
    """Look within a radius that grows until something is found in it; arguments as `Grid.nearest` has them."""
    first, second, low, bottom, side, rows, columns = frame
    for query in range(queries.shape[0]):
        x, y, z = queries[query, 0], queries[query, 1], queries[query, 2]
        one, two = queries[query, first], queries[query, second]
        best, chosen, reach = np.inf, -1, BEGUN * side
        while True:
            left, right = _along(two - reach, bottom, side, columns), _along(two + reach, bottom, side, columns)
            for row in range(_along(one - reach, low, side, rows), _along(one + reach, low, side, rows) + 1):
                for at in range(starts[row * columns + left], starts[row * columns + right + 1]):
                    dx, dy, dz = x - points[at, 0], y - points[at, 1], z - points[at, 2]
                    apart = dx * dx + dy * dy + dz * dz
                    if apart < best or (apart == best and indices[at] < chosen):
                        best, chosen = apart, indices[at]
            if best <= reach * reach:
                break
            reach = min(2 * reach, np.sqrt(best) * (1 + 1e-12)) if chosen >= 0 else 2 * reach
        squared[query], index[query] = best, chosen


@kernel
def gather(points, index, counts, sums):
    """Add 1 and every point to the rows of its index."""
    for point in range(points.shape[0]):
        counts[index[point]] += 1
        for axis in range(3):
            sums[index[point], axis] += points[point, axis]
