"""How firmly gripped tissue is attached, and what holds it, with the grip's motion unknown.

Points beside an instrument are followed badly: windows that hold its edge are dragged along or held back by it. Taken
as a prescribed displacement they bias foundation and force by a quarter and more (docs/real.md). Here they are
observations as all others are, with their told noise, and the forces at the instrument are unknown
(`estimators.grip.sheet_problem`). Far points tell the sum of the forces, and how fast the motion dies away, whatever
happens at the grip.

Followed points are filtered, which biases them where neighbours lie on one side. So once a sheet explains them, they
are measured again where it says they are. Should more points err alike than expected, they count for less.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple

import numpy as np

from estimators.grip.lattice import SPREAD, TYPICAL_ANCHOR
from estimators.grip.sheet_problem import ENERGY, MOST_LOADED, TINY, SeenFrame, SheetProblem, Solved
from estimators.grip.whitening import MEASURED_REACH

LOOKS = 4
"""Times that points are measured again where the fit so far says they are: after 1 to 4 of them 28 drawn clips were
0.0123, 0.0077, 0.0071 and 0.0066 off (those of `SHEET_ERROR`)."""
ENOUGH = 0.5
"""Of the points that count such a share must be found in a frame, and such a share of the frames must be left, or
points stay as they were followed."""
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
COMMON = 0.85
"""Correlation between errors of the force in two frames: where it acts beneath the instrument is as unknown in one as
in the other. Its intervals held 96 and 88 % on 47 drawn clips (docs/real.md), 80 to 88 % with 0.93 to 0.95 on 45."""
SHEET_ERROR, FOLLOWED_ERROR = 0.005, 0.015
"""Standard deviation of log foundation besides what residuals tell: of measured points, as 28 drawn clips are 0.0066
off where residuals tell 0.0045 (seeds 9201, 9202, 9303, and the four worst of 8915), and of followed ones (1.3 to 2.2 %
off on 45 clips)."""
ROBUST = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute values."""
EXCESS = 0.03
"""Errors beyond the told noise of this size, by axis, show that tissue is no such sheet [px]: at most 0.011 on 15 drawn
clips of one, 0.05 where a region is stiffer, 0.7 on a real clip. Forces that are free then explain too much."""
MOST_ALIKE, MISFIT = 2.0, (0.43, 0.68)
"""Where what is left of the motion goes together over so many times as many points as following errs alike (1.0 times
on 18 drawn clips, 4 and more where motion dies away exponentially), tissue is no such sheet either, and the standard
deviations of log foundation and log force count these besides: of six drawn clips with two regions four were so, 0.27
and 0.24 off (root mean squares)."""


class NoSheet(ValueError):
    """Forces at the instrument and a sheet that is alike everywhere don't explain the points to within their noise."""


@dataclass(frozen=True, eq=False)
class Measuring:
    """How points are measured again where a sheet says that they are."""

    places: np.ndarray
    """Of the whole grid, also where there is no point, shape [rows, columns, 2] (column, row) [px]."""
    measure: Callable[[int, np.ndarray, np.ndarray], SeenFrame]
    """Gives a frame by its number, by the motion of the whole grid, shape [rows, columns, 2] [px], with those points
    that are named by numbers; their errors are alike over `MEASURED_REACH` only."""


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


def fit_foundation(
    points: np.ndarray,
    distance: np.ndarray,
    hidden: np.ndarray,
    spacing: int,
    frames: Sequence[SeenFrame],
    measuring: Measuring | None = None,
) -> FoundationFit:
    """Fit the foundation of an endless sheet to some frames of a grip, in their order in time.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        distance: from the tool there, shape [N] [px].
        hidden: places of the grid that the tool hides there, shape [H, 2] [px].
        spacing: of the grid [px].
        frames: at least one.
        measuring: how points are measured again where a sheet explains them; None = they aren't.

    Raises:
        NoSheet: the points move otherwise, or the instrument hides too much.
    """
    problem = SheetProblem(points, distance, hidden, spacing)
    if not 0 < problem.loaded <= MOST_LOADED:
        raise NoSheet(f"Forces may act on {problem.loaded} places; from 1 to {MOST_LOADED} can be told apart.")
    spread = _spread(len(frames), MOST_FITTED)
    found = _search(problem, [frames[place] for place in spread])
    excess = float(np.sqrt(found.solved[-1].scale))
    if excess > EXCESS:
        raise NoSheet(f"Points are {excess:.2f} px off besides their noise.")
    judged, looked, error = problem, [frames[place] for place in spread], FOLLOWED_ERROR
    if measuring is not None:
        spread, design = _spread(len(frames), MOST_MEASURED), problem.design(found.log_anchor)
        solved = [problem.solve(design, frames[place]) for place in spread]
        measured = SheetProblem(points, distance, hidden, spacing, MEASURED_REACH)
        again = _measured_again(measured, found._replace(solved=solved), spread, measuring)
        if again is not None:
            judged, (looked, found), error = measured, again, SHEET_ERROR
    log_anchor = found.log_anchor
    left = np.array([judged.left(log_anchor, *pair) for pair in zip(looked, found.solved, strict=True)])
    told = information(found.curvatures, frame_correlation(left))
    variance = judged.wider(left[-1]) * error_size(left[-1]) ** 2 / max(told, TINY)
    return _with_forces(problem, frames, log_anchor, variance + error**2)


def _with_forces(
    problem: SheetProblem, frames: Sequence[SeenFrame], log_anchor: float, variance: float
) -> FoundationFit:
    """What all frames tell at a log foundation of that variance, their points as they were followed."""
    free = problem.design(log_anchor)
    solved = [problem.solve(free, frame) for frame in frames]
    followed = problem.left(log_anchor, frames[-1], solved[-1])
    wider = problem.wider(followed)
    misfit = MISFIT if wider > MOST_ALIKE else (0.0, 0.0)
    sd = 1 / np.sqrt(1 / (variance + misfit[0] ** 2) + SPREAD**-2)
    seen = [problem.whitened(*pair) for pair in zip(frames, solved, strict=True)]
    less, here, more = (
        [problem.profile(design, frame) for frame in seen]
        for design in (problem.design(log_anchor + step, ENERGY) for step in (-STEP, 0.0, STEP))
    )
    (shorter, ratios_less), (length, along), (longer, ratios_more) = (
        along_last(np.array([item.force for item in told])) for told in (less, here, more)
    )
    bent = (np.log(longer) - np.log(shorter)) / (2 * STEP)
    variances = wider * np.array([item.variance for item in here])
    deviation = np.sqrt(variances[-1]) / length
    both = COMMON * along * np.sqrt(variances * variances[-1])
    relative = (variances + along**2 * variances[-1] - 2 * both) / length**2
    relative += np.square((ratios_more - ratios_less) / (2 * STEP) * sd)
    # The last frame's ratio is 1 by definition.
    relative[-1] = 0.0
    return FoundationFit(
        log_anchor,
        float(sd),
        float(np.log(length)),
        float(np.hypot(np.hypot(bent * sd, error_size(followed) * deviation), misfit[1])),
        along,
        np.sqrt(relative),
    )


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

    Scores err as far as the curvatures say, and alike as far as the errors do. Nothing is told where no curvature is
    positive.
    """
    scores = np.sqrt(np.maximum(curvatures, 0.0))
    return float(np.square(scores).sum() ** 2 / max(scores @ correlation @ scores, TINY))


def error_size(left: np.ndarray) -> float:
    """How large errors are over what was told, by what is not explained [N, 2]; not a number where nothing is seen."""
    return float(ROBUST * np.nanmedian(np.abs(left)))


def frame_correlation(left: np.ndarray) -> np.ndarray:
    """Correlation of errors between J frames, by what is not explained [J, N, 2], shape [J, J].

    1 where no point is seen in all of them.
    """
    always = left[:, np.isfinite(left).all(axis=(0, 2))]
    if not always.size:
        return np.ones((len(left), len(left)))
    products = np.einsum("jna,kna->jk", always, always)
    sizes = np.sqrt(np.diag(products))
    return products / np.maximum(np.outer(sizes, sizes), np.finfo(np.float64).tiny)


def _spread(count: int, most: int) -> list[int]:
    """Numbers of at most so many frames of all, evenly spread, the last one included."""
    return (np.linspace(0, count, min(most, count) + 1)[1:].round().astype(int) - 1).tolist()


def along_last(forces: np.ndarray) -> tuple[float, np.ndarray]:
    """Length of the last of forces [T, 2], and all along it over this, shape [T]."""
    length = float(np.linalg.norm(forces[-1]))
    return length, forces @ forces[-1] / length**2
