"""Where the fit of a slab to a depth-change sequence begins, and how it goes down to the least χ².

The middle of the tip is a pixel or two from the contact's vertex, and is found first, from small motions. Then a trust
region goes down by exact derivatives of the motion. (On six drawn slabs, 0.3 to 0.8 off in every logarithm at first, it
took 36 simulations in all, where Gauss and Newton's matrix corrected by the observed gradients took 47, and χ²/2 ended
0 to 69 lower.)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from palpate.estimators.direct.contact_fit import AT_BOUND
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.problem import find_optimum
from palpate.estimators.direct.slab_motion import SlabMotion
from palpate.estimators.estimate import NoEstimate
from palpate.physics.identifiability import box_information

DIFFERENCE = 0.02
"""Of a parameter, for derivatives."""
YOUNG, DAMPING = np.log(np.geomspace(20.0, 2000.0, 11)), np.log(np.geomspace(5e3, 8e5, 7))
"""log E and log d among whose pairs a start is looked for."""
BESIDE, ASTRAY = 0.5, 2.0
"""A step of the tip's middle, for derivatives; and its standard deviation around the contact's vertex, which is a pixel
or two off [grid px]."""
ROUGH, DONE = 3.0, 0.2
"""Fall of χ²/2 in a step, below which outliers are looked for, and the fit is done."""
EVALUATIONS = 10
"""With all that is visible, and again without outliers."""


def slab_start(problem: SequenceProblem[SlabMotion]) -> np.ndarray:
    """Of a grid of parameters those that explain the sequence best if nothing strains much, with the force that
    suits."""
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
    problem_of: Callable[[tuple[float, float]], SequenceProblem[SlabMotion]], place: tuple[float, float]
) -> tuple[float, float]:
    """Column and row of the tip's middle that explain a depth-change sequence better, from small motions [grid px].

    Args:
        problem_of: the depth-change sequence with the tip in some place.
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


def descend(problem: SequenceProblem[SlabMotion], start: np.ndarray, box: np.ndarray, enough: float) -> np.ndarray:
    """Parameters [D] of the least χ² near a start within a box [2, D].

    Args:
        enough: fall of χ²/2 in a step, below which none is made.

    Raises:
        NoEstimate: the motion at the start can't be followed.
    """

    if not np.isfinite(problem.motion.at(start)[0]).all():
        raise NoEstimate("The slab can't be followed where the fit begins; the dent may be too deep for it.")
    return find_optimum(problem, start, *box, EVALUATIONS, enough).logs
