"""Residual mapping: the deformation that takes a simulated state to what was observed of it (Liang 2024, equation 6).

How far particles are from that is a term of squared distances, `Chamfer` or `Tracks`. `slope` of either gives its value
[m²], its gradient [N, 3] [m], and its second derivatives by one axis [N, N], the same for all three and none below 0.
Once its pairs are fixed a term is quadratic in positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from palpate.common.settings import require_numbers
from palpate.physics.pbd.potential import Potential


class Chamfer:
    """Distance to a cloud both ways (Liang 2024, equation 4), as means: the sums' rate of 50 would diverge.

    Where nearest neighbours change, the derivative is that on one side.
    """

    def __init__(self, cloud: np.ndarray, seen: np.ndarray) -> None:
        """Keep what is observed.

        Args:
            cloud: observed points, shape [m, 3] [m].
            seen: particles of the surface that the camera sees, shape [n].

        Raises:
            ValueError: an empty or infinite cloud, or nobody seen.
        """
        if np.ndim(cloud) != 2 or np.shape(cloud)[1:] != (3,) or len(cloud) == 0 or not np.isfinite(cloud).all():
            raise ValueError(f"the cloud has shape {np.shape(cloud)}; give finite points, [m, 3], one at least.")
        if len(seen) == 0:
            raise ValueError("no particle is seen, so there is nothing to match with the cloud.")
        self.cloud, self.seen = np.asarray(cloud, np.float64), np.asarray(seen, np.int64)
        self._tree = KDTree(self.cloud)

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """Value, gradient and second derivatives.

        Raises:
            ValueError: a position that is not finite.
        """
        shown = points[self.seen]
        if not np.isfinite(shown).all():
            raise ValueError("a point to match is not finite: what is simulated has diverged.")
        out, there = self._tree.query(shown)
        back, here = KDTree(shown).query(self.cloud)
        own, others = len(shown), len(self.cloud)
        counts = np.bincount(here, minlength=own)
        drawn = np.stack([np.bincount(here, axis, minlength=own) for axis in self.cloud.T], axis=1)
        gradient, weight = np.zeros_like(points), np.zeros(len(points))
        gradient[self.seen] = 2 * (shown - self.cloud[there]) / own + 2 * (counts[:, None] * shown - drawn) / others
        weight[self.seen] = 2 / own + 2 * counts / others
        curved = csr_array((weight, np.arange(len(points)), np.arange(len(points) + 1)))
        return float(np.square(out).mean() + np.square(back).mean()), gradient, curved


class Tracks:
    """Mean squared distance between followed points and where they are on the mesh."""

    def __init__(self, places: csr_array, observed: np.ndarray) -> None:
        """Leave out what isn't seen.

        Args:
            places: shares of the particles in every point's position, shape [P, N], rows adding up to 1.
            observed: where the points are, shape [P, 3] [m]; not observed = NaN.

        Raises:
            ValueError: shapes that don't fit, nothing seen.
        """
        if np.shape(observed) != (places.shape[0], 3):
            raise ValueError(f"observed has shape {np.shape(observed)}; give {(places.shape[0], 3)}.")
        seen = np.isfinite(observed).all(axis=1)
        if not seen.any():
            raise ValueError("none of the followed points is seen.")
        self.places, self.observed = places[np.flatnonzero(seen)], np.asarray(observed, np.float64)[seen]
        self._curved = (2 / len(self.observed) * (self.places.T @ self.places)).tocsr()

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """Value, gradient and second derivatives."""
        apart = self.places @ points - self.observed
        count = len(apart)
        return float((apart * apart).sum() / count), 2 / count * (self.places.T @ apart), self._curved


Match = Chamfer | Tracks


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
    have any unit: both terms are squares of lengths. A particle that more of what was observed hangs on than that
    bears, as where points are followed on a part of a large sheet only, goes at most as far as these points ask."""

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.steps < 1:
            raise ValueError(f"steps is {self.steps}; give 1 at least.")
        require_numbers(self, positive=("rate",))


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
