"""Gauss–Newton steps on the objective's residuals, in place of Adam's (Levenberg 1944, Marquardt 1963).

Fields change by smooth bumps around a few knots. A norm ‖r‖ has, at its residual r, no more than the quadratic
½‖r‖²/‖r₀‖ + ½‖r₀‖ above it, which touches it there; so have absolute differences of neighbours. The step goes to the
minimum of these, with the residuals taken as linear.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve

from estimators.online.objective import Evaluation, Objective
from physics.pbd.stiffness import Stiffness

KNOTS = 12
"""Of either field; the cost goes with their number."""
DAMPING = 0.1
"""Added to the diagonal, of its mean: combinations that no residual shows stay as they are."""
LONGEST = 0.5
"""Longest step of a particle's logit: residuals are linear for as much."""
TURN = 0.02
"""Differences of neighbours below this share of the bound count as its square does: an absolute value has no slope."""
CHANGE = 1e-4
"""Of logits, for finite differences."""


def bumps(rest: np.ndarray, knots: int) -> np.ndarray:
    """Shares of particles in the knots, shape [N, knots], rows adding up to 1: every particle's own where they are few.

    Knots are particles as far from each other as can be, shares fall off as normal densities half a distance wide.

    Args:
        rest: positions at rest, shape [N, 3].
        knots: how many.
    """
    if knots >= len(rest):
        return np.eye(len(rest))
    chosen, away = [0], np.linalg.norm(rest - rest[0], axis=1)
    while len(chosen) < knots:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(rest - rest[chosen[-1]], axis=1))
    apart = np.linalg.norm(rest[:, None] - rest[chosen], axis=2)
    width = np.sort(apart[chosen], axis=1)[:, 1].mean() / 2
    nearest = apart.min(axis=1, keepdims=True)  # taken off, so that far from all knots one counts still
    shares = np.exp((nearest**2 - apart**2) / (2 * width**2))
    return shares / shares.sum(axis=1, keepdims=True)


class GaussNewton:
    """One clip's optimiser.

    Args:
        objective: whose fields are changed.
        knots: of either field.
    """

    def __init__(self, objective: Objective, knots: int = KNOTS) -> None:
        self._objective = objective
        self._bumps = bumps(objective.body.rest, knots)

    def step(
        self,
        logits: np.ndarray,
        found: Evaluation,
        fields: Stiffness,
        start: np.ndarray,
        places: np.ndarray,
        snapshots: Sequence[np.ndarray],
    ) -> np.ndarray:
        """Logits [2, N] after one step from what `Objective.evaluate` found by the same arguments."""
        objective, shares = self._objective, self._bumps
        count, volume = shares.shape[1], float(fields.volume)
        slopes = objective.bounds.by_logits(fields, found.slopes) @ shares
        changes = np.zeros((2 * count, 2, len(shares)))
        changes[:count, 0] = changes[count:, 1] = CHANGE * shares.T
        ahead = objective.bounds.fields((logits + changes).transpose(1, 0, 2), volume)
        jacobian = objective.responses(fields, ahead, found, start, places, snapshots) / CHANGE
        curvature = jacobian.T @ jacobian
        for which, (field, bound) in enumerate(
            ((fields.distance, objective.bounds.distance), (fields.shape, objective.bounds.shape))
        ):
            by_logit = field * (1 - field / bound)
            roughness = objective.differences @ (by_logit[:, None] * shares)
            apart = np.maximum(np.abs(objective.differences @ field), TURN * bound)
            own = slice(which * count, (which + 1) * count)
            weight = objective.weights.smoothness / (bound * len(apart))
            curvature[own, own] += weight * roughness.T @ (roughness / apart[:, None])
        size = np.trace(curvature) / len(curvature)
        if size == 0:
            return logits
        moved = -solve(curvature + DAMPING * size * np.eye(len(curvature)), slopes.ravel(), assume_a="pos")
        change = moved.reshape(2, count) @ shares.T
        return logits + change * min(1.0, LONGEST / max(float(np.abs(change).max()), 1e-300))
