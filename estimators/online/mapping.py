"""Residual mapping: the deformation that takes a simulated state to what was seen of it (Liang 2024, equation 6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from palpate.estimators.online.matching import Match
from palpate.physics.pbd.potential import Potential


@dataclass(frozen=True)
class Mapping:
    """How the deformation is searched.

    Raises:
        ValueError: a value out of range.
    """

    steps: int = 30
    """Gradient steps (section II-B)."""
    rate: float = 50.0
    """Of them at 600 particles (section II-B); with n it is rate·n/600, since means over n shrink as 1/n. Lengths may
    have any unit: both terms are squares of lengths. A particle that more of what was seen hangs on than that bears,
    as where points are followed on a part of a large sheet only, goes at most as far as these points ask."""

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.steps < 1:
            raise ValueError(f"steps is {self.steps}; give 1 at least.")
        if not (self.rate > 0 and math.isfinite(self.rate)):
            raise ValueError(f"rate is {self.rate}; give a positive number.")


class _Step(NamedTuple):
    """A gradient step, for the adjoint."""

    points: np.ndarray
    bends: list[csr_array]
    """Second derivatives of what was matched."""
    rates: np.ndarray
    """Of the particles, shape [N, 1]; 0 for what is held."""


@dataclass(frozen=True, eq=False)
class Residual:
    """What the mapping found; N particles."""

    deformation: np.ndarray
    """Δ, shape [N, 3] [m]; 0 for what is held."""
    values: np.ndarray
    """Distance and energy together before every gradient step, shape [steps] [m²]."""
    _energy: Potential
    _path: list[_Step]

    def pulled_back(self, by_deformation: np.ndarray) -> np.ndarray:
        """Derivatives of a scalar by the state from those by Δ [N, 3], shape [N, 3], through every gradient step.

        y⁺ = y - η ∇F(y) with y = x + Δ: the adjoint is (I - H η) of each step in turn, less that of Δ = y - x.
        """
        free = self._path[0].rates > 0
        start = pull = np.where(free, by_deformation, 0.0)
        for points, bends, rates in reversed(self._path):
            ahead = rates * pull
            bent = sum((bend @ ahead for bend in bends), self._energy.bend(points, ahead) / len(pull))
            pull = pull - np.where(free, bent, 0.0)
            # What is held is part of the state, but doesn't move: its pull on the others' path isn't asked for.
        return pull - start


def map_residual(
    points: np.ndarray, matches: Sequence[Match], energy: Potential, held: np.ndarray, mapping: Mapping
) -> Residual:
    """Descend F(y) = Σ matches(y) + U⁰(y)/N from a simulated state (Liang 2024, equations 4 to 6).

    The paper doesn't say k⁰; U⁰ over N, as the distances are means, makes k⁰ of order 1 weigh as much as they. At the
    paper's rate k⁰ = 1 diverges on a block, whose particles have up to 18 neighbours; 0.3 doesn't. Nor may the
    distances diverge: no rate goes beyond the inverse of their curvature's row sum, its largest eigenvalue's bound.

    Args:
        points: x, shape [N, 3] [m].
        matches: Chamfer distance, followed points, or both.
        energy: ½ Cᵀ k⁰ C.
        held: pinned and gripped particles, shape [N], bool: known, so not mapped.
        mapping: how.
    """
    wanted = np.where(held, 0.0, mapping.rate * len(points) / 600)
    now, path, values = points.copy(), [], []
    for _ in range(mapping.steps):
        elastic, gradient = energy.slope(now)
        value, gradient, bends = elastic / len(now), gradient / len(now), []
        for match in matches:
            apart, slope, bend = match.slope(now)
            value, gradient = value + apart, gradient + slope
            bends.append(bend)
        curvature = sum((bend.sum(axis=1) for bend in bends), np.zeros(len(now)))  # no entry is negative
        rates = (wanted / np.maximum(1.0, wanted * curvature))[:, None]
        path.append(_Step(now, bends, rates))
        values.append(value)
        now = now - rates * gradient
    return Residual(now - points, np.array(values), energy, path)
