"""How firmly gripped tissue is attached, and what holds it, with the grip's motion unknown.

Points next to an instrument are followed badly: windows that hold its edge are dragged along or held back by it. Taken
as a prescribed displacement they bias foundation and force by a quarter and more (docs/reports/real.md). Here they are
observations as all others are, with their given noise, and the forces on every place at the instrument are unknown,
also on tissue that it hides; an endless sheet (`physics.sheet`) answers these, and an affine background moves on its
own. Far points tell the sum of the forces, and how fast the motion dies away, whatever happens at the grip. Errors of
points are Student's (`common.robust`), whose scale is found in every frame: a sheet is not tissue. Neighbours' errors
are correlated (`estimators.grip.whitening`).

Followed points are filtered, which biases them where neighbours lie on one side. So once a sheet explains them, they
are measured again where it says they are. Should more points err together than expected, they count for less.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.sparse import csr_array

from palpate.common.robust import error_scale, median_sd, student_loss, student_weights
from palpate.estimators.grip.lattice import PIECE, SPREAD, TYPICAL_ANCHOR, along_last, continued, evenly
from palpate.estimators.grip.whitening import MEASURED_REACH, REACH, Whitening, correlated_points, points_as_one
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.sheet import response

LOADED = 32.0
"""Forces act on tissue that began nearer to the tool [px]."""
DENSE, THIRD = 64.0, 3
"""Of points that began farther from the tool every third one along both axes counts: neighbours err together."""
SIZE = 512
"""Of the repeated piece of the endless sheet [nodes]."""
ENERGY, FREE = 300.0, 3000.0
"""Prior scale of the work that the forces do, a number of them [px² · stiffness]: at a node alone 10 px. The sum of the
forces hangs on it where an instrument hides tissue. The foundation is determined with ten times as much: strong pulls,
which are expected less, would pass for a softer attachment."""
NEGLIGIBLE = 1e-6
"""Of the loads' independent numbers those count that move points by more than so much, as far as they are expected
[px²]: no link tells of others."""
LINK = 0.05
"""Least standard deviation of a point by axis [px]."""
LEAST_SCALE = LINK**2 / 100
"""Of errors besides the given noise: a smaller variance by axis is none [px²]."""
TOGETHER = PIECE**2 / THIRD**2
"""So many points are taken to err together where they are weighted: what a sheet can't explain is smooth over a
piece."""
ROUNDS, AGAIN, CONVERGED = 15, 4, 1e-3
"""Of weighting the points anew: at most, where near values are solved, and the change of weights that ends them."""
MOST_LOADED = 400
"""More places with a force take minutes, and leave too much free."""
TINY = 1e-9
"""Of the largest: added to a diagonal so that rounding doesn't make it indefinite."""
LOOKS = 4
"""Times that points are measured again where the fit so far says they are: after 1 to 4 of them 28 drawn clips were
0.0123, 0.0077, 0.0071 and 0.0066 off (those of `foundation_measured` in model_errors.yaml)."""
ENOUGH = 0.5
"""Of the points that count such a share must be found in a frame, and such a share of the frames must be left, or
points stay as they were followed."""
VAGUE = 0.2
"""Standard deviation from which on a difference of two log foundations isn't judged: their likelihoods are skew."""
MOST_FITTED, MOST_MEASURED = 4, 8
"""So many frames, evenly spread, tell the foundation roughly, and so many once points are measured again: the motion
grows steadily."""
GRID, LONGEST, NEWTON, PRECISION = 1.0, 0.5, 8, 0.002
"""Of the search for log foundation: between the values tried first, the longest of Newton's steps from the best of
them, the most of these, and the length of the last one."""
LIMITS = -10.0, 1.0
"""Of log foundation: motion that dies away over 260 nodes, and within one."""
STEP = 0.1
"""Of log foundation, for derivatives."""
EXCESS = MODEL_ERRORS.sheet_excess
"""Errors beyond the given noise of this size, by axis, show that tissue is no such sheet [px]: free forces then
explain too much. Nor is it one where what is left of the motion goes together over many points (`sheet_together`)."""
WIDENS = 3.0
"""Standard deviations from which on motion spreads farther by larger pulls."""


class SheetMotion(NamedTuple):
    """How a sheet moves that explains a pull; M nodes, T frames."""

    nodes: np.ndarray
    """At rest, shape [M, 2] [px]."""
    spacing: int
    """Between neighbours [px]."""
    moved: np.ndarray
    """Without the background's motion, shape [T, M, 2] [px]."""


class NoSheet(ValueError):
    """Forces at the instrument and a sheet that is homogeneous don't explain the points to within their noise."""


class PointGrid(NamedTuple):
    """Followed points on a square grid, as they are at rest; N points."""

    points: np.ndarray
    """Places, shape [N, 2] [px]."""
    distance: np.ndarray
    """Distance from the tool, shape [N] [px]."""
    hidden: np.ndarray
    """Places of the grid that the tool hides, shape [H, 2] [px]."""
    spacing: int
    """Spacing of the grid [px]."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """Followed points of one frame; N points."""

    moved: np.ndarray
    """Displacement since rest, shape [N, 2] [px]; not a number where a point is lost."""
    noise: np.ndarray
    """Its standard deviation by axis, shape [N] [px]."""


@dataclass(eq=False)
class Solved:
    """One frame at one foundation; M places that are loaded."""

    loss: float
    """Negative log of the density, of all unknowns at their likeliest."""
    unknowns: np.ndarray
    """Loads [stiffness × px] and the background's motion, shape [M + 3, 2]."""
    weights: np.ndarray
    """Of the points that count, 0 for those not observed."""
    scale: float
    """Of the errors besides the given noise, variance by axis [px²]."""


class Design(NamedTuple):
    """How n points follow K independent numbers for the loads and 3 for the background, at one foundation."""

    rows: np.ndarray
    """Motion for a unit of each, shape [n, K + 3]."""
    precision: np.ndarray
    """Prior precision of these, shape [K + 3]."""
    loads: np.ndarray
    """Loads on the M places for a unit of the numbers, shape [M, K]."""
    undetermined: float
    """Variance by axis of the sum of the loads that no point tells [stiffness² × px²]."""


class Whitened(NamedTuple):
    """Of the n points that count in a frame; rows of those not observed are 0."""

    transform: csr_array
    """What makes their errors independent and of size 1, shape [n, n]."""
    moved: np.ndarray
    """Their motion then, shape [n, 2]."""


class Profile(NamedTuple):
    """One frame at one foundation, by whitened motion."""

    loss: float
    """Negative log of the density, of all other unknowns at their likeliest."""
    force: np.ndarray
    """Sum of the loads, shape [2]."""
    variance: float
    """Of that, by axis."""


def loaded_cells(grid: PointGrid) -> np.ndarray:
    """Places of the grid on which forces may act, as numbers of its columns and rows, shape [M, 2].

    Every other one of those near the tool, as on a chessboard: the field around them is as free, at an eighth of the
    work. Under a long shaft half of these.
    """
    places = np.concatenate([grid.points[grid.distance < LOADED], grid.hidden])
    loaded = np.rint(places / grid.spacing).astype(np.int64)
    half = loaded[loaded.sum(axis=1) % 2 == 0]
    return half if len(half) <= MOST_LOADED else half[half[:, 0] % 2 == 0]


def load_precision(answer: np.ndarray, loaded: np.ndarray, energy: float = ENERGY) -> np.ndarray:
    """Prior precision of loads on places [M, 2] and of the background's three numbers, shape [M + 3, M + 3].

    Args:
        answer: of the sheet, as `physics.sheet.response` gives it.
        loaded: as of `loaded_cells`.
        energy: expected work of a load [px² · stiffness].
    """
    count = len(loaded)
    precision = np.zeros((count + 3, count + 3))
    own = answer[tuple(np.moveaxis(loaded[:, None] - loaded, -1, 0) % SIZE)] / energy
    precision[:count, :count] = own + TINY * own.max() * np.eye(count)
    return precision


class SheetProblem:
    """What the frames have in common.

    Args:
        grid: the points.
        reach: of the correlation between neighbours' errors [px].
    """

    def __init__(self, grid: PointGrid, reach: float = REACH) -> None:
        points, distance, _, spacing = grid
        cells = np.rint(points / spacing).astype(np.int64)
        self.counted = np.flatnonzero((distance < DENSE) | (cells % THIRD == 0).all(axis=1))
        """Points that count, shape [n]."""
        self.points, self.spacing = points, spacing
        """Of the grid."""
        self._loaded_cells = loaded_cells(grid)
        self._middle, self._size = points.mean(axis=0), points.std(axis=0)
        self.loaded = len(self._loaded_cells)
        self._whitening = Whitening(points[self.counted], reach)
        self._expected = max(points_as_one(spacing, reach), 1.0)

    def following(self, answer: np.ndarray, places: np.ndarray) -> np.ndarray:
        """How places of the grid [n, 2] [px] follow loads and background, shape [n, M + 3]."""
        cells = np.rint(places / self.spacing).astype(np.int64)
        apart = np.moveaxis(cells[:, None] - self._loaded_cells, -1, 0) % SIZE
        return np.hstack([answer[tuple(apart)], (places - self._middle) / self._size, np.ones((len(places), 1))])

    def design(self, log_anchor: float, energy: float = FREE) -> Design:
        """How the points that count follow what is unknown.

        Few combinations of loads under an instrument can be given apart: those of the prior's independent numbers that
        move the points, by the eigenvectors of what these say.
        """
        answer = response(float(np.exp(log_anchor)), SIZE)
        rows = self.following(answer, self.points[self.counted])
        prior = load_precision(answer, self._loaded_cells, energy)[: self.loaded, : self.loaded]
        triangle = cholesky(prior, check_finite=False)
        by_number = solve_triangular(triangle, rows[:, : self.loaded].T, trans=1, check_finite=False).T
        values, vectors = np.linalg.eigh(by_number.T @ by_number)
        loads = solve_triangular(triangle, vectors, check_finite=False)
        kept = values > NEGLIGIBLE
        rows = np.hstack([rows[:, : self.loaded] @ loads[:, kept], rows[:, self.loaded :]])
        precision, undetermined = np.repeat([1.0, 0.0], [kept.sum(), 3]), np.square(loads[:, ~kept].sum(axis=0)).sum()
        return Design(rows, precision, loads[:, kept], float(undetermined))

    def solve(self, design: Design, frame: SeenFrame, start: Solved | None = None) -> Solved:
        """The likeliest loads, background and size of errors, by weighting the points anew.

        Args:
            design: of the foundation.
            frame: what is observed.
            start: from which to begin.
        """
        seen = np.flatnonzero(np.isfinite(frame.moved[self.counted]).all(axis=1))
        given = np.square(np.maximum(frame.noise[self.counted][seen], LINK))
        rows, moved = design.rows[seen], frame.moved[self.counted][seen]
        scale = 0.0 if start is None else start.scale
        weights = np.ones(len(given)) if start is None else start.weights[seen]
        for _ in range(ROUNDS if start is None else AGAIN):
            before = weights
            root = np.sqrt(weights / (given + scale) / TOGETHER)[:, None]
            factor = _factor(rows * root, design.precision)
            found = cho_solve(factor, (rows * root).T @ (moved * root), check_finite=False)
            squares = np.square(moved - rows @ found).sum(axis=1)
            scale = error_scale(squares, given, weights, scale, LEAST_SCALE)
            weights = student_weights(squares, given + scale)
            if np.abs(weights - before).max() < CONVERGED:
                break
        whole = np.zeros(len(self.counted))
        whole[seen] = weights
        loss = student_loss(squares, given + scale) / TOGETHER
        loss += float(0.5 * design.precision @ np.square(found).sum(axis=1))
        return Solved(loss, np.vstack([design.loads @ found[:-3], found[-3:]]), whole, scale)

    def whitened(self, frame: SeenFrame, solved: Solved) -> Whitened:
        """What makes errors of a frame independent and of size 1."""
        given = np.square(np.maximum(frame.noise[self.counted], LINK)) + solved.scale
        sizes = np.sqrt(given / np.where(solved.weights > 0, solved.weights, np.nan))
        transform = self._whitening.transform(sizes)
        return Whitened(transform, transform @ np.where(solved.weights[:, None] > 0, frame.moved[self.counted], 0.0))

    def profile(self, design: Design, seen: Whitened) -> Profile:
        """All but the foundation at its likeliest."""
        rows = seen.transform @ design.rows
        factor = _factor(rows, design.precision)
        found = cho_solve(factor, rows.T @ seen.moved, check_finite=False)
        left = seen.moved - rows @ found
        total = np.append(design.loads.sum(axis=0), np.zeros(3))
        variance = float(total @ cho_solve(factor, total, check_finite=False)) + design.undetermined
        return Profile(0.5 * float((left * seen.moved).sum()), total @ found, variance)

    def motion(self, log_anchor: float, solved: Solved, places: np.ndarray) -> np.ndarray:
        """Where a sheet says that places of the grid go, shape as of the places […, 2] [px]."""
        following = self.following(response(float(np.exp(log_anchor)), SIZE), places.reshape(-1, 2))
        return (following @ solved.unknowns).reshape(places.shape)

    def left(self, log_anchor: float, frame: SeenFrame, solved: Solved) -> np.ndarray:
        """What is not explained over its given size, of all points, shape [N, 2]; outliers count little."""
        off = frame.moved - self.motion(log_anchor, solved, self.points)
        variance = np.square(np.maximum(frame.noise, LINK)) + solved.scale
        return off * np.sqrt(student_weights(np.square(off).sum(axis=1), variance) / variance)[:, None]

    def wider(self, left: np.ndarray) -> float:
        """By which factor variances grow if more points err together than was taken for granted, 1 or more."""
        return max(correlated_points(self.points, self.spacing, left) / self._expected, 1.0)


def _factor(rows: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, bool]:
    """Cholesky's, of the information of rows [n, P] and a prior precision [P]."""
    information = rows.T @ rows
    information[np.diag_indices_from(information)] += precision
    return cho_factor(information, overwrite_a=True, check_finite=False)


@dataclass(frozen=True, eq=False)
class Measuring:
    """How points are measured again where a sheet says that they are."""

    places: np.ndarray
    """Of the whole grid, also where there is no point, shape [rows, columns, 2] (column, row) [px]."""
    measure: Callable[[int, np.ndarray, np.ndarray], SeenFrame]
    """Gives a frame by its number, by the motion of the whole grid, shape [rows, columns, 2] [px], with those points
    that are named by numbers; their errors are correlated over `MEASURED_REACH` only."""


@dataclass(frozen=True, eq=False)
class ForceFit:
    """What holds gripped tissue in T frames."""

    log_force: float
    """Log of what holds it in the last frame over stiffness."""
    log_force_sd: float
    """Its standard deviation."""
    force: np.ndarray
    """What holds it along the last frame's direction over that of the last frame, shape [T]."""
    force_sd: np.ndarray
    """Its standard deviation, shape [T]; 0 in the last frame."""


@dataclass(frozen=True, eq=False)
class FoundationFit(ForceFit):
    """What a sheet tells of a grip; the force is over spring stiffness [px]."""

    log_anchor: float
    """Log of foundation over spring stiffness."""
    log_anchor_sd: float
    """Its standard deviation."""
    sheet: SheetMotion | None = None
    """How the sheet moves in the frames; None where its grip is taken as it was seen."""
    widens: float = 0.0
    """By how many standard deviations log foundation is lower by the larger pulls than by the smaller ones: motion
    spreads farther the more tissue is pulled, as where it stiffens, or comes to rest late."""


def fit_foundation(grid: PointGrid, frames: list[SeenFrame], measuring: Measuring | None = None) -> FoundationFit:
    """Fit the foundation of an endless sheet to some frames of a grip, in their order in time.

    Args:
        grid: the points.
        frames: at least one.
        measuring: how points are measured again where a sheet explains them; None = they aren't.

    Raises:
        NoSheet: the points move otherwise, or the instrument hides too much.
    """
    problem = SheetProblem(grid)
    if not 0 < problem.loaded <= MOST_LOADED:
        raise NoSheet(f"Forces may act on {problem.loaded} places; from 1 to {MOST_LOADED} can be distinguished.")
    spread = evenly(len(frames), MOST_FITTED)
    found = _search(problem, [frames[place] for place in spread])
    excess = float(np.sqrt(found.solved[-1].scale))
    if excess > EXCESS:
        raise NoSheet(f"Points are {excess:.2f} px off besides their noise.")
    judged, looked, error = problem, [frames[place] for place in spread], MODEL_ERRORS.foundation_followed
    if measuring is not None:
        spread, design = evenly(len(frames), MOST_MEASURED), problem.design(found.log_anchor)
        solved = [problem.solve(design, frames[place]) for place in spread]
        measured = SheetProblem(grid, MEASURED_REACH)
        again = _measured_again(measured, found._replace(solved=solved), spread, measuring)
        if again is not None:
            judged, (looked, found), error = measured, again, MODEL_ERRORS.foundation_measured
    variance, widens = _variance(judged, looked, found) + error**2, _widens(judged, looked, found, error)
    return _with_forces(problem, frames, found.log_anchor, variance, widens)


def _variance(problem: SheetProblem, frames: Sequence[SeenFrame], found: "_Found") -> float:
    """Of the log foundation of some frames, by what is left of their motion."""
    left = np.array([problem.left(found.log_anchor, *pair) for pair in zip(frames, found.solved, strict=True)])
    known = information(found.curvatures, frame_correlation(left))
    return problem.wider(left[-1]) * median_sd(left[-1]) ** 2 / max(known, TINY)


def _widens(problem: SheetProblem, frames: Sequence[SeenFrame], found: "_Found", error: float) -> float:
    """As of `FoundationFit`, by the error of the model in either; 0 where pulls are the same or tell little."""
    force = np.array([np.linalg.norm(solved.unknowns[:-3].sum(axis=0)) for solved in found.solved])
    larger = force > (force.min() + force.max()) / 2
    if not larger.any():
        return 0.0
    parts = [list(compress(frames, which)) for which in (~larger, larger)]
    fits = [_refined(problem, part, found.log_anchor) for part in parts]
    sd = float(np.sqrt(sum(_variance(problem, *pair) + error**2 for pair in zip(parts, fits, strict=True))))
    return (fits[0].log_anchor - fits[1].log_anchor) / sd if sd < VAGUE else 0.0


def _with_forces(
    problem: SheetProblem, frames: list[SeenFrame], log_anchor: float, variance: float, widens: float
) -> FoundationFit:
    """What all frames tell at a log foundation of that variance, their points as they were followed."""
    free = problem.design(log_anchor)
    solved = [problem.solve(free, frame) for frame in frames]
    followed = problem.left(log_anchor, frames[-1], solved[-1])
    wider = problem.wider(followed)
    errors = MODEL_ERRORS
    refuted = wider > errors.sheet_together or widens > WIDENS
    uneven = (errors.foundation_uneven, errors.force_uneven) if refuted else (0.0, 0.0)
    sd = 1 / np.sqrt(1 / (variance + uneven[0] ** 2) + SPREAD**-2)
    seen = [problem.whitened(*pair) for pair in zip(frames, solved, strict=True)]
    designs = (problem.design(log_anchor + step, ENERGY) for step in (-STEP, 0.0, STEP))
    less, here, more = ([problem.profile(design, frame) for frame in seen] for design in designs)
    (shorter, ratios_less, _), (length, along, _), (longer, ratios_more, _) = (
        along_last(np.array([item.force for item in found])) for found in (less, here, more)
    )
    bent = (np.log(longer) - np.log(shorter)) / (2 * STEP)
    variances = wider * np.array([item.variance for item in here])
    deviation = np.sqrt(variances[-1]) / length
    both = errors.force_common * along * np.sqrt(variances * variances[-1])
    relative = (variances + along**2 * variances[-1] - 2 * both) / length**2
    relative += np.square((ratios_more - ratios_less) / (2 * STEP) * sd)
    # The last frame's ratio is 1 by definition.
    relative[-1] = 0.0
    log_sd = float(np.hypot(np.hypot(bent * sd, median_sd(followed) * deviation), uneven[1]))
    nodes = continued(problem.points, problem.spacing, 1)
    rows = problem.following(response(float(np.exp(log_anchor)), SIZE), nodes)[:, :-3]
    sheet = SheetMotion(nodes, problem.spacing, np.stack([rows @ frame.unknowns[:-3] for frame in solved]))
    return FoundationFit(float(np.log(length)), log_sd, along, np.sqrt(relative), log_anchor, float(sd), sheet, widens)


class _Found(NamedTuple):
    """The likeliest foundation of J frames."""

    log_anchor: float
    curvatures: np.ndarray
    """What each of the frames tells of it, shape [J]."""
    solved: list[Solved]
    """Of each of the frames."""


def _search(problem: SheetProblem, fitted: Sequence[SeenFrame]) -> _Found:
    """The likeliest log foundation of some frames."""
    tried = np.arange(LIMITS[0], LIMITS[1] + GRID, GRID)
    # The last frame alone says roughly where.
    rough = np.array([problem.solve(problem.design(value), fitted[-1]).loss for value in tried])
    expected = np.square((tried - np.log(TYPICAL_ANCHOR)) / SPREAD)
    return _refined(problem, fitted, float(tried[np.argmin(rough + 0.5 * expected)]))


def _refined(problem: SheetProblem, fitted: Sequence[SeenFrame], log_anchor: float) -> _Found:
    """The same from a value on, by Newton's steps."""
    design = problem.design(log_anchor)
    solved = [problem.solve(design, frame) for frame in fitted]
    curvatures = np.zeros(len(fitted))
    for _ in range(NEWTON):
        seen = [problem.whitened(*pair) for pair in zip(fitted, solved, strict=True)]
        nearby = (problem.design(log_anchor - STEP), design, problem.design(log_anchor + STEP))
        low, middle, high = np.array([[problem.profile(near, frame).loss for frame in seen] for near in nearby])
        curvatures = (low + high - 2 * middle) / STEP**2
        slope = (high - low).mean() / (2 * STEP) + (log_anchor - np.log(TYPICAL_ANCHOR)) / SPREAD**2
        curvature = curvatures.mean() + SPREAD**-2
        step = np.clip(-slope / curvature if curvature > 0 else -np.sign(slope), -LONGEST, LONGEST)
        before, log_anchor = log_anchor, float(np.clip(log_anchor + step, *LIMITS))
        if abs(log_anchor - before) < PRECISION:
            break
        design = problem.design(log_anchor)
        solved = [problem.solve(design, *pair) for pair in zip(fitted, solved, strict=True)]
    return _Found(log_anchor, curvatures, solved)


def _measured_again(
    problem: SheetProblem, found: _Found, spread: Sequence[int], measuring: Measuring
) -> tuple[list[SeenFrame], _Found] | None:
    """Frames of those numbers as measured last, and the likeliest foundation; None where too few points are found.

    Frames that show too few are left out.
    """
    looked: list[SeenFrame] = []
    least = ENOUGH * len(spread)
    for _ in range(LOOKS):
        motions = [problem.motion(found.log_anchor, solved, measuring.places) for solved in found.solved]
        measured = [measuring.measure(*pair, problem.counted) for pair in zip(spread, motions, strict=True)]
        kept = [np.isfinite(frame.moved[problem.counted]).all(axis=1).mean() >= ENOUGH for frame in measured]
        looked, spread = list(compress(measured, kept)), list(compress(spread, kept))
        if len(looked) < least:
            return None
        found = _refined(problem, looked, found.log_anchor)
    return looked, found


def information(curvatures: np.ndarray, correlation: np.ndarray) -> float:
    """What J frames tell whose mean loss is minimised, by their curvatures [J] and their errors' correlation [J, J].

    Scores err as far as the curvatures say, and together as far as the errors do. Nothing is determined where no
    curvature is positive.
    """
    scores = np.sqrt(np.maximum(curvatures, 0.0))
    return float(np.square(scores).sum() ** 2 / max(scores @ correlation @ scores, TINY))


def frame_correlation(left: np.ndarray) -> np.ndarray:
    """Correlation of errors between J frames, by what is not explained [J, N, 2], shape [J, J].

    1 where no point is visible in all of them.
    """
    always = left[:, np.isfinite(left).all(axis=(0, 2))]
    if not always.size:
        return np.ones((len(left), len(left)))
    products = np.einsum("jna,kna->jk", always, always)
    sizes = np.sqrt(np.diag(products))
    return products / np.maximum(np.outer(sizes, sizes), np.finfo(np.float64).tiny)
