"""How well points of a drawn clip were followed: the size of their errors, and how far these are alike.

Measured, because the truth is known. Points with the same told noise count as equally good: what is told knows of an
instrument's edge in the window and of a way back that ends elsewhere. Sizes are robust ones, 1.48 times the median:
heavier tails than a normal distribution's only tell more of where its middle lies, so that
a bound made of them stays one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.distance import cdist

from palpate.common.robust import median_sd
from palpate.estimators.grip.whitening import matern

CLASSES = 0.12, 0.15, 0.2, 0.3, 0.5, 1.0, 4.0
"""Told noises between which points are equally good [px]."""
LEAST_ALIKE = 20
"""Fewer points of a class than this are as good as is told."""
OUTLYING = 3.0
"""Errors larger than so many standard deviations count as so many where correlations are measured."""


FAR, RINGS = 40.0, (6, 10)
"""Reach of errors that many points share [px], told by the correlation between points so many spacings apart."""
BESIDE = 120.0
"""Correlations count between points that began nearer to the tool: there motion tells of the foundation [px]."""


@dataclass(frozen=True, eq=False)
class Following:
    """Errors of n followed points in T frames; both axes err independently and alike."""

    sizes: np.ndarray
    """Standard deviation by axis in the last frame, shape [n] [px]."""
    reach: float
    """Neighbours' errors at a distance r have Matérn's correlation of 3/2, (1 + r/reach) exp(-r/reach) [px]."""
    shared: float
    """Share of the variance that reaches FAR instead."""
    in_time: np.ndarray
    """Covariance of the errors of any point in the frames over its variance in the last one, shape [T, T]."""

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """Of errors by axis at places [n, 2] [px] in the last frame, shape [n, n] [px²].

        Two points share what the better one of them errs by: an edge in one's window doesn't spoil the other's.
        """
        apart = cdist(points, points)
        alike = (1 - self.shared) * matern(apart / self.reach) + self.shared * matern(apart / FAR)
        return np.square(np.minimum(self.sizes[:, None], self.sizes)) * alike


def measure_following(
    points: np.ndarray, distance: np.ndarray, spacing: int, told: np.ndarray, errors: np.ndarray
) -> Following:
    """Measure how points were followed.

    Args:
        points: places at rest, on a square grid, shape [n, 2] [px].
        distance: from the tool there, shape [n] [px].
        spacing: of the grid [px].
        told: noise by axis in the last frame, shape [n] [px].
        errors: followed minus true place, shape [T, n, 2] [px]; not a number where a point is not seen, in the last
            frame none.
    """
    sizes, kind = told.astype(np.float64), np.digitize(told, CLASSES)
    for one in np.unique(kind):
        alike = kind == one
        if alike.sum() >= LEAST_ALIKE:
            sizes[alike] = median_sd(errors[-1, alike])
    scaled = np.clip(errors / sizes[:, None], -OUTLYING, OUTLYING)
    always = np.isfinite(scaled).all(axis=(0, 2))
    in_time = np.einsum("tna,sna->ts", scaled[:, always], scaled[:, always])
    near = distance < BESIDE
    rings = ring_correlation(points[near], spacing, scaled[-1][near])
    middle = sum(RINGS) / 2 * spacing
    shared = float(np.clip(rings[slice(*RINGS)].mean() / matern(np.array(middle / FAR)), 0.0, 0.5))
    own = float(np.clip((rings[1] - shared * matern(np.array(spacing / FAR))) / (1 - shared), 0.01, 0.99))
    # The first ring holds neighbours along axes and diagonals.
    ratio = float(brentq(lambda tried: matern(tried * np.sqrt([1.0, 2.0])).mean() - own, 1e-6, 20.0))
    return Following(sizes, spacing / ratio, shared, in_time / in_time[-1, -1])


def ring_correlation(points: np.ndarray, spacing: int, errors: np.ndarray) -> np.ndarray:
    """Correlation of errors [n, 2] of points on a grid [n, 2] by their distance, in spacings rounded, shape [R]."""
    cells = np.rint(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    shape = tuple(2 * (cells.max(axis=0) + 1))
    fields = np.zeros((3, *shape))
    fields[(0, *cells.T)] = 1
    fields[(slice(1, 3), *cells.T)] = errors.T
    pairs, *products = np.fft.irfft2(np.square(np.abs(np.fft.rfft2(fields))), shape)
    steps = (np.minimum(np.arange(side), side - np.arange(side)) for side in shape)
    rings = np.rint(np.hypot(*np.meshgrid(*steps, indexing="ij"))).astype(int).ravel()
    mean = np.bincount(rings, sum(products).ravel()) / np.maximum(np.bincount(rings, pairs.round().ravel()), 1)
    return mean / mean[0]
