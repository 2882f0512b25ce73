"""Where the fit of a slab to a film begins, and how it goes down to the least χ².

The middle of the tip is a pixel or two from the contact's vertex, and is found first, from small motions. Exact
derivatives of the motion give gradient and Gauss–Newton matrix; the latter is corrected from step to step by the
gradients seen (BFGS with Powell's damping; Nocedal & Wright 2006, procedure 18.2), because it takes the valley along
which E, d and F rise together for steeper than it is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from estimators.direct.contact_fit import AT_BOUND
from estimators.direct.field import FilmProblem
from estimators.direct.slab_motion import SlabMotion
from estimators.estimate import NoEstimate
from physics.identifiability import box_information

DIFFERENCE = 0.02
"""Of a parameter, for derivatives."""
YOUNG, DAMPING = np.log(np.geomspace(20.0, 2000.0, 11)), np.log(np.geomspace(5e3, 8e5, 7))
"""log E and log d among whose pairs a start is looked for."""
BESIDE, ASTRAY = 0.5, 2.0
"""A step of the tip's middle, for derivatives; and its standard deviation around the contact's vertex, which is a pixel
or two off [grid px]."""
LARGEST_STEP = 0.7
"""Of a parameter."""
ROUGH, DONE = 3.0, 0.2
"""Fall of χ²/2 to be expected of the next step, below which outliers are looked for, and the fit is done."""
MOST_STEPS = 10
"""With all that is seen, and again without outliers."""
LEAST_CURVATURE = 0.2
"""Of what the matrix says, that one step may leave of it along its way (Powell's damping)."""
SHORTER = 4.0
"""By so much a matrix grows where its step led uphill."""


def slab_start(problem: FilmProblem[SlabMotion]) -> np.ndarray:
    """Of a grid of parameters those that explain the film best if nothing strains much, with the force that suits."""
    motion = problem.motion
    low, high = motion.box
    still = problem.patches.covering(np.zeros((len(motion.times), len(problem.patches.vertices), 3)))
    best, least = np.zeros(len(low)), math.inf
    for young, damping in itertools.product(YOUNG, DAMPING):
        logs = np.zeros(len(low))
        logs[:2] = young, damping
        tried = problem.patches.shown(problem.patches.sunk(motion.by_modes(logs)), still)
        seen = np.isfinite(tried) & np.isfinite(problem.observed)
        tried, observed = np.where(seen, tried, 0.0), np.where(seen, problem.observed, 0.0)
        along, square = float((tried * observed).sum()), float(np.square(tried).sum())
        logs[2] = np.clip(math.log(max(along, 1e-12) / max(square, 1e-30)), low[2] + AT_BOUND, high[2] - AT_BOUND)
        unexplained = float(np.square(math.exp(logs[2]) * tried - observed).sum())
        if unexplained < least:
            best, least = logs, unexplained
    return best


def find_tip(
    problem_of: Callable[[tuple[float, float]], FilmProblem[SlabMotion]], place: tuple[float, float]
) -> tuple[float, float]:
    """Column and row of the tip's middle that explain a film better, from small motions [grid px].

    Args:
        problem_of: the film with the tip in some place.
        place: where it is taken to be.
    """
    problem, *beside = (problem_of((place[0] + x, place[1] + y)) for x, y in ((0, 0), (BESIDE, 0), (0, BESIDE)))
    logs = slab_start(problem)
    problem.look(logs)

    def whitened(motion: SlabMotion, tried: np.ndarray) -> np.ndarray:
        return problem.whitened(problem.change(motion.by_modes(tried), tried) - problem.observed)

    left = whitened(problem.motion, logs)
    slopes = [(whitened(problem.motion, logs + step) - left) / DIFFERENCE for step in DIFFERENCE * np.eye(len(logs))]
    slopes += [(whitened(other.motion, logs) - left) / BESIDE for other in beside]
    jacobian = np.stack(slopes, axis=1)
    prior = np.zeros((len(slopes), len(slopes)))
    prior[:-2, :-2] = box_information(problem.motion.box)
    prior[[-2, -1], [-2, -1]] = 1 / ASTRAY**2
    column, row = -np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ left)[-2:]
    return place[0] + float(column), place[1] + float(row)


def descend(problem: FilmProblem[SlabMotion], start: np.ndarray, box: np.ndarray, enough: float) -> np.ndarray:
    """Parameters [D] of the least χ² near a start within a box [2, D].

    Args:
        enough: fall of χ²/2 to be expected of a step, below which none is made.

    Raises:
        NoEstimate: the motion at the start can't be followed.
    """

    def at(logs: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        residual, jacobian = problem.linearise(logs)
        return 0.5 * float(residual @ residual), jacobian.T @ residual, jacobian.T @ jacobian

    if not np.isfinite(problem.motion.at(start)[0]).all():
        raise NoEstimate("The slab can't be followed where the fit begins; the dent may be too deep for it.")
    logs = start
    value, gradient, curvature = at(logs)
    curvature = curvature + box_information(box)
    for _ in range(MOST_STEPS):
        step = -np.linalg.solve(curvature, gradient)
        step = np.clip(logs + step * min(1.0, LARGEST_STEP / max(np.abs(step).max(), 1e-300)), *box) - logs
        bent = curvature @ step
        if -(gradient @ step + 0.5 * step @ bent) < enough:
            break
        tried, slope, _ = at(logs + step)
        if not tried < value:
            curvature = SHORTER * curvature
            continue
        square, change = float(step @ bent), slope - gradient
        share = 1.0
        if step @ change < LEAST_CURVATURE * square:
            share = (1 - LEAST_CURVATURE) * square / (square - float(step @ change))
        change = share * change + (1 - share) * bent
        curvature = curvature + np.outer(change, change) / (step @ change) - np.outer(bent, bent) / square
        logs, value, gradient = logs + step, tried, slope
    return logs
