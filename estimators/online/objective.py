"""What fields of stiffness are optimised for within bounds: gap, history, smoothness (Liang 2024, equations 7 to 9)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from palpate.common.settings import require_numbers
from palpate.estimators.online.mapping import Mapping, Match, Residual, map_residual
from palpate.physics.load import Grip
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential import Potential
from palpate.physics.pbd.simulation import Motion, Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness


@dataclass(frozen=True)
class Bounds:
    """Largest stiffness of distances and shapes; the smallest is 0 (Liang 2024, section III-B, whose own are `PAPER`).

    Raises:
        ValueError: a bound that is not positive.
    """

    distance: float = 10.0
    """[N/m], where m/Δt² is 1."""
    shape: float = 10.0
    """Likewise."""

    def __post_init__(self) -> None:
        """Check ranges."""
        require_numbers(self, positive=("distance", "shape"), group="the bound of ")

    def logits(self, fields: Stiffness) -> np.ndarray:
        """What `fields` makes those fields of, shape [2, N]: distances, then shapes.

        Raises:
            ValueError: a stiffness on a bound or outside; two of the paper's three starts are.
        """
        found = []
        for name, values, bound in (("distance", fields.distance, self.distance), ("shape", fields.shape, self.shape)):
            share = np.asarray(values, np.float64) / bound
            if not ((share > 0) & (share < 1)).all():
                raise ValueError(
                    f"a stiffness of {name} begins on its bounds, 0 and {bound:g}, or outside; begin inside."
                )
            found.append(np.log(share / (1 - share)))
        return np.stack(found)

    def fields(self, logits: np.ndarray, volume: float) -> Stiffness:
        """Bounds times the sigmoid of each; volumes keep theirs."""
        share = 0.5 * (1 + np.tanh(0.5 * logits))  # the sigmoid, which overflows nowhere
        return Stiffness(self.distance * share[0], self.shape * share[1], volume)

    def by_logits(self, fields: Stiffness, slopes: Stiffness) -> np.ndarray:
        """Derivatives by the logits [2, N] from those by the fields [N]."""
        return np.stack(
            [
                slopes.distance * fields.distance * (1 - fields.distance / self.distance),
                slopes.shape * fields.shape * (1 - fields.shape / self.shape),
            ]
        )


PAPER = Bounds(distance=10.0, shape=0.02)
"""Liang 2024, section III-B."""


@dataclass(frozen=True)
class Weights:
    """What the terms count; the paper adds them up as they are, in units that it doesn't give.

    Raises:
        ValueError: a weight that is negative.
    """

    gap: float = 1.0
    """Of ‖Δ‖ in mean edges."""
    history: float = 0.1
    """Of the sum over snapshots of how far each moves, likewise. Not 1: tissue that is pulled isn't at rest, and soft
    fields keep it so. Adam's alone: Gauss–Newton's past is the simulation that it carries along."""
    smoothness: float = 1.0
    """Of the mean difference between neighbours, in shares of the bounds."""

    def __post_init__(self) -> None:
        """Check ranges."""
        require_numbers(self, not_negative=("gap", "history", "smoothness"), group="the weight of ")


class Terms(NamedTuple):
    """The objective's terms, weighted; their sum is what is optimised."""

    gap: float
    history: float
    smoothness: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The objective at one field, and what was found on the way; N particles."""

    simulated: np.ndarray
    """x, the state one step on, shape [N, 3] [m]."""
    residual: Residual
    """Δ, from there to what was observed."""
    terms: Terms
    slopes: Stiffness
    """Derivatives of the terms' sum by the fields, shape [N]; by that of volumes 0, which is fixed."""


@dataclass(frozen=True, eq=False)
class Objective:
    """A gripped body, how it is stepped and mapped, and what its terms count.

    Raises:
        ValueError: an elastic stiffness that is negative.
    """

    body: Body
    gripped: np.ndarray
    """Particles that are moved, shape [G]: the same in all frames."""
    stepping: Stepping = field(default_factory=Stepping)
    mapping: Mapping = field(default_factory=Mapping)
    elastic: float = 0.3
    """k⁰ of the mapping, of distances and shapes; volumes have none, whose 10¹⁰ a rate of 50 can't bear."""
    weights: Weights = field(default_factory=Weights)
    bounds: Bounds = PAPER

    def __post_init__(self) -> None:
        """Check ranges."""
        require_numbers(self, not_negative=("elastic",))

    @cached_property
    def edge(self) -> float:
        """Mean length of edges [m], the unit of lengths here: weights then don't depend on the unit of the clip."""
        return float(self.body.layout.rest[self.body.kinds[0]].mean())

    @cached_property
    def _held(self) -> np.ndarray:
        held = self.body.pinned.copy()
        held[self.gripped] = True
        return held

    @cached_property
    def differences(self) -> csr_array:
        """Of neighbours' stiffness, a row for every pair within every face or tetrahedron, shape [pairs, N]."""
        cells = self.body.tetrahedra if len(self.body.tetrahedra) else self.body.faces
        first, second = np.triu_indices(cells.shape[1], 1)
        pairs = np.stack([cells[:, first].ravel(), cells[:, second].ravel()], axis=1)
        count = len(pairs)
        signs = np.tile([1.0, -1.0], count)
        return csr_array((signs, pairs.ravel(), 2 * np.arange(count + 1)), shape=(count, self.body.count))

    def stepped(self, fields: Stiffness, starts: np.ndarray, places: np.ndarray) -> Motion:
        """Step states on under the grip, a time step a frame.

        Args:
            fields: stiffness, shape [N], or [B, N].
            starts: states, shape [B, N, 3] or [N, 3] [m].
            places: where gripped particles are in every frame, shape [B, T, G, 3] or [T, G, 3] [m].
        """
        paths = places[None] if places.ndim == 3 else places
        grips = [Grip(self.gripped, path - self.body.rest[self.gripped]) for path in paths]
        return simulate(self.body, fields, grips, self.stepping, start=starts)

    def carried(self, fields: Stiffness, states: np.ndarray, places: np.ndarray) -> np.ndarray:
        """States [B, N, 3] [m] one time step on, each by fields of its own, in two threads.

        Args:
            fields: stiffness, shape [B, N].
            states: shape [B, N, 3] [m].
            places: where gripped particles then are, shape [G, 3] [m].
        """

        def stepped(own: slice) -> np.ndarray:
            of = Stiffness(fields.distance[own], fields.shape[own], fields.volume)
            paths = np.broadcast_to(places, (len(states[own]), 1, *places.shape))
            return self.stepped(of, states[own], paths).positions[:, -1]

        half = len(states) // 2
        with ThreadPoolExecutor(2) as both:
            return np.concatenate(list(both.map(stepped, (slice(half), slice(half, None)))))

    def mapped(self, points: np.ndarray, matches: Sequence[Match]) -> Residual:
        """Residual deformation of a state [N, 3]: by k⁰, so that what different fields leave can be compared."""
        weights = np.full(len(self.body.layout.rest), self.elastic)
        weights[self.body.kinds[1]] = 0.0
        return map_residual(points, matches, Potential(self.body, weights), self._held, self.mapping)

    def evaluate(
        self,
        fields: Stiffness,
        start: np.ndarray,
        places: np.ndarray,
        matches: Sequence[Match],
        snapshots: Sequence[np.ndarray],
    ) -> Evaluation:
        """Step on and map; and so the snapshots, whose grip stays where it was: they should stay as they are.

        Args:
            fields: stiffness, shape [N].
            start: the state before, shape [N, 3] [m].
            places: where gripped particles now are, shape [G, 3] [m].
            matches: what was observed, one at least.
            snapshots: earlier states, mapped, each [N, 3] [m].
        """
        with ThreadPoolExecutor(1) as other:  # compiled loops let two run at once
            past = other.submit(self._history, fields, snapshots)
            motion = self.stepped(fields, start, places[None])
            simulated = motion.positions[0, -1]
            residual = self.mapped(simulated, matches)
            gap, by_gap = _norm(residual.deformation, self.weights.gap / self.edge)
            pulls = np.zeros_like(motion.positions)
            pulls[0, -1] = residual.pulled_back(by_gap)
            found = motion.gradient(pulls)
            history, (of_distance, of_shape) = past.result()
        smoothness, by_distance, by_shape = 0.0, found.distance[0] + of_distance, found.shape[0] + of_shape
        bounds = self.bounds.distance, self.bounds.shape
        for values, out, bound in zip(fields[:2], (by_distance, by_shape), bounds, strict=True):
            apart, share = self.differences @ values, self.weights.smoothness / (bound * self.differences.shape[0])
            smoothness += share * float(np.abs(apart).sum())
            out += share * (self.differences.T @ np.sign(apart))
        slopes = Stiffness(by_distance, by_shape, 0.0)
        return Evaluation(simulated, residual, Terms(gap, history, smoothness), slopes)

    def _history(self, fields: Stiffness, snapshots: Sequence[np.ndarray]) -> tuple[float, tuple[np.ndarray, ...]]:
        """How far snapshots [N, 3] move, and the derivatives of that by the fields of distance and shape, shape [N]."""
        if not snapshots:
            return 0.0, (np.zeros(self.body.count), np.zeros(self.body.count))
        states = np.stack(snapshots)
        motion = self.stepped(fields, states, states[:, None, self.gripped])
        pulls, moved = np.zeros_like(motion.positions), 0.0
        for index, state in enumerate(states):
            way, pulls[index, -1] = _norm(motion.positions[index, -1] - state, self.weights.history / self.edge)
            moved += way
        found = motion.gradient(pulls)
        return moved, (found.distance.sum(axis=0), found.shape.sum(axis=0))


def _norm(values: np.ndarray, weight: float) -> tuple[float, np.ndarray]:
    """Weighted norm of values [N, 3] and its derivatives by them, 0 where all are."""
    size = float(np.linalg.norm(values))
    return weight * size, values * (weight / size if size > 0 else 0.0)
