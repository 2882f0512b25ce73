"""How well a grip's foundation and force could be known at best: the Cramér–Rao bound of an endless sheet.

Known is the sheet, how well every followed point is followed and how far the errors of points resemble each other, in
place and in time (`Following`). Unknown are the foundation, the forces at the instrument, in every frame anew, and the
background's affine motion; all but the foundation are nuisances, marginalised by their Schur complement. The forces act
where `estimators.grip.sheet` lets them act and are expected as they are there, which counts as observed: of
forces under a long shaft the picture tells little.

How points are followed is measured, because the truth is known. Points with the same stated noise count as equally
good: it knows of an instrument's edge in the window and of a way back that ends elsewhere. Sizes are robust ones, 1.48
times the median: heavier tails than a normal distribution's only tell more of where its middle lies, so that a bound
made of them stays one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import brentq
from scipy.spatial.distance import cdist

from palpate.common.robust import affine_terms, median_sd
from palpate.estimators.grip.sheet import SIZE, PointGrid, load_precision, loaded_cells
from palpate.estimators.grip.whitening import matern, pair_products
from palpate.physics.sheet import response

STEP = 0.01
"""Of log foundation, for derivatives."""
CLASSES = 0.12, 0.15, 0.2, 0.3, 0.5, 1.0, 4.0
"""Stated noises between which points are equally good [px]."""
MIN_CLASS = 20
"""Fewer points of a class than this are as good as is stated."""
OUTLYING = 3.0
"""Errors larger than so many standard deviations count as so many where correlations are measured."""
FAR, RINGS = 40.0, (6, 10)
"""Reach of errors that many points share [px], found by the correlation between points so many spacings apart."""
NEAR_TOOL = 120.0
"""Correlations count between points that began nearer to the tool: there motion shows the foundation [px]."""


@dataclass(frozen=True, eq=False)
class Following:
    """Errors of n followed points in T frames; both axes err independently, by the same distribution."""

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
        correlation = (1 - self.shared) * matern(apart / self.reach) + self.shared * matern(apart / FAR)
        return np.square(np.minimum(self.sizes[:, None], self.sizes)) * correlation


def measure_following(grid: PointGrid, noise: np.ndarray, errors: np.ndarray) -> Following:
    """Measure how points were followed.

    Args:
        grid: n points.
        noise: stated by axis in the last frame, shape [n] [px].
        errors: followed minus true place, shape [T, n, 2] [px]; not a number where a point is not in view, in the last
            frame none.
    """
    sizes, kind = noise.astype(np.float64), np.digitize(noise, CLASSES)
    for one in np.unique(kind):
        members = kind == one
        if members.sum() >= MIN_CLASS:
            sizes[members] = median_sd(errors[-1, members])
    scaled = np.clip(errors / sizes[:, None], -OUTLYING, OUTLYING)
    always = np.isfinite(scaled).all(axis=(0, 2))
    in_time = np.einsum("tna,sna->ts", scaled[:, always], scaled[:, always])
    near, spacing = grid.distance < NEAR_TOOL, grid.spacing
    rings = ring_correlation(grid.points[near], spacing, scaled[-1][near])
    middle = sum(RINGS) / 2 * spacing
    shared = float(np.clip(rings[slice(*RINGS)].mean() / matern(np.array(middle / FAR)), 0.0, 0.5))
    own = float(np.clip((rings[1] - shared * matern(np.array(spacing / FAR))) / (1 - shared), 0.01, 0.99))
    # The first ring holds neighbours along axes and diagonals.
    ratio = float(brentq(lambda tried: matern(tried * np.sqrt([1.0, 2.0])).mean() - own, 1e-6, 20.0))
    return Following(sizes, spacing / ratio, shared, in_time / in_time[-1, -1])


def ring_correlation(points: np.ndarray, spacing: int, errors: np.ndarray) -> np.ndarray:
    """Correlation of errors [n, 2] of points on a grid [n, 2] by their distance, in spacings rounded, shape [R]."""
    rings, pairs, products = pair_products(points, spacing, errors)
    mean = np.bincount(rings, products) / np.maximum(np.bincount(rings, pairs), 1)
    return mean / mean[0]


@dataclass(frozen=True, eq=False)
class Whitened:
    """What nuisances leave of n points whose errors are whitened; M places are loaded."""

    triangle: np.ndarray
    """Of the errors' covariance in the last frame, lower, shape [n, n] [px]."""
    design: np.ndarray
    """How points follow loads and background, whitened, shape [n, M + 3]."""
    factor: tuple[np.ndarray, bool]
    """Cholesky's, of the nuisances' information."""

    @classmethod
    def of(cls, covariance: np.ndarray, design: np.ndarray, expected: np.ndarray) -> Whitened:
        """Of errors with a covariance [n, n] [px²], a design [n, M + 3] and a prior precision of the nuisances."""
        triangle = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        rows = solve_triangular(triangle, design, lower=True, check_finite=False)
        return cls(triangle, rows, cho_factor(rows.T @ rows + expected, check_finite=False))

    def explained(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nuisances [M + 3, …] that explain values at the points [n, …] best, and what is left, whitened."""
        right = solve_triangular(self.triangle, values.reshape(len(values), -1), lower=True, check_finite=False)
        found = cho_solve(self.factor, self.design.T @ right, check_finite=False)
        left = (right - self.design @ found).reshape(values.shape)
        return found.reshape(-1, *values.shape[1:]), left

    @property
    def sum_variance(self) -> float:
        """Of the sum of the loads by axis, in the last frame."""
        total = np.append(np.ones(self.design.shape[1] - 3), np.zeros(3))
        return float(total @ cho_solve(self.factor, total, check_finite=False))


class GripBound(NamedTuple):
    """Least standard deviations of logarithms, as if it were known that nothing is damped."""

    foundation: float
    """Of foundation over stiffness."""
    force: float
    """Of what holds the tissue in the last frame over stiffness."""


def grip_bound(grid: PointGrid, moved: np.ndarray, following: Following, log_anchor: float) -> GripBound:
    """Bounds of a grip in a clip.

    Args:
        grid: of the points in view in the last frame, n of them.
        moved: where they truly are since rest, shape [T, n, 2] [px].
        following: of these points.
        log_anchor: true log of foundation over stiffness.
    """
    points, loaded = grid.points, loaded_cells(grid)
    cells = np.rint(points / grid.spacing).astype(np.int64)
    apart = tuple(np.moveaxis(cells[:, None] - loaded, -1, 0) % SIZE)
    terms = affine_terms(points)
    answer = response(math.exp(log_anchor), SIZE)
    kept = Whitened.of(following.covariance(points), np.hstack([answer[apart], terms]), load_precision(answer, loaded))
    more, less = (response(math.exp(log_anchor + step), SIZE)[apart] for step in (STEP, -STEP))
    loads = kept.explained(np.moveaxis(moved, 0, 1))[0][: len(loaded)]
    follows, left = kept.explained(np.tensordot((more - less) / (2 * STEP), loads, 1))
    # Frames whose errors are correlated in time: the same nuisances, free in each of them, take the same from all.
    information = np.einsum("nta,ts,nsa->", left, np.linalg.inv(following.in_time), left)
    force = loads[:, -1].sum(axis=0)
    along = force / (force @ force)
    # The force follows the foundation where both are estimated.
    bent = along @ follows[: len(loaded), -1].sum(axis=0)
    variance = 1 / float(information)
    return GripBound(math.sqrt(variance), math.sqrt(bent**2 * variance + (along @ along) * kept.sum_variance))
