"""One clip's state and field, frame by frame (Liang 2024, algorithm 1): step, map, optimise.

Stiffness is optimised by Adam, as in the paper, or by recursive Gauss–Newton steps (Ljung & Söderström 1983, section
3.3). For these a simulation is carried along besides the state that is mapped, drawn to it by a small share a frame
only: what it is off by tells of the fields over tens of frames, where one time step tells little next to its noise. As
many more, each with one knot's stiffness changed, give the derivatives; their squares add up over frames, older ones
forgotten. A norm ‖r‖ has at r no more than the quadratic ½‖r‖²/‖r₀‖ + ½‖r₀‖ above it, which touches it there and is
minimised.
"""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import block_diag, solve

from palpate.common.settings import require_choices, require_numbers
from palpate.estimators.online.objective import Match, Objective, Residual, Terms
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


@dataclass
class Adam:
    """Adam (Kingma 2015, algorithm 1) in numpy, where torch is not installed: its running means, at first none.

    Raises:
        ValueError: a rate that is not positive.
    """

    rate: float = 0.1
    """Liang 2024, section III-B."""
    decay: tuple[float, float] = (0.9, 0.999)
    """Of the means of slopes and of their squares: Adam's usual ones, as the paper gives none."""
    guard: float = 1e-8
    _mean: np.ndarray | None = field(default=None, init=False, repr=False)
    _square: np.ndarray | None = field(default=None, init=False, repr=False)
    _count: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the range."""
        require_numbers(self, positive=("rate",))

    def step(self, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Values after one step against slopes of the same shape."""
        mean, square = (np.zeros_like(values) if past is None else past for past in (self._mean, self._square))
        first, second = self.decay
        self._count += 1
        self._mean = first * mean + (1 - first) * slopes
        self._square = second * square + (1 - second) * slopes * slopes
        size = np.sqrt(self._square / (1 - second**self._count)) + self.guard
        return values - self.rate * self._mean / (1 - first**self._count) / size


SNAPSHOTS, WINDOW = 4, 20
"""How many earlier states should stay at rest, and of how many frames (Liang 2024, section II-C)."""


@dataclass(frozen=True)
class Method:
    """Which parts of the step run.

    Raises:
        ValueError: another name.
    """

    name: Literal["PBD", "PBD-RM", "PBD-RM-ON"] = "PBD-RM-ON"
    """Simulation alone; with states that are mapped to what is observed; with stiffness that is optimised, too."""
    optimizer: Literal["adam", "gauss-newton"] = "gauss-newton"
    """What changes the stiffness: Adam, the paper's, or recursive Gauss–Newton steps of the fields at a few knots. Of
    tissue whose points are followed in pictures these are `estimators.online.determined`'s."""
    rate: float = 0.1
    """Of Adam, by the logits of the fields (Liang 2024, section III-B)."""

    def __post_init__(self) -> None:
        """Check the name."""
        require_choices(self)


@dataclass(frozen=True, eq=False)
class Frame:
    """What a frame gave; N particles."""

    positions: np.ndarray
    """The state, mapped where the method maps, shape [N, 3] [m]."""
    fields: Stiffness
    """After this frame's step, shape [N]."""
    gap: float | None
    """‖Δ‖ [m]; None = nothing was mapped."""
    terms: Terms | None
    """Of what was optimised, before the step; None = nothing was."""


class Session:
    """A body that is followed; begins at rest with the fields given."""

    def __init__(self, objective: Objective, fields: Stiffness, method: Method) -> None:
        """Begin a clip.

        Args:
            objective: body, grip and settings.
            fields: stiffness to begin with, shape [N], inside the bounds where they are optimised.
            method: which parts run.

        Raises:
            ValueError: fields on the bounds or outside.
        """
        self.objective, self.method, self.fields = objective, method, fields
        self.positions = objective.body.rest.copy()
        self._past: deque[np.ndarray] = deque(maxlen=WINDOW)
        self._adam = self._newton = None
        if method.name == "PBD-RM-ON":
            if method.optimizer == "adam":
                self._adam, self._logits = Adam(method.rate), objective.bounds.logits(fields)
            else:
                self._newton = GaussNewton(objective, fields)

    def step(self, places: np.ndarray, matches: Sequence[Match]) -> Frame:
        """Take a frame in; one that shows nothing is simulated alone.

        Args:
            places: where gripped particles are, shape [G, 3] [m].
            matches: its cloud, its followed points, both or none.
        """
        terms = None
        if self._adam is not None and matches:
            bounds, volume = self.objective.bounds, float(self.fields.volume)
            own = bounds.fields(self._logits, volume)
            found = self.objective.evaluate(own, self.positions, places, matches, self._snapshots())
            simulated, residual, terms = found.simulated, found.residual, found.terms
            self._logits = self._adam.step(self._logits, bounds.by_logits(own, found.slopes))
            self.fields = bounds.fields(self._logits, volume)
        elif self._newton is not None:
            with ThreadPoolExecutor(1) as other:
                carried = other.submit(self._newton.carry, places)
                simulated, residual = self._followed(places, matches)
                carried.result()
            if residual is not None:
                terms = self._newton.step(simulated + residual.deformation)
                self.fields = self._newton.fields
        else:
            simulated, residual = self._followed(places, matches)
        self.positions, gap = simulated, None
        if residual is not None:
            self.positions = simulated + residual.deformation
            gap = float(np.linalg.norm(residual.deformation))
            self._past.append(self.positions)
        return Frame(self.positions, self.fields, gap, terms)

    def _followed(self, places: np.ndarray, matches: Sequence[Match]) -> tuple[np.ndarray, Residual | None]:
        """The state one step on by the fields as they are, and what it is off by, where the method looks at that."""
        simulated = self.objective.stepped(self.fields, self.positions, places[None]).positions[0, -1]
        looks = bool(matches) and self.method.name != "PBD"
        return simulated, self.objective.mapped(simulated, matches) if looks else None

    def ahead(self, places: np.ndarray) -> np.ndarray:
        """States that a path of the grip [T, G, 3] [m] would lead to, shape [T, N, 3] [m], by the field as it is."""
        return self.objective.stepped(self.fields, self.positions, places).positions[0, 1:]

    def _snapshots(self) -> list[np.ndarray]:
        """Evenly out of the window, its ends included, where the paper draws uniformly: runs can be repeated."""
        chosen = np.linspace(0, len(self._past) - 1, min(SNAPSHOTS, len(self._past)))
        return [self._past[index] for index in chosen.round().astype(int)]
