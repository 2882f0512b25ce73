"""How well a grip's foundation and force could be known at best: the Cramér–Rao bound of an endless sheet.

Known is the sheet, how well every followed point is followed and how far points err alike, in place and in time
(`evaluation.recovery.followed`). Unknown are the foundation, the forces at the instrument, in every frame anew, and the
background's affine motion; all but the foundation are nuisances, marginalised by their Schur complement. The forces act
where `estimators.grip.sheet` lets them act and are expected as they are there, which counts as seen: of forces
under a long shaft the picture tells little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from palpate.common.robust import affine_terms
from palpate.estimators.grip.sheet import SIZE, load_precision, loaded_cells
from palpate.evaluation.recovery.followed import Following
from palpate.physics.endless_sheet import response

STEP = 0.01
"""Of log foundation, for derivatives."""


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
    """Least standard deviations of logarithms."""

    foundation: float
    """Of foundation over stiffness, as if it were known that nothing is damped."""
    force: float
    """Of what holds the tissue in the last frame over stiffness, likewise."""
    damping: float
    """Of damping over stiffness, the foundation unknown."""


def grip_bound(
    points: np.ndarray,
    distance: np.ndarray,
    hidden: np.ndarray,
    spacing: int,
    times: np.ndarray,
    moved: np.ndarray,
    following: Following,
    log_anchor: float,
    relaxation: float,
) -> GripBound:
    """Bounds of a grip in a clip.

    Damping counts to first order, K u + k_d u̇ = f without inertia: u = K⁻¹ f - k_d K⁻² ḟ, and -K⁻² is what the
    foundation does. By its logarithm the motion changes as by log foundation, with relaxation · ḟ in the place of f.

    Args:
        points: places at rest of the points seen in the last frame, on a square grid, shape [n, 2] [px].
        distance: from the tool there, shape [n] [px].
        hidden: places of the grid that the tool hides there, shape [H, 2] [px].
        spacing: of the grid [px].
        times: of the frames, shape [T], at least two [s].
        moved: where they truly are since rest, shape [T, n, 2] [px].
        following: of these points.
        log_anchor: true log of foundation over stiffness.
        relaxation: true damping over foundation [s].
    """
    cells = np.rint(points / spacing).astype(np.int64)
    loaded = loaded_cells(points, distance, hidden, spacing)
    apart = tuple(np.moveaxis(cells[:, None] - loaded, -1, 0) % SIZE)
    terms = affine_terms(points)
    answer = response(math.exp(log_anchor), SIZE)
    kept = Whitened.of(following.covariance(points), np.hstack([answer[apart], terms]), load_precision(answer, loaded))
    more, less = (response(math.exp(log_anchor + step), SIZE)[apart] for step in (STEP, -STEP))
    loads = kept.explained(np.moveaxis(moved, 0, 1))[0][: len(loaded)]
    pulls = np.stack([loads, relaxation * np.gradient(loads, times, axis=1)], axis=-1)
    follows, left = kept.explained(np.tensordot((more - less) / (2 * STEP), pulls, 1))
    # Frames whose errors are alike in time: the same nuisances, free in each of them, take the same from all.
    information = np.einsum("ntap,ts,nsaq->pq", left, np.linalg.inv(following.in_time), left)
    force = loads[:, -1].sum(axis=0)
    along = force / (force @ force)
    # The force follows the foundation where both are estimated; where nothing is damped, that alone.
    bent = along @ follows[: len(loaded), -1, :, 0].sum(axis=0)
    variance = 1 / information[0, 0]
    return GripBound(
        math.sqrt(variance),
        math.sqrt(bent**2 * variance + (along @ along) * kept.sum_variance),
        math.sqrt(np.linalg.inv(information)[1, 1]) if np.linalg.det(information) > 0 else math.inf,
    )
