"""Objective of the fields of stiffness within bounds: gap, history, smoothness (Liang 2024, equations 7 to 9).

The gap is left by residual mapping: the deformation that takes a simulated state to its observation (equation 6). The
distance of the particles from that is a term of squared distances, `Chamfer` or `Tracks`. `slope` of either gives its
value [m²], its gradient [N, 3] [m], and its second derivatives by one axis. These are the same for all axes and never
negative, shape [N, N] or a diagonal [N]. Once its pairs are fixed a term is quadratic in positions.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from scipy.special import expit, logit

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.physics.load import Grip
from palpate.physics.mesh import incidence
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential import Potential
from palpate.physics.pbd.simulation import MOST_ITERATIONS, Motion, Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness


class Chamfer:
    """Distance to a cloud both ways (Liang 2024, equation 4), as means: the sums' rate of 50 would diverge.

    Where nearest neighbours change, the derivative is that on one side.
    """

    def __init__(self, cloud: np.ndarray, seen: np.ndarray) -> None:
        """Keep what is observed.

        Args:
            cloud: observed points, all finite, shape [m, 3] [m]; one at least.
            seen: particles of the surface that the camera sees, shape [n]; one at least.
        """
        self.cloud, self.seen = np.asarray(cloud, np.float64), np.asarray(seen, np.int64)
        self._tree = KDTree(self.cloud)

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the value, gradient and second derivatives, a diagonal [N]; a ValueError where a position is not
        finite."""
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
        return float(np.square(out).mean() + np.square(back).mean()), gradient, weight


class Tracks:
    """Mean squared distance between followed points and where they are on the mesh."""

    def __init__(self, places: csr_array, observed: np.ndarray) -> None:
        """Leave out what isn't seen.

        Args:
            places: shares of the particles in every point's position, shape [P, N], rows adding up to 1.
            observed: where the points are, shape [P, 3] [m]; not observed = NaN, one at least is.
        """
        visible = np.isfinite(observed).all(axis=1)
        self.places, self.observed = places[np.flatnonzero(visible)], np.asarray(observed, np.float64)[visible]
        self._curved = (2 / len(self.observed) * (self.places.T @ self.places)).tocsr()

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """Return the value, gradient and second derivatives."""
        apart = self.places @ points - self.observed
        count = len(apart)
        return float((apart * apart).sum() / count), 2 / count * (self.places.T @ apart), self._curved


Match = Chamfer | Tracks
Matches = Sequence[Match]


@dataclass(frozen=True)
class Mapping(Checked):
    """Search of the residual deformation."""

    steps: Annotated[int, 1, MOST_ITERATIONS] = 30
    """Gradient steps (section II-B)."""
    rate: Positive = 50.0
    """Learning rate at 600 particles (section II-B); with n it is rate·n/600, since means over n shrink as 1/n. Lengths
    may have any unit: both terms are squares of lengths. A particle on which many observed points hang goes at most as
    far as these ask."""


class _Step(NamedTuple):
    """A gradient step, for the adjoint."""

    points: np.ndarray
    bends: list[csr_array | np.ndarray]
    """Second derivatives of what was matched, as in `slope`."""
    rates: np.ndarray
    """Learning rates of the particles, shape [N, 1]; 0 for what is held."""


@dataclass(frozen=True, eq=False)
class Residual:
    """Result of the mapping; N particles."""

    deformation: np.ndarray
    """Δ, shape [N, 3] [m]; 0 for what is held."""
    values: np.ndarray
    """Distance and energy together before every gradient step, shape [steps] [m²]."""
    _energy: Potential
    _path: list[_Step]

    def pulled_back(self, by_deformation: np.ndarray) -> np.ndarray:
        """Return derivatives of a scalar by the state from those by Δ [N, 3], shape [N, 3], through every gradient
        step.

        With y⁺ = y - η ∇F(y) and y = x + Δ the adjoint is (I - H η) of each step in turn, less that of Δ = y - x.
        """
        free = self._path[0].rates > 0
        start = pull = np.where(free, by_deformation, 0.0)
        for points, bends, rates in reversed(self._path):
            ahead = rates * pull
            bent = self._energy.bend(points, ahead) / len(pull)
            bent = sum((bend[:, None] * ahead if bend.ndim == 1 else bend @ ahead for bend in bends), bent)
            pull = pull - np.where(free, bent, 0.0)
            # What is held is part of the state, but doesn't move: its pull on the others' path isn't asked for.
        return pull - start


def map_residual(points: np.ndarray, matches: Matches, energy: Potential, held: np.ndarray, how: Mapping) -> Residual:
    """Descend F(y) = Σ matches(y) + U⁰(y)/N from a simulated state (Liang 2024, equations 4 to 6).

    The paper doesn't say k⁰; U⁰ over N, as the distances are means, makes k⁰ of order 1 weigh as much as they. At the
    paper's rate k⁰ = 1 diverges on a block, whose particles have up to 18 neighbours; 0.3 doesn't. Nor may the
    distances diverge: no rate goes beyond the inverse of their curvature's row sum, its largest eigenvalue's bound.

    Args:
        points: x, shape [N, 3] [m].
        matches: Chamfer distance, followed points, or both.
        energy: ½ Cᵀ k⁰ C.
        held: pinned and gripped particles, shape [N], bool: known, so not mapped.
        how: steps and their rate.
    """
    wanted = np.where(held, 0.0, how.rate * len(points) / 600)
    now, path, values = points.copy(), [], []
    for _ in range(how.steps):
        elastic, gradient = energy.slope(now)
        value, gradient, bends = elastic / len(now), gradient / len(now), []
        for match in matches:
            apart, slope, bend = match.slope(now)
            value, gradient = value + apart, gradient + slope
            bends.append(bend)
        curvature = sum((bend if bend.ndim == 1 else bend.sum(axis=1) for bend in bends), np.zeros(len(now)))
        rates = (wanted / np.maximum(1.0, wanted * curvature))[:, None]
        path.append(_Step(now, bends, rates))
        values.append(value)
        now = now - rates * gradient
    return Residual(now - points, np.array(values), energy, path)


@dataclass(frozen=True)
class Bounds(Checked, group="the bound of "):
    """Largest stiffness of distances and shapes, above 0 (Liang 2024, section III-B, whose own are `PAPER`)."""

    distance: Positive = 10.0
    """[N/m], where m/Δt² is 1."""
    shape: Positive = 10.0
    """Bounds of shapes' stiffness, likewise."""

    def logits(self, fields: Stiffness) -> np.ndarray:
        """Return the logits of which `fields` makes those fields, inside the bounds: distances, then shapes [2, N]."""
        return logit(np.stack(fields[:2]) / self.both)

    @property
    def both(self) -> np.ndarray:
        """Both, shape [2, 1]."""
        return np.array([[self.distance], [self.shape]])

    def fields(self, logits: np.ndarray, volume: float) -> Stiffness:
        """Return the fields: bounds times the sigmoid of each logit; volumes keep theirs."""
        return Stiffness(*(self.both * expit(logits)), volume)

    def by_logits(self, fields: Stiffness, slopes: Stiffness) -> np.ndarray:
        """Return derivatives by the logits [2, N] from those by the fields [N]."""
        values = np.stack(fields[:2])
        return np.stack(slopes[:2]) * values * (1 - values / self.both)


PAPER = Bounds(distance=10.0, shape=0.02)
"""Liang 2024, section III-B."""


@dataclass(frozen=True)
class Weights(Checked, group="the weight of "):
    """Weights of the objective's terms; the paper adds these up in units that it doesn't give."""

    gap: NotNegative = 1.0
    """Weight of ‖Δ‖ in mean edges: weights then don't depend on the unit of the clip."""
    history: NotNegative = 0.1
    """Weight of the sum over snapshots of how far each moves, likewise. Not 1: tissue that is pulled isn't at rest, and
    soft fields keep it so. Adam's alone: Gauss–Newton's past is the simulation that it carries along."""
    smoothness: NotNegative = 1.0
    """Weight of the mean difference between neighbours, in shares of the bounds."""


class Terms(NamedTuple):
    """The objective's terms, weighted; their sum is what is optimised."""

    gap: float
    history: float
    smoothness: float


@dataclass(frozen=True, eq=False)
class Objective(Checked):
    """A gripped body, how it is stepped and mapped, and what its terms count."""

    body: Body
    gripped: np.ndarray
    """Particles that are moved, shape [G]: the same in all frames."""
    stepping: Stepping = field(default_factory=Stepping)
    mapping: Mapping = field(default_factory=Mapping)
    elastic: NotNegative = 0.3
    """k⁰ of the mapping, of distances and shapes; volumes have none, whose 10¹⁰ a rate of 50 can't bear."""
    weights: Weights = field(default_factory=Weights)
    bounds: Bounds = PAPER

    @cached_property
    def differences(self) -> csr_array:
        """Differences of neighbours' stiffness, a row for every pair within every face or tetrahedron, shape [pairs,
        N]."""
        cells = self.body.tetrahedra if len(self.body.tetrahedra) else self.body.faces
        first, second = np.triu_indices(cells.shape[1], 1)
        pairs = np.stack([cells[:, first].ravel(), cells[:, second].ravel()], axis=1)
        return incidence(pairs, self.body.count).T.tocsr()

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
        """Return states [B, N, 3] [m] one time step on, each by fields of its own, in two threads.

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

    def mapped(self, points: np.ndarray, matches: Matches) -> Residual:
        """Return the residual deformation of a state [N, 3]: by k⁰, so that what different fields leave can be
        compared."""
        weights = np.full(len(self.body.layout.rest), self.elastic)
        weights[self.body.kinds[1]] = 0.0
        held = self.body.inverse_mass(self.gripped) == 0
        return map_residual(points, matches, Potential(self.body, weights), held, self.mapping)

    def evaluate(
        self, fields: Stiffness, start: np.ndarray, places: np.ndarray, matches: Matches, snapshots: list[np.ndarray]
    ) -> tuple[np.ndarray, Residual, Terms, Stiffness]:
        """Step on and map; and so the snapshots, whose grip stays where it was: they should stay as they are.

        Args:
            fields: stiffness, shape [N].
            start: the state before, shape [N, 3] [m].
            places: where gripped particles now are, shape [G, 3] [m].
            matches: what was observed, one at least.
            snapshots: earlier states, mapped, each [N, 3] [m].

        Returns:
            x, the state one step on, shape [N, 3] [m]; Δ, from there to what was observed; the terms; and derivatives
            of their sum by the fields, shape [N], 0 by that of volumes, which is fixed.
        """
        with ThreadPoolExecutor(1) as other:  # compiled loops let two run at once
            past = other.submit(self._history, fields, snapshots)
            motion = self.stepped(fields, start, places[None])
            simulated = motion.positions[0, -1]
            residual = self.mapped(simulated, matches)
            gap, by_gap = _norm(residual.deformation, self.weights.gap / self.body.edge)
            pulls = np.zeros_like(motion.positions)
            pulls[0, -1] = residual.pulled_back(by_gap)
            by_fields = motion.gradient(pulls).total
            history, by_history = past.result()
        apart = self.differences @ np.stack(fields[:2], axis=1)
        share = self.weights.smoothness / (self.bounds.both.T * self.differences.shape[0])
        by_fields += by_history + (share * (self.differences.T @ np.sign(apart))).T
        terms = Terms(gap, history, float((share * np.abs(apart)).sum()))
        return simulated, residual, terms, Stiffness(*by_fields, 0.0)

    def _history(self, fields: Stiffness, snapshots: list[np.ndarray]) -> tuple[float, np.ndarray]:
        """Return how far snapshots [N, 3] move, and the derivatives of that by both fields, shape [2, N]."""
        if not snapshots:
            return 0.0, np.zeros((2, self.body.count))
        states = np.stack(snapshots)
        motion = self.stepped(fields, states, states[:, None, self.gripped])
        pulls, moved = np.zeros_like(motion.positions), 0.0
        for index, state in enumerate(states):
            way, pulls[index, -1] = _norm(motion.positions[index, -1] - state, self.weights.history / self.body.edge)
            moved += way
        return moved, motion.gradient(pulls).total


def _norm(values: np.ndarray, weight: float) -> tuple[float, np.ndarray]:
    """Return the weighted norm of values [N, 3] and its derivatives by them, 0 where all are."""
    size = float(np.linalg.norm(values))
    return weight * size, values * (weight / size if size > 0 else 0.0)
