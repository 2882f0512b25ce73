"""Where gripped tissue is stiffer than its mean, with the grip's motion unknown, and how well that is known.

K u = f, the sheet of `physics.sheet` with forces only at the instrument: where tissue that may be loaded went is
unknown, and the sheet carries that to all other places. Every followed point is an observation with its given noise.
Log stiffness is bilinear between knots with a smoothness prior. The foundation is one number, the same everywhere:
fields of both are not determined by a displacement in one direction. Of a knot where nothing moves nothing is known but
its prior.

The numbers are found by least squares, with the loaded tissue's motion at its likeliest for each choice of them
(variable projection, Golub and Pereyra 1973, with Kaufman's Jacobian). Errors are Student's as in
`estimators.grip.sheet`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, cholesky
from scipy.optimize import least_squares

from palpate.common.robust import affine_terms, error_scale, student_weights
from palpate.estimators.grip import sheet
from palpate.estimators.grip.lattice import SPREAD, TYPICAL_ANCHOR, bilinear, continued, lattice_springs, smoothness
from palpate.estimators.grip.sheet import NoSheet, PointGrid, SeenFrame
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.identifiability import LIMIT
from palpate.physics.sheet import Equilibrium, equilibrium

LEARNT = 0.7
"""What is known must be surer than what was expected before anything was observed, by this factor."""
MOST = 0.5
"""Share of the tissue that moves which must be known for the field to count as determined."""
MOVES = 5.0
"""Ratios are to the mean of tissue that moves by more than this [px]."""


@dataclass(frozen=True, eq=False)
class StiffnessField:
    """Log stiffness of a sheet, bilinear between the K knots of a grid, beyond these as at their edge.

    Known but for a factor: only ratios between places count. It is taken for granted that tissue is attached the same
    everywhere, which a picture doesn't show.
    """

    shape: tuple[int, int]
    """Columns and rows of knots."""
    low: np.ndarray
    """The first knot (column, row) [px of `picture`]."""
    extent: np.ndarray
    """From the first to the last [px]."""
    log_stiffness: np.ndarray
    """At the knots, columns outside, shape [K]."""
    covariance: np.ndarray
    """Theirs, shape [K, K]."""
    expected: np.ndarray
    """Their covariance before anything was observed, shape [K, K]."""
    roughness: float
    """Standard deviation of the difference between neighbouring knots that was expected."""
    moving: np.ndarray
    """Places of tissue that moves by more than MOVES, shape [M, 2] [px]."""
    excess: float
    """Standard deviation by axis of what the sheet leaves of the motion besides the given noise [px]."""
    picture: np.ndarray
    """The run's first one, in whose pixels all places are, uint8 [H, W, 3] RGB."""

    @property
    def knots(self) -> np.ndarray:
        """Places of the knots, shape [K, 2] [px]."""
        axes = zip(self.low, self.extent, self.shape, strict=True)
        sides = [np.linspace(start, start + far, count) for start, far, count in axes]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)

    def at(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log stiffness over the mean of tissue that moves, and its standard deviation, shape [N] each.

        Args:
            places: shape [N, 2] [px].
        """
        row = self._relative(places)
        # From one knot to the next it is a random walk with both ends known.
        share = self._places(places) % 1
        stray = self.roughness * np.sqrt((share * (1 - share)).sum(axis=1))
        return row @ self.log_stiffness, np.hypot(_sd(row, self.covariance), stray)

    def known(self, places: np.ndarray) -> np.ndarray:
        """Where the logarithm is known to LIMIT, as the knots around it are, by what was observed, shape [N], bool.

        Nothing is known beyond the knots, which span what moves.
        """
        row = self._relative(places)
        sd = _sd(row, self.covariance)
        spanned = np.all((places >= self.low) & (places <= self.low + self.extent), axis=1)
        return spanned & (sd < LIMIT) & (sd <= LEARNT * _sd(row, self.expected))

    @property
    def tells(self) -> bool:
        """Whether a sheet explains the motion to within its noise, and most tissue that moves is known."""
        return self.excess <= sheet.EXCESS and bool(self.known(self.moving).mean() > MOST)

    def _relative(self, places: np.ndarray) -> np.ndarray:
        """How log stiffness over the mean of tissue that moves follows the knots, shape [N, K]."""
        return self._weights(places) - self._weights(self.moving).mean(axis=0)

    def _weights(self, places: np.ndarray) -> np.ndarray:
        return bilinear(self._places(places), np.array(self.shape)).toarray()

    def _places(self, places: np.ndarray) -> np.ndarray:
        """Places [N, 2] in the distances of knots from the first one, within the grid."""
        return np.clip((places - self.low) / self.extent, 0, 1) * (np.array(self.shape) - 1)


def _sd(row: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations of linear functions [N, K] of numbers with a covariance [K, K], shape [N]."""
    return np.sqrt(np.maximum(((row @ covariance) * row).sum(axis=1), 0))


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
ROUGHNESS, TOGETHER = MODEL_ERRORS.stiffness_roughness, MODEL_ERRORS.stiffness_together
"""Standard deviation of the difference between neighbouring knots, and how many points err together."""
STRAINED = MODEL_ERRORS.strained_motion
"""Following errs by this share of the motion besides the given noise: windows are strained with the tissue."""
LOOKS, ROUNDS, EVALUATIONS, ENOUGH = 4, 8, 3, 1e-3
"""Times that points are weighted anew, in so many rounds, evaluations between, and the relative fall of χ² that ends
them."""
LEVEL = 0.1
"""Standard deviation of the mean log stiffness: with the foundation's it would only be a unit."""


class _Solved(NamedTuple):
    """One choice of the P numbers, the loaded tissue's motion at its likeliest; n visible points, K unknowns by
    axis."""

    unit: Equilibrium
    """The sheet, for a unit of motion of every loaded node."""
    loads: np.ndarray
    """Factor of the unknowns' prior precision, upper triangle, shape [K, K]."""
    rows: np.ndarray
    """How the points follow the unknowns, whitened, shape [n, K]."""
    root: np.ndarray
    """What whitens the points, shape [n, 1] [1/px]."""
    factor: tuple[np.ndarray, bool]
    """Cholesky's, of the unknowns' precision."""
    found: np.ndarray
    """The unknowns, shape [K, 2]."""
    left: np.ndarray
    """Simulated minus observed motion, shape [n, 2] [px]."""


class _Problem:
    """The sheet around a grip and what is observed of it; arguments as of `fit_stiffness`."""

    def __init__(self, grid: PointGrid, frame: SeenFrame) -> None:
        points, distance, hidden, spacing = grid
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
            if self.count <= MOST_NODES and self._loaded.sum() <= sheet.MOST_LOADED:
                break
        if not 0 < self._loaded.sum() <= sheet.MOST_LOADED:
            found = int(self._loaded.sum())
            raise NoSheet(f"Forces may act on {found} places; from 1 to {sheet.MOST_LOADED} can be distinguished.")
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
        self.precision = smoothness(self.shape) / ROUGHNESS**2 + knots**-2.0 / LEVEL**2
        """Of the knots' prior, shape [P - 1, P - 1]."""
        self._prior = cholesky(block_diag(self.precision, SPREAD**-2))
        seen = np.isfinite(far[kept])
        self.seen = np.flatnonzero(seen)
        """Points that are visible, shape [n]."""
        self._moved = frame.moved[kept][seen]
        given = np.square(np.maximum(frame.noise[kept][seen], sheet.LINK))
        self._given = given + np.square(STRAINED * far[kept][seen])
        self._terms = affine_terms(self.points)
        self.together = max(TOGETHER / step**2, 1.0)
        self.scale = 0.0
        """Of the errors besides the given noise, variance by axis [px²]."""
        self._weights = np.ones(len(self.seen))
        self._latest: tuple[np.ndarray, Equilibrium, np.ndarray] | None = None

    def _within(self, points: np.ndarray, spacing: int) -> np.ndarray:
        """Which points [N, 2] are near enough to the knots, bool [N]."""
        reach = MARGIN * spacing
        return np.all((points >= self.low - reach) & (points <= self.low + self.extent + reach), axis=1)

    def _may_be_loaded(self, nodes: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int) -> np.ndarray:
        """Which nodes the tool hides, or may touch, bool: only where the tissue around moves clearly."""
        loaded = np.zeros(len(nodes), bool)
        loaded[: self.count] = distance < LOADED
        # Cells as complex numbers, so that each is one value.
        under, behind = (np.rint(places / spacing) @ [1, 1j] for places in (hidden, nodes[self.count :]))
        loaded[self.count :] = np.isin(behind, under)
        return loaded & np.all((nodes >= self._pulled[0] - LOADED) & (nodes <= self._pulled[1] + LOADED), axis=1)

    def look(self, numbers: np.ndarray) -> None:
        """Weight the points anew by how far they lie from the sheet, and find the size of their errors."""
        for _ in range(ROUNDS):
            squares = np.square(self._solved(numbers).left).sum(axis=1)
            self.scale = error_scale(squares, self._given, self._weights, self.scale, sheet.LEAST_SCALE)
            self._weights = student_weights(squares, self._given + self.scale)

    def residual(self, numbers: np.ndarray) -> np.ndarray:
        """Of points and priors, whitened, as the points count by now, shape [R]; its squares add up to χ²."""
        here = self._solved(numbers)
        own = self._prior @ (numbers - self.mean)
        return np.concatenate([(here.left * here.root).ravel("F"), (here.loads @ here.found).ravel("F"), own])

    def jacobian(self, numbers: np.ndarray) -> np.ndarray:
        """Its derivatives by the numbers [R, P]; what loads and background could do as well tells nothing."""
        here, anchor = self._solved(numbers), float(np.exp(numbers[-1]))
        by_anchor = np.zeros((len(self._loaded), len(numbers)))
        by_anchor[:, -1] = anchor
        stiffness = np.exp(self._ends @ numbers[:-1])
        by_stiffness = np.column_stack([self._ends * stiffness[:, None], np.zeros(len(stiffness))])
        moved = replace(here.unit, displacement=here.unit.displacement @ here.found[: len(here.loads) - 3])
        slopes = moved.slopes(by_stiffness, by_anchor)[: self.count][self.seen]
        points, priors = [], []
        for axis in (0, 1):
            slope = slopes[:, axis] * here.root
            shared = cho_solve(here.factor, here.rows.T @ slope, check_finite=False)
            points.append(slope - here.rows @ shared)
            priors.append(-here.loads @ shared)
        return np.vstack([*points, *priors, self._prior])

    def _solved(self, numbers: np.ndarray) -> _Solved:
        """The loaded tissue's motion and the background at their likeliest."""
        if self._latest is None or not np.array_equal(self._latest[0], numbers):
            stiffness, anchor = np.exp(self._ends @ numbers[:-1]), float(np.exp(numbers[-1]))
            held, everywhere = int(self._loaded.sum()), np.full(len(self._loaded), anchor)
            # Where the nodes go for a unit of motion of every loaded one.
            unit = equilibrium(self._springs, stiffness, everywhere, self._loaded, np.eye(held))
            prior = np.zeros((held + 3, held + 3))
            prior[:held, :held] = (unit.reaction + unit.reaction.T) / (2 * sheet.ENERGY)
            prior += sheet.TINY * prior.max() * np.eye(held + 3)
            self._latest = np.array(numbers), unit, cholesky(prior, check_finite=False)
        _, unit, loads = self._latest
        root = np.sqrt(self._weights / (self._given + self.scale) / self.together)[:, None]
        rows = np.hstack([unit.displacement[: self.count], self._terms])[self.seen] * root
        factor = cho_factor(rows.T @ rows + loads.T @ loads, check_finite=False)
        found = cho_solve(factor, rows.T @ (self._moved * root), check_finite=False)
        return _Solved(unit, loads, rows, root, factor, found, rows @ found / root - self._moved)

    def fit(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest numbers [P], from some on, and their covariance [P, P]."""

        def beyond(of: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
            return lambda apart: of(self.mean + apart)

        jacobian = np.zeros((0, 0))
        for _ in range(LOOKS):
            self.look(numbers)
            # From the prior's mean, so that first steps are short.
            what = beyond(self.residual), numbers - self.mean, beyond(self.jacobian)
            end = least_squares(*what, ftol=ENOUGH, max_nfev=EVALUATIONS)
            numbers, jacobian = self.mean + end.x, end.jac
        return numbers, np.linalg.inv(jacobian.T @ jacobian)


def fit_stiffness(grid: PointGrid, frame: SeenFrame, picture: np.ndarray) -> StiffnessField:
    """Fit a field of stiffness to one frame of a grip.

    Args:
        grid: the points.
        frame: the one in which the tissue has moved most tells most.
        picture: the one at rest, uint8 [H, W, 3] RGB.

    Raises:
        NoSheet: too little moves, or the instrument hides too much.
    """
    problem = _Problem(grid, frame)
    moving = grid.points[np.linalg.norm(frame.moved, axis=1) > MOVES]
    numbers, covariance = problem.fit(problem.mean)
    excess = math.sqrt(problem.scale)
    if excess > sheet.EXCESS:
        # What a sheet can't explain is the same over a larger piece of it.
        problem.together *= MODEL_ERRORS.stiffness_unexplained
        numbers, covariance = problem.fit(numbers)
    knots = (int(problem.shape[0]), int(problem.shape[1])), problem.low, problem.extent
    known = numbers[:-1], covariance[:-1, :-1], np.linalg.inv(problem.precision), ROUGHNESS
    return StiffnessField(*knots, *known, moving, excess, picture)
