"""The motion of the camera, or of a breathing background, and tissue's motion less that."""

import math
from typing import NamedTuple

import numpy as np

from palpate.common.robust import affine_motion

FAR = 60.0
"""Percentile of the distance from the tool beyond which points are background [%]."""
MIN_FAR = 6
"""Smallest number of such points that determine an affine motion."""
ITERATIONS = 6
"""Number of rounds of robust fits."""
LEAST_NOISE = 0.1
"""Least noise of tracks, by axis [px]."""
MEDIAN_LENGTH = 1.1774
"""Median length of a plane normal vector of unit standard deviation by axis."""


class Background(NamedTuple):
    """The affine motion of most of a picture."""

    affine: np.ndarray
    """Displacement at (column, row, 1) [px], shape [3, 2]."""
    noise: float
    """Standard deviation by axis of single points' displacement about it [px]."""
    error: float
    """Standard deviation by axis of the residual that neighbouring points share [px]."""

    def at(self, places: np.ndarray) -> np.ndarray:
        """Displacement at places [N, 2] (column, row) [px], shape [N, 2]."""
        return _terms(places) @ self.affine


def background_motion(places: np.ndarray, step: np.ndarray) -> Background | None:
    """Affine motion of most of some points, by least squares without those far off; None where they are too few.

    Args:
        places: places of the points in the first picture, shape [N, 2] (column, row) [px].
        step: their displacements, shape [N, 2] [px].
    """
    if len(places) < 30:
        return None
    terms, kept = _terms(places), np.ones(len(places), bool)
    outlier = 3.0  # standard deviations by which points that are no background move otherwise
    for _ in range(ITERATIONS):
        affine = np.linalg.lstsq(terms[kept], step[kept], rcond=None)[0]
        left = step - terms @ affine
        length = np.linalg.norm(left, axis=1)
        kept = length < outlier * max(np.median(length[kept]) / MEDIAN_LENGTH, LEAST_NOISE)
    # Moving tissue that is no background shall not count for all of it.
    scale = outlier * max(np.median(length) / MEDIAN_LENGTH, LEAST_NOISE)
    left = left.clip(-scale, scale)
    # Points of a square share what the background's motion leaves.
    _, block, count = np.unique(places // 64, axis=0, return_inverse=True, return_counts=True)
    block = block.ravel()
    shared = np.column_stack([np.bincount(block, weights=part) for part in left.T]) / count[:, None]
    own = np.linalg.norm((left - shared[block])[count[block] >= 3], axis=1)
    noise = float(np.median(own)) / MEDIAN_LENGTH if len(own) else 0.0
    error = math.sqrt(np.mean(np.square(shared)))
    return Background(affine, max(noise, LEAST_NOISE), max(error, LEAST_NOISE / 2))


def _terms(places: np.ndarray) -> np.ndarray:
    """Terms of an affine motion at places [N, 2], shape [N, 3]."""
    return np.column_stack([places, np.ones(len(places))]).astype(np.float64)


def without_background(points: np.ndarray, moved: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Displacement less the affine motion of the points farthest from the tool, shape [N, 2] [px].

    Args:
        points: places at rest, shape [N, 2] [px].
        moved: displacements, shape [N, 2] [px]; NaN where a point is lost.
        distance: from the tool at rest, shape [N] [px].
    """
    known = np.asarray(np.isfinite(moved).all(axis=1))
    far = known & (distance > np.percentile(distance[known], FAR)) if known.any() else known
    if far.sum() < MIN_FAR:
        return moved
    return moved - affine_motion(points, moved, far, points)
