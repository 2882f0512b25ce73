"""The camera's own motion, and a breathing background's, taken off what tissue does."""

from __future__ import annotations

import numpy as np

from palpate.common.robust import affine_motion

FAR = 60.0
"""Points farther from the tool than this percentile are the background [%]."""
LEAST = 6
"""Fewer such points determine no affine motion."""


def far_points(moved: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Which of some points with displacements [N, 2] and distances [N] from the tool are the background, bool [N]."""
    known = np.asarray(np.isfinite(moved).all(axis=1))
    return known & (distance > np.percentile(distance[known], FAR)) if known.any() else known


def without_background(points: np.ndarray, moved: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Displacement less the affine motion of the points farthest from the tool, shape [N, 2] [px].

    Args:
        points: places at rest, shape [N, 2] [px].
        moved: displacements, shape [N, 2] [px]; not a number where a point is lost.
        distance: from the tool at rest, shape [N] [px].
    """
    far = far_points(moved, distance)
    if far.sum() < LEAST:
        return moved
    return moved - affine_motion(points, moved, far, points)
