"""How firmly gripped tissue is attached, and what holds it, with the grip's motion unknown.

Points beside an instrument are followed badly: windows that hold its edge are dragged along or held back by it. Taken
as a prescribed displacement they bias foundation and force by a quarter and more (docs/real.md). Here they are
observations as all others are, with their told noise: unknown are the forces on every place at the instrument, also on
tissue that it hides, and an endless sheet (`physics.endless_sheet`) answers these. Far points tell the sum of the
forces, and how fast the motion dies away, whatever happens at the grip. An affine background moves on its own.

Errors of points are Student's, whose scale is found in every frame: a sheet is not tissue. So many points as err alike
in the last frame count for one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar

from estimators.grip.alike import correlated_points
from estimators.grip.lattice import KNOT, SPREAD, TYPICAL_ANCHOR
from physics.endless_sheet import response

LOADED = 32.0
"""Forces act on tissue that began nearer to the tool [px]."""
DENSE, THIRD = 48.0, 3
"""Of points that began farther from the tool every third one along both axes counts: neighbours err alike."""
SIZE = 512
"""Of the repeated piece of the endless sheet [nodes]."""
ENERGY = 300.0
"""Prior scale of the work that the forces do, a number of them [px² · stiffness]: at a node alone 10 px."""
ALIKE = KNOT**2 / THIRD**2
"""So many of the points that count err alike at least: what a sheet can't explain is smooth over a knot's cell."""
FREEDOM = 3.0
"""Of Student's distribution, in the plane."""
LINK = 0.1
"""Least standard deviation of a point by axis [px]."""
ROUNDS, AGAIN, CONVERGED = 15, 4, 1e-3
"""Of weighting the points anew: at most, where near values are solved, and the change of weights that ends them."""
SCALED = 10
"""Steps to the errors' scale."""
MOST_FITTED = 4
"""So many frames, evenly spread, tell the foundation: the motion grows steadily."""
GRID, REACH, PRECISION = 1.0, 1.0, 0.005
"""Of the search for log foundation: between the values tried first, from the best of them, and how near it ends."""
LIMITS = -10.0, 1.0
"""Of log foundation: motion that dies away over 260 nodes, and within one."""
STEP = 0.1
"""Of log foundation, for derivatives."""
COMMON = 0.97
"""Correlation between errors of the force in two frames: where it acts beneath the instrument is as unknown in one as
in the other. Chosen on 19 drawn clips (docs/real.md)."""
TINY = 1e-9
"""Of the largest: added to a diagonal so that rounding doesn't make it indefinite."""


EXCESS = 0.03
"""Errors beyond the told noise of this size, by axis, show that tissue is no such sheet [px]: at most 0.011 on 15 drawn
clips of one, 0.05 where a region is stiffer, 0.7 on a real clip. Forces that are free then explain too much."""
MOST_LOADED = 400
"""More places with a force take minutes, and leave too much free."""


class NoSheet(ValueError):
    """Forces at the instrument and a sheet that is alike everywhere don't explain the points to within their noise."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """Followed points of one frame; N points."""

    moved: np.ndarray
    """Displacement since rest, shape [N, 2] [px]; not a number where a point is lost."""
    noise: np.ndarray
    """Its standard deviation by axis, shape [N] [px]."""


@dataclass(frozen=True, eq=False)
class FoundationFit:
    """What some frames of a grip tell; T frames."""

    log_anchor: float
    """Log of foundation over spring stiffness."""
    log_anchor_sd: float
    """Its standard deviation."""
    log_force: float
    """Log of what holds the tissue in the last frame over stiffness [px]."""
    log_force_sd: float
    """Its standard deviation."""
    force: np.ndarray
    """What holds the tissue along the last frame's direction over that of the last frame, shape [T]."""
    force_sd: np.ndarray
    """Its standard deviation, shape [T]; 0 in the last frame."""


@dataclass(eq=False)
class _Solved:
    """One frame at one foundation; M places that are loaded."""

    loss: float
    """Negative log of the density, of all unknowns at their likeliest."""
    unknowns: np.ndarray
    """Loads and the background's motion, shape [M + 3, 2]."""
    loads: np.ndarray
    """On every place, shape [M, 2] [stiffness × px]."""
    sum_variance: float
    """Of the sum of the loads, by axis."""
    weights: np.ndarray
    """Of the points that count, 0 for those not seen."""
    scale: float
    """Of the errors besides the told noise, variance by axis [px²]."""


def loaded_cells(points: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int) -> np.ndarray:
    """Places of the grid on which forces may act, as numbers of its columns and rows, shape [M, 2].

    Every other one of those near the tool, as on a chessboard: the field around them is as free, at an eighth of the
    work. Arguments as of `fit_foundation`.
    """
    loaded = np.rint(np.concatenate([points[distance < LOADED], hidden]) / spacing).astype(np.int64)
    return loaded[loaded.sum(axis=1) % 2 == 0]


def load_precision(answer: np.ndarray, loaded: np.ndarray) -> np.ndarray:
    """Prior precision of loads on places [M, 2] and of the background's three numbers, shape [M + 3, M + 3].

    Args:
        answer: of the sheet, as `physics.endless_sheet.response` gives it.
        loaded: as of `loaded_cells`.
    """
    count = len(loaded)
    precision = np.zeros((count + 3, count + 3))
    own = answer[tuple(np.moveaxis(loaded[:, None] - loaded, -1, 0) % SIZE)] / ENERGY
    precision[:count, :count] = own + TINY * own.max() * np.eye(count)
    return precision


class _Problem:
    """What the frames have in common.

    Args:
        points: at rest, shape [N, 2] [px].
        distance: from the tool there, shape [N] [px].
        hidden: places of the grid that the tool hides, shape [H, 2] [px].
        spacing: of the grid [px].
    """

    def __init__(self, points: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int) -> None:
        loaded = loaded_cells(points, distance, hidden, spacing)
        cells = np.rint(points / spacing).astype(np.int64)
        self.counted = np.flatnonzero((distance < DENSE) | (cells % THIRD == 0).all(axis=1))
        """Points that count, shape [n]."""
        self._cells, self._loaded_cells = cells, loaded
        self._apart = np.moveaxis(cells[self.counted][:, None] - loaded, -1, 0) % SIZE
        middle, spread = points.mean(axis=0), points.std(axis=0)
        self._terms = np.column_stack([(points - middle) / spread, np.ones(len(points))])
        self.loaded = len(loaded)

    def design(self, log_anchor: float) -> tuple[np.ndarray, np.ndarray]:
        """How the points that count follow loads and background, shape [n, M + 3], and the prior precision of these."""
        answer = response(float(np.exp(log_anchor)), SIZE)
        design = np.hstack([answer[tuple(self._apart)], self._terms[self.counted]])
        return design, load_precision(answer, self._loaded_cells)

    def solve(self, design: tuple[np.ndarray, np.ndarray], frame: SeenFrame, start: _Solved | None = None) -> _Solved:
        """The likeliest loads, background and size of errors, by weighting the points anew.

        Args:
            design: of the foundation.
            frame: what is seen.
            start: from which to begin.
        """
        full, precision = design
        seen = np.flatnonzero(np.isfinite(frame.moved[self.counted]).all(axis=1))
        told = np.square(np.maximum(frame.noise[self.counted][seen], LINK))
        rows, moved = full[seen], frame.moved[self.counted][seen]
        scale = 0.0 if start is None else start.scale
        weights = np.ones(len(told)) if start is None else start.weights[seen]
        for _ in range(ROUNDS if start is None else AGAIN):
            before = weights
            root = np.sqrt(weights / (told + scale) / ALIKE)[:, None]
            factor = cho_factor((rows * root).T @ (rows * root) + precision, check_finite=False)
            found = cho_solve(factor, (rows * root).T @ (moved * root), check_finite=False)
            squares = np.square(moved - rows @ found).sum(axis=1)
            scale = error_scale(squares, told, weights, scale)
            weights = (FREEDOM + 2) / (FREEDOM + squares / (told + scale))
            if np.abs(weights - before).max() < CONVERGED:
                break
        variance = told + scale
        density = (FREEDOM + 2) / 2 * np.log1p(squares / variance / FREEDOM) + np.log(variance)
        loads = found[: self.loaded]
        total = np.append(np.ones(self.loaded), np.zeros(3))
        whole = np.zeros(len(self.counted))
        whole[seen] = weights
        return _Solved(
            float(density.sum() / ALIKE + 0.5 * np.einsum("ia,ij,ja->", found, precision, found)),
            found,
            loads,
            float(total @ cho_solve(factor, total, check_finite=False)),
            whole,
            scale,
        )

    def wider(self, log_anchor: float, frame: SeenFrame) -> float:
        """By which factor variances grow if more points err alike in a frame than was taken for granted, 1 or more."""
        solved = self.solve(self.design(log_anchor), frame)
        answer = response(float(np.exp(log_anchor)), SIZE)
        apart = np.moveaxis(self._cells[:, None] - self._loaded_cells, -1, 0) % SIZE
        explained = np.hstack([answer[tuple(apart)], self._terms]) @ solved.unknowns
        off, variance = frame.moved - explained, np.square(np.maximum(frame.noise, LINK)) + solved.scale
        # As they weigh in the fit: outliers hardly count.
        weights = (FREEDOM + 2) / (FREEDOM + np.square(off).sum(axis=1) / variance)
        alike = correlated_points(self._cells, 1, off * np.sqrt(weights / variance)[:, None])
        return max(alike / (ALIKE * THIRD**2), 1.0)


def fit_foundation(
    points: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int, frames: Sequence[SeenFrame]
) -> FoundationFit:
    """Fit the foundation of an endless sheet to some frames of a grip, in their order in time.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        distance: from the tool there, shape [N] [px].
        hidden: places of the grid that the tool hides there, shape [H, 2] [px].
        spacing: of the grid [px].
        frames: at least one.

    Raises:
        NoSheet: the points move otherwise, or the instrument hides too much.
    """
    problem = _Problem(points, distance, hidden, spacing)
    if not 0 < problem.loaded <= MOST_LOADED:
        raise NoSheet(f"Forces may act on {problem.loaded} places; from 1 to {MOST_LOADED} can be told apart.")
    fitted = _spread(frames)
    starts: list[_Solved | None] = [None] * len(fitted)

    def prior(log_anchor: float) -> float:
        return 0.5 * ((log_anchor - np.log(TYPICAL_ANCHOR)) / SPREAD) ** 2

    def loss(log_anchor: float) -> float:
        design = problem.design(log_anchor)
        starts[:] = [problem.solve(design, *pair) for pair in zip(fitted, starts, strict=True)]
        told = sum(item.loss for item in starts if item is not None) / len(fitted)
        return told + prior(log_anchor)

    tried = np.arange(LIMITS[0], LIMITS[1] + GRID, GRID)
    # The last frame alone says roughly where.
    rough = [problem.solve(problem.design(value), frames[-1]) for value in tried]
    best = tried[np.argmin([item.loss + prior(value) for item, value in zip(rough, tried, strict=True)])]
    around = np.clip([best - REACH, best + REACH], *LIMITS)
    log_anchor = float(minimize_scalar(loss, bounds=around, method="bounded", options={"xatol": PRECISION}).x)
    excess = float(np.sqrt(problem.solve(problem.design(log_anchor), frames[-1]).scale))
    if excess > EXCESS:
        raise NoSheet(f"Points are {excess:.2f} px off besides their noise.")
    middle, low, high = (loss(log_anchor + step) for step in (0.0, -STEP, STEP))
    curvature = (low + high - 2 * middle) / STEP**2
    wider = problem.wider(log_anchor, frames[-1])
    sd = 1 / np.sqrt(max(curvature / wider, SPREAD**-2))
    forces, variances = _forces(problem, log_anchor, frames)
    variances = wider * variances
    length, along = along_last(forces)
    (less, ratios_less), (more, ratios_more) = (
        along_last(_forces(problem, log_anchor + step, frames)[0]) for step in (-STEP, STEP)
    )
    bent = (np.log(more) - np.log(less)) / (2 * STEP)
    both = COMMON * along * np.sqrt(variances * variances[-1])
    relative = (variances + along**2 * variances[-1] - 2 * both) / length**2
    relative += np.square((ratios_more - ratios_less) / (2 * STEP) * sd)
    # The last frame's ratio is 1 by definition.
    relative[-1] = 0.0
    return FoundationFit(
        log_anchor,
        float(sd),
        float(np.log(length)),
        float(np.hypot(bent * sd, np.sqrt(variances[-1]) / length)),
        along,
        np.sqrt(relative),
    )


def _spread(frames: Sequence[SeenFrame]) -> list[SeenFrame]:
    """At most MOST_FITTED of them, evenly spread, the last one included."""
    places = np.linspace(0, len(frames), min(MOST_FITTED, len(frames)) + 1)[1:].round().astype(int) - 1
    return [frames[place] for place in places]


def _forces(problem: _Problem, log_anchor: float, frames: Sequence[SeenFrame]) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the loads of every frame, shape [T, 2], and its variance by axis, shape [T]."""
    design = problem.design(log_anchor)
    found = [problem.solve(design, frame) for frame in frames]
    return np.array([item.loads.sum(axis=0) for item in found]), np.array([item.sum_variance for item in found])


def along_last(forces: np.ndarray) -> tuple[float, np.ndarray]:
    """Length of the last of forces [T, 2], and all along it over this, shape [T]."""
    length = float(np.linalg.norm(forces[-1]))
    return length, forces @ forces[-1] / length**2


def error_scale(squares: np.ndarray, told: np.ndarray, weights: np.ndarray, scale: float) -> float:
    """Likeliest variance by axis of weighted errors besides the told one, from a value on [px²].

    Args:
        squares: squared lengths of errors in the plane, shape [n] [px²].
        told: variances by axis, shape [n] [px²].
        weights: shape [n].
        scale: the value so far.
    """
    found = max(scale, float(told.min()))
    for _ in range(SCALED):
        variance = told + found
        found *= float(np.sqrt((weights * squares / (2 * variance**2)).sum() / (1 / variance).sum()))
    return found if found > LINK**2 / 100 else 0.0
