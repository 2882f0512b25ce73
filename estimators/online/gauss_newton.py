"""Recursive Gauss–Newton steps of the fields, in place of Adam's (Ljung & Söderström 1983, section 3.3).

Besides the state that is mapped, a simulation is carried along that is drawn to it by a small share a frame only: what
it is off by tells of the fields over tens of frames, where one time step tells little next to its noise. As many more,
each with one knot's stiffness changed, give the derivatives; their squares add up over frames, older ones forgotten. A
norm ‖r‖ has at r no more than the quadratic ½‖r‖²/‖r₀‖ + ½‖r₀‖ above it, which touches it there and is minimised.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag, solve

from palpate.estimators.online.objective import Objective, Terms
from palpate.physics.pbd.stiffness import Stiffness

KNOTS = 12, 4
"""Of distances and of shapes, from which fields change by smooth bumps; the cost goes with their number."""
DRAWN = 0.015
"""Share by which the simulations that are carried along are drawn to the mapped state a frame. Begun anew from states
that were mapped a few frames ago, which aren't the model's own, they tell how these fall back, not of stiffness."""
KEPT = 0.97
"""Share of the past frames' squares a frame."""
SMOOTHNESS = 0.3
"""Of squared differences between knots next to each other, where the weight of smoothness is 1."""
ANCHOR = 0.01
"""Of squared changes since the start: what no residual shows stays as it was."""
LONGEST = 0.3
"""Longest step of a knot's logit a frame."""
CHANGE = 0.01
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


def knot_shares(rest: np.ndarray, more: int = 0) -> tuple[list[np.ndarray], np.ndarray]:
    """Of distances and of shapes: `bumps` of either, and shares in the knots of both, shape [2, N, knots of both].

    Args:
        rest: positions at rest, shape [N, 3].
        more: numbers behind the knots, in which no particle shares.
    """
    parts = [bumps(rest, knots) for knots in KNOTS]
    both = block_diag(*parts).reshape(2, len(rest), -1)
    return parts, np.pad(both, ((0, 0), (0, 0), (0, more)))


def roughness(rest: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """R of Σ wᵢⱼ (θᵢ - θⱼ)² = θᵀRθ over knots, w a normal density as wide as knots are apart, shape [knots, knots].

    Args:
        rest: positions at rest, shape [N, 3].
        shares: as `bumps` gives them.
    """
    knots = rest[shares.argmax(axis=0)]
    apart = np.linalg.norm(knots[:, None] - knots, axis=2)
    weights = np.exp(-((apart / np.sort(apart, axis=1)[:, 1].mean()) ** 2) / 2)
    np.fill_diagonal(weights, 0.0)
    return np.diag(weights.sum(axis=1)) - weights


class GaussNewton:
    """One clip's optimiser.

    Args:
        objective: body, grip, bounds and weights (of gap and smoothness).
        begun: fields to begin with, shape [N].
    """

    def __init__(self, objective: Objective, begun: Stiffness) -> None:
        self._objective, self._volume = objective, float(begun.volume)
        self._begun = objective.bounds.logits(begun)
        rest = objective.body.rest
        parts, self._shares = knot_shares(rest)
        total = self._shares.shape[2]
        rough = block_diag(*(roughness(rest, part) for part in parts))
        self._prior = ANCHOR * np.eye(total) + SMOOTHNESS * objective.weights.smoothness * rough
        self._curvature, self._pull = np.zeros((total, total)), np.zeros(total)
        self._knots = np.zeros(total)
        self._carried = np.repeat(rest[None], total + 1, axis=0)

    @property
    def fields(self) -> Stiffness:
        """As they are, shape [N]."""
        return self._objective.bounds.fields(self._begun + self._shares @ self._knots, self._volume)

    def carry(self, places: np.ndarray) -> None:
        """Step the simulations on, the gripped particles led to these places [G, 3] [m]."""
        changes = np.concatenate([np.zeros((1, len(self._knots))), CHANGE * np.eye(len(self._knots))]) + self._knots
        logits = self._begun + np.einsum("fnk,sk->sfn", self._shares, changes)
        fields = self._objective.bounds.fields(logits.transpose(1, 0, 2), self._volume)
        self._carried = self._objective.carried(fields, self._carried, places)

    def step(self, mapped: np.ndarray) -> Terms:
        """Change the fields by what the simulations are off a mapped state.

        Args:
            mapped: where particles are, as `carry` was led to, shape [N, 3] [m].

        Returns:
            What is minimised, before the step: the gap is that of the simulation carried along; no snapshots count.
        """
        weights, edge = self._objective.weights, self._objective.edge
        off = (mapped - self._carried[0]).ravel()
        slopes = (self._carried[1:] - self._carried[0]).reshape(len(self._knots), -1).T / CHANGE
        size = float(np.linalg.norm(off))
        terms = Terms(weights.gap * size / edge, 0.0, 0.5 * float(self._knots @ self._prior @ self._knots))
        weight = weights.gap / (edge * max(size, edge))
        self._curvature = KEPT * self._curvature + weight * slopes.T @ slopes
        self._pull = KEPT * self._pull + weight * slopes.T @ (off + slopes @ self._knots)
        way = solve(self._curvature + self._prior, self._pull, assume_a="pos") - self._knots
        way *= min(1.0, LONGEST / max(float(np.abs(way).max()), 1e-300))
        self._knots = self._knots + way
        # As if they had been led by these fields all along: what remains of former ones would count again.
        self._carried = self._carried + (slopes @ way).reshape(mapped.shape)
        self._carried = self._carried + DRAWN * (mapped - self._carried)
        return terms
