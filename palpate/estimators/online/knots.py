"""A few numbers that stand for a field of stiffness: knots on the body, around which it changes by smooth bumps."""

import numpy as np
from scipy.linalg import block_diag

KNOTS = 12, 4
"""Knots of distances and of shapes; the cost goes with their number."""


def farthest(places: np.ndarray, first: int, count: int) -> list[int]:
    """Return indices of places [P, 3] that lie farthest from all before, one after the other, from a first one on.

    Args:
        places: P of them.
        first: index of the one to begin with.
        count: how many.
    """
    chosen, away = [first], np.linalg.norm(places - places[first], axis=1)
    while len(chosen) < count:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen


def bumps(rest: np.ndarray, knots: int) -> np.ndarray:
    """Return shares of particles in the knots, shape [N, knots], rows adding up to 1: every particle's own where they
    are few.

    Knots are particles as far from each other as can be, shares fall off as normal densities half a distance wide.

    Args:
        rest: positions at rest, shape [N, 3].
        knots: how many.
    """
    if knots >= len(rest):
        return np.eye(len(rest))
    chosen = farthest(rest, 0, knots)
    apart = np.linalg.norm(rest[:, None] - rest[chosen], axis=2)
    width = np.sort(apart[chosen], axis=1)[:, 1].mean() / 2
    nearest = apart.min(axis=1, keepdims=True)  # taken off, so that far from all knots one counts still
    shares = np.exp((nearest**2 - apart**2) / (2 * width**2))
    return shares / shares.sum(axis=1, keepdims=True)


def knot_shares(rest: np.ndarray, more: int = 0) -> tuple[list[np.ndarray], np.ndarray]:
    """Return for distances and for shapes `bumps` of either, and shares in the knots of both, shape [2, N, knots of
    both].

    Args:
        rest: positions at rest, shape [N, 3].
        more: numbers behind the knots, in which no particle shares.
    """
    parts = [bumps(rest, knots) for knots in KNOTS]
    return parts, np.pad(block_diag(*parts).reshape(2, len(rest), -1), ((0, 0), (0, 0), (0, more)))
