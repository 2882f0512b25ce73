"""Fits where gripped tissue is stiffer, with the grip's motion unknown.

K u = f, the sheet of `physics.sheet` with forces only at the instrument: where tissue that may be loaded went is
unknown, and the sheet carries that to all other places. Every followed point is an observation with its told noise.
Log stiffness is bilinear between knots with a smoothness prior. The foundation is one number, the same everywhere:
fields of both are not determined by a displacement in one direction. Of a knot where nothing moves nothing is known but
its prior.

Levenberg and Marquardt's steps on these numbers, with the loaded tissue's motion at its likeliest for each of them
(variable projection, Golub and Pereyra 1973, with Kaufman's Jacobian). Errors are Student's as in
`estimators.grip.foundation_fit`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimators.grip.foundation_fit import EXCESS, NoSheet
from estimators.grip.lattice import LEVEL, SPREAD, TYPICAL_ANCHOR, bilinear, continued, lattice_springs, smoothness
from estimators.grip.sheet_problem import ENERGY, FREEDOM, LINK, MOST_LOADED, TINY, SeenFrame, error_scale
from estimators.grip.stiffness_field import MOVES, StiffnessField
from physics.sheet import equilibrium

LOADED = 24.0
"""Tissue that began nearer to the tool may be loaded by it [px]."""
STILL, LEAST_MOVING = 1.0, 50
"""What moves less tells nothing [px]; least number of points that move more."""
INNER = 2.0, 98.0
"""Percentiles of these along both axes that the knots span: single points go astray."""
MARGIN, BEYOND = 4, 8
"""The sheet goes on beyond the knots: so far with points, and so far behind these, where pictures end [nodes]."""
STEPS_APART, MOST_NODES = (2, 3), 3000
"""Every second row and column of points are nodes, or, of more points or loaded places than are wanted, every third."""
KNOT, MOST_KNOTS = 32.0, 160
"""Least distance between knots [px]; most knots."""
ROUGHNESS = 0.55
"""Standard deviation of the difference between neighbouring knots: intervals hold at a step by a factor 3, too."""
ALIKE = 24.0
"""So many points err alike: neighbours share what flow sees of them."""
UNEXPLAINED = 2.0
"""Where a sheet does not explain the motion to within its noise, so many times as many do."""
STRAINED = 0.03
"""Following errs by this share of the motion besides the told noise: windows are strained with the tissue."""
ROUNDS, STEPS = 4, 12
"""Of weighting the points anew in every step, and steps at most."""
CONVERGED, LONGEST = 0.05, 1.5
"""Gain of a step that is the last, and largest change of a number in a step."""
DAMPING, MORE, LESS, MOST_DAMPING = 1e-3, 20.0, 0.1, 1e4
"""Levenberg and Marquardt's: the first, its changes after a step that fails or gains, and the one that ends all."""


@dataclass(frozen=True, eq=False)
class _State:
    """All that belongs to one choice of the P numbers, the loaded tissue's motion at its likeliest; n seen points."""

    loss: float
    """Negative log density of what is seen."""
    gradient: np.ndarray
    """Shape [P]."""
    hessian: np.ndarray
    """Gauss and Newton's, shape [P, P]."""
    weights: np.ndarray
    """Of the points, shape [n]."""
    scale: float
    """Of the errors besides the told noise, variance by axis [px²]."""
    left: np.ndarray
    """Simulated minus seen motion, shape [n, 2] [px]."""


class _Problem:
    """The sheet around a grip and what is seen of it; arguments as of `fit_stiffness`."""

    def __init__(
        self, points: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int, frame: SeenFrame
    ) -> None:
        far = np.linalg.norm(frame.moved, axis=1)
        moving = np.isfinite(far) & (far > STILL)
        if moving.sum() < LEAST_MOVING:
            raise NoSheet(f"{int(moving.sum())} points move by more than {STILL:g} px; {LEAST_MOVING} are needed.")
        self.low, high = np.percentile(points[moving], INNER, axis=0)
        self.extent = np.maximum(high - self.low, spacing)
        if not (far > MOVES).any():
            raise NoSheet(f"Nothing moves by more than {MOVES:g} px.")
        self._pulled = np.percentile(points[far > MOVES], INNER, axis=0)
        cells = np.rint(points / spacing).astype(np.int64)
        for step in STEPS_APART:
            kept = self._within(points, spacing * step) & (cells % step == 0).all(axis=1)
            self.spacing, self.points, self.count = spacing * step, points[kept], int(kept.sum())
            nodes = continued(self.points, self.spacing, BEYOND)
            self._loaded = self._may_be_loaded(nodes, distance[kept], hidden, spacing)
            if self.count <= MOST_NODES and self._loaded.sum() <= MOST_LOADED:
                break
        if not 0 < self._loaded.sum() <= MOST_LOADED:
            raise NoSheet(f"Forces may act on {self._loaded.sum()} places; from 1 to {MOST_LOADED} can be told apart.")
        self._springs = lattice_springs(nodes, self.spacing)
        apart, self.shape = KNOT, np.array([MOST_KNOTS + 1, 1])
        while self.shape.prod() > MOST_KNOTS:
            self.shape = np.maximum(np.rint(self.extent / apart).astype(int), 1) + 1
            apart += spacing
        basis = bilinear(np.clip((nodes - self.low) / self.extent, 0, 1) * (self.shape - 1), self.shape)
        self._ends = ((basis[self._springs[:, 0]] + basis[self._springs[:, 1]]) / 2).toarray()
        knots = self._ends.shape[1]
        self.mean = np.append(np.zeros(knots), math.log(TYPICAL_ANCHOR * step**2))
        """Of the prior, shape [P]: knots, and the log foundation over stiffness 1."""
        self.precision = np.zeros((knots + 1, knots + 1))
        """Of the prior, shape [P, P]."""
        self.precision[:knots, :knots] = smoothness(self.shape) / ROUGHNESS**2 + knots**-2.0 / LEVEL**2
        self.precision[knots, knots] = SPREAD**-2
        seen = np.isfinite(far[kept])
        self.seen = np.flatnonzero(seen)
        """Points that are seen, shape [n]."""
        self._moved = frame.moved[kept][seen]
        told = np.square(np.maximum(frame.noise[kept][seen], LINK))
        self._told = told + np.square(STRAINED * far[kept][seen])
        middle, spread = self.points.mean(axis=0), self.points.std(axis=0)
        self._terms = np.column_stack([(self.points - middle) / spread, np.ones(self.count)])
        self.alike = max(ALIKE / step**2, 1.0)

    def _within(self, points: np.ndarray, spacing: int) -> np.ndarray:
        """Which points [N, 2] are near enough to the knots, bool [N]."""
        reach = MARGIN * spacing
        return np.all((points >= self.low - reach) & (points <= self.low + self.extent + reach), axis=1)

    def _may_be_loaded(self, nodes: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int) -> np.ndarray:
        """Which nodes the tool hides, or may touch, bool: only where the tissue around moves clearly."""
        loaded = np.zeros(len(nodes), bool)
        loaded[: self.count] = distance < LOADED
        under = {tuple(cell) for cell in np.rint(hidden / spacing).astype(int).tolist()}
        behind = np.rint(nodes[self.count :] / spacing).astype(int).tolist()
        loaded[self.count :] = [tuple(cell) in under for cell in behind]
        return loaded & np.all((nodes >= self._pulled[0] - LOADED) & (nodes <= self._pulled[1] + LOADED), axis=1)

    def at(self, numbers: np.ndarray, start: _State | None) -> _State:
        """The state of some numbers [P], its weights found from those of another one."""
        stiffness, anchor = np.exp(self._ends @ numbers[:-1]), float(np.exp(numbers[-1]))
        held = int(self._loaded.sum())
        everywhere = np.full(len(self._loaded), anchor)
        # Where the nodes go for a unit of motion of every loaded one.
        unit = equilibrium(self._springs, stiffness, everywhere, self._loaded, np.eye(held))
        prior = np.zeros((held + 3, held + 3))
        prior[:held, :held] = (unit.reaction + unit.reaction.T) / (2 * ENERGY)
        prior += TINY * prior.max() * np.eye(held + 3)
        design = np.hstack([unit.displacement[: self.count], self._terms])[self.seen]
        weights, scale = (np.ones(len(self.seen)), 0.0) if start is None else (start.weights, start.scale)
        for _ in range(ROUNDS):
            root = np.sqrt(weights / (self._told + scale) / self.alike)[:, None]
            rows = design * root
            factor = cho_factor(rows.T @ rows + prior, check_finite=False)
            found = cho_solve(factor, rows.T @ (self._moved * root), check_finite=False)
            left = design @ found - self._moved
            squares = np.square(left).sum(axis=1)
            scale = error_scale(squares, self._told, weights, scale)
            variance = self._told + scale
            weights = (FREEDOM + 2) / (FREEDOM + squares / variance)
        density = (FREEDOM + 2) / 2 * np.log1p(squares / variance / FREEDOM) + np.log(variance)
        hessian, gradient = np.zeros((len(numbers),) * 2), np.zeros(len(numbers))
        by_anchor = np.zeros((len(self._loaded), len(numbers)))
        by_anchor[:, -1] = anchor
        by_stiffness = np.column_stack([self._ends * stiffness[:, None], np.zeros(len(stiffness))])
        moved = dataclasses.replace(unit, displacement=unit.displacement @ found[:held])
        slopes = moved.slopes(by_stiffness, by_anchor)[: self.count][self.seen]
        for axis in (0, 1):
            slope = slopes[:, axis] * root
            # What the loaded tissue and the background could do as well tells nothing.
            shared = rows.T @ slope
            hessian += slope.T @ slope - shared.T @ cho_solve(factor, shared, check_finite=False)
            gradient += slope.T @ (left[:, axis] * root[:, 0])
        loss = float(density.sum() / self.alike + 0.5 * np.einsum("ia,ij,ja->", found, prior, found))
        return _State(loss, gradient, hessian, weights, scale, left)

    def fit(self, numbers: np.ndarray, state: _State | None) -> tuple[np.ndarray, _State]:
        """The likeliest numbers [P], from some on."""

        def loss(numbers: np.ndarray, state: _State) -> float:
            return state.loss + 0.5 * float((numbers - self.mean) @ self.precision @ (numbers - self.mean))

        state, damping = self.at(numbers, state), DAMPING
        for _ in range(STEPS):
            gradient = state.gradient + self.precision @ (numbers - self.mean)
            hessian = state.hessian + self.precision
            step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
            step *= min(1.0, LONGEST / np.abs(step).max())
            tried = self.at(numbers + step, state)
            gain = loss(numbers, state) - loss(numbers + step, tried)
            if gain > 0:
                numbers, state = numbers + step, tried
            damping *= LESS if gain > 0 else MORE
            if 0 < gain < CONVERGED or damping > MOST_DAMPING:
                break
        return numbers, state


def fit_stiffness(
    points: np.ndarray,
    distance: np.ndarray,
    hidden: np.ndarray,
    spacing: int,
    frame: SeenFrame,
    picture: np.ndarray,
) -> StiffnessField:
    """Fit a field of stiffness to one frame of a grip.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        distance: from the tool there, shape [N] [px].
        hidden: places of the grid that the tool hides there, shape [H, 2] [px].
        spacing: of the grid [px].
        frame: the one in which the tissue has moved most tells most.
        picture: the one at rest, uint8 [H, W, 3] RGB.

    Raises:
        NoSheet: too little moves, or the instrument hides too much.
    """
    problem = _Problem(points, distance, hidden, spacing, frame)
    moving = points[np.linalg.norm(frame.moved, axis=1) > MOVES]
    numbers, state = problem.fit(problem.mean, None)
    excess = math.sqrt(state.scale)
    if excess > EXCESS:
        # What a sheet can't explain is alike over a larger piece of it.
        problem.alike *= UNEXPLAINED
        numbers, state = problem.fit(numbers, state)
    covariance = np.linalg.inv(state.hessian + problem.precision)
    return StiffnessField(
        (int(problem.shape[0]), int(problem.shape[1])),
        problem.low,
        problem.extent,
        numbers[:-1],
        covariance[:-1, :-1],
        np.linalg.inv(problem.precision[:-1, :-1]),
        ROUGHNESS,
        moving,
        excess,
        picture,
    )
