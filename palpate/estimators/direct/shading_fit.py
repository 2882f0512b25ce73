"""A contact's brightness fitted from start to verdict: starts, optimum, what it leaves open, estimate."""

import dataclasses
import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import press_fields
from palpate.estimators.direct.motion import Kind, PressMotion, about_tissue
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.direct.problem import apart, combine, distinct, evenly_spread, find_optimum
from palpate.estimators.estimate import LightFit, NoEstimate, PressResult
from palpate.observations.base import JointLikelihood
from palpate.observations.shading import OTHERS, ShadingObservation
from palpate.physics.identifiability import NINETY, box_information
from palpate.physics.load import PressShape
from palpate.physics.mechanics import RECOMMENDED, Mechanics
from palpate.physics.msd.simulation import simulate

MECHANICS = Mechanics(scheme="dkd", window_error=1e-4)
"""Its error lies far below the light's noise: half its step changed no logarithm of two clips by more than 0.02."""
TISSUE = RECOMMENDED.log_box
"""The box of φ, shape [2, 3]."""
DEPTHS = (0.03, 0.06, 0.1)
"""Largest displacements with which every one of them is tried, in shares of the tissue's distance."""
ASIDE = (-1.5, 0.0, 1.5)
"""Distances from the middle of what has darkened at which the dent is tried, by rows and columns [grid pixels]."""
TILTS = 0.3 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
"""Tilts with which every one of these places is tried, right and down, as tangents."""
FEW, MORE = 5, 8
"""Evaluations in a round of a start, and of the best one, after which residuals are weighed anew."""
ROUNDS = 2, 1, 2
"""Rounds of a start, and of the best one on each of two meshes: of the plane that was found last."""
FALL = 0.05
"""A round ends where a step lowers χ²/2 by less."""
CLIPPED = 0.2
"""Residuals of starts count as if they were no larger [logarithm of light]."""
FIRMER = (-1.5, 1.5)
"""Steps of log k_s, log k_d and log |F| from which other optima are looked for: only inertia tells their scale."""
RADIUS, RISING = 3.0, 0.05
"""Radius of the patch with which a press is tried [grid pixels], and how long its force rises and falls at first [s /
s]."""
Start = TypeVar("Start")
Fitted = TypeVar("Fitted")
WITHIN = 1.5
"""Frames by which a press may have begun, or ended, before or after the ones in which it was seen to."""


def shading_problem(
    contact: Interaction, mechanics: Mechanics, within: float, tilt: np.ndarray, kind: Kind = PressMotion
) -> JointLikelihood:
    """A brightness sequence under all parameters of a press on a plane; arguments as in `dent_problem`.

    Args:
        tilt: as in `ShadingObservation`.
    """
    shading = ShadingObservation(contact, tilt)
    return JointLikelihood([shading], partial(kind, shading.press, mechanics, within=within))


@threadpool_limits.wrap(limits=1, user_api="blas")  # matrices are small: its threads would wait for each other
def fit_shading(
    contact: Interaction, frame_seconds: float
) -> tuple[Interaction, PressResult, tuple[np.ndarray, np.ndarray]]:
    """Fit a contact's brightness sequence by a press on a plane: a step on a point, or a force on a patch.

    Args:
        contact: with its brightness sequence.
        frame_seconds: time from frame to frame [s]; the press may have begun and ended WITHIN of it off its frames.

    Returns:
        The contact on that plane, whose points aren't followed; the estimate; and times since the onset [s] with the
        simulated motion along the force, [T] each.

    Raises:
        NoEstimate: too few frames show the light around the contact, or no press in it shows there.
    """
    sequence = contact.shading
    if sequence is None or len(sequence.times) < 3:
        raise NoEstimate("Too few frames after the onset show how bright the tissue around the contact is.")
    mechanics, within = MECHANICS.matched(frame_seconds), WITHIN * frame_seconds * contact.intervals
    # Frames with which starts are chosen.
    some = np.unique(np.linspace(0, len(sequence.times) - 1, 8).round().astype(int))
    thin = contact.having(shading=sequence.chosen(some))
    problem = shading_problem(thin, mechanics, within, np.zeros(2))
    best = _on_threads(lambda start: _led(problem.copy(), start, FEW, ROUNDS[0]), _starts(problem))
    if not best:
        raise NoEstimate("The contact is too short to show in the light.")
    logs = min(best, key=lambda found: found[0])[1]
    problem = shading_problem(contact, mechanics, within, logs[-OTHERS + 2 : -OTHERS + 4])
    logs = _led(problem, logs, MORE, ROUNDS[1])[1]
    problem = shading_problem(contact, mechanics, within, logs[-OTHERS + 2 : -OTHERS + 4])
    logs = _led(problem, logs, MORE, ROUNDS[2])[1]
    # A press on a patch is not tried where a step on a point explains more.
    if problem.first.skill < 0.85:
        problem, logs = _patched(problem, logs, some)
    return problem.first.press, _concluded(problem, logs), _simulated(problem, logs)


def _patched(point: JointLikelihood, logs: np.ndarray, some: np.ndarray) -> tuple[JointLikelihood, np.ndarray]:
    """A press on a patch, in any direction, whose force rises and falls, where it explains clearly more; else the step.

    Args:
        point: the step of a force on a point, with its
        logs: that explain the light best, shape [D].
        some: frames by which it is decided whether a patch is worth a fit.
    """
    contact, motion = point.first.contact, point.motion
    thin = contact.having(shading=point.first.sequence.chosen(some))
    what = motion.mechanics, motion.within, point.first.sheet.tilt
    step, patch = (shading_problem(thin, *what, kind) for kind in (PressMotion, PatchMotion))
    assert isinstance(patch.motion, PatchMotion)
    step.look(logs)
    deepest = np.linalg.norm(motion.coarse(logs[:-OTHERS]), axis=-1).max()
    if not deepest > 0:  # as in a contact of one frame
        return point, logs
    changing = RISING * motion.times[-1]
    press = patch.motion.parameters(logs[:-OTHERS], PressShape(RADIUS, (0.0, 0.0), changing, changing))
    press[2] += math.log(deepest / np.linalg.norm(patch.motion.coarse(press), axis=-1).max())
    misfit, found = _led(patch, np.concatenate([press, logs[-OTHERS:]]), MORE, 1)
    if -misfit < step.first.skill:
        return point, logs
    problem = shading_problem(contact, *what, PatchMotion)
    misfit, found = _led(problem, found, MORE, ROUNDS[2])
    # A press on a patch is taken where it leaves less than this share of what a step on a point leaves.
    return (problem, found) if 1 + misfit < 0.8 * (1 - point.first.skill) else (point, logs)


def _on_threads(fit: Callable[[Start], Fitted], starts: Iterable[Start]) -> list[Fitted]:
    """Fits from several starts, on as many threads as there are cores: compiled rollouts run side by side."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(fit, starts))


def _simulated(problem: JointLikelihood, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times since the onset, and the contact's simulated displacement along the force, [T] each."""
    motion, press, step = problem.motion, problem.first.press, problem.motion.mechanics.time_step
    load = motion.load(logs[:-OTHERS], step, motion.longest)
    path = simulate(motion.theta(logs), press.mesh, load, motion.mechanics, watch=np.array([press.vertex]))[:, 0]
    times = motion.within * logs[motion.delays.start] + step * np.arange(len(path) + 1)
    return times, np.concatenate([[0.0], path @ press.direction])


def _start(problem: JointLikelihood, press: np.ndarray, *aside_and_tilt: Any) -> np.ndarray:
    """All parameters from those of a press, where its dent lies and how tissue tilts; the others as in their priors."""
    start, given = problem.started(press), np.concatenate(aside_and_tilt)
    start[len(press) : len(press) + len(given)] = given
    return start


def _starts(problem: JointLikelihood) -> np.ndarray:
    """All parameters of presses that explain the light best, among many, shape [S, D]."""
    low, high = problem.box(TISSUE)
    middle = problem.first.darkest()
    found, misfits = [], []

    def tried(start: np.ndarray, moved: np.ndarray) -> float:
        left = problem.first.compared(problem.first.predicted(start, moved)[0])[0]
        return float(np.square(np.clip(left, -CLIPPED, CLIPPED)).sum())

    # Points of a Sobol sequence over the box among which the starts are chosen.
    for candidate in evenly_spread(*TISSUE, 64):
        press = np.concatenate([candidate, np.zeros(len(low) - OTHERS - 3)])
        moved = problem.motion.coarse(press)
        largest = np.linalg.norm(moved, axis=-1).max() / problem.first.sheet.distance
        for depth in DEPTHS:
            factor = depth / max(largest, 1e-12)
            force = press[2] + math.log(factor)
            if TISSUE[0, 2] < force < TISSUE[1, 2]:
                start = _start(problem, np.concatenate([press[:2], [force], press[3:]]), middle)
                found.append(start)
                misfits.append(tried(start, factor * moved))
    # Fits, begun at the candidates that explain the light best.
    chosen = apart(np.array(found), np.array(misfits), low, high, 3)
    places = middle + np.stack(np.meshgrid(ASIDE, ASIDE), axis=-1).reshape(-1, 2)

    def placed(start: np.ndarray) -> np.ndarray:
        moved = problem.motion.coarse(start[:-OTHERS])
        starts = [_start(problem, start[:-OTHERS], place, tilt) for tilt in TILTS for place in places]
        left = np.array([tried(each, moved) for each in starts])
        # A tilt is taken where it leaves less than this share of what is left without one.
        left[: len(places)] *= 0.9
        return starts[int(np.argmin(left))]

    return np.array(_on_threads(placed, chosen))


def _led(problem: JointLikelihood, logs: np.ndarray, evaluations: int, rounds: int) -> tuple[float, np.ndarray]:
    """Return how badly parameters that some rounds of fits lead to explain the light, and those parameters."""
    box = problem.box(TISSUE)
    for _ in range(rounds):
        logs = np.clip(logs, box[0] + 1e-9, box[1] - 1e-9)
        problem.look(logs)
        logs = find_optimum(problem, logs, box, evaluations, FALL).logs
    problem.look(logs)
    return -problem.first.skill, logs


def _concluded(problem: JointLikelihood, logs: np.ndarray) -> PressResult:
    """Return the estimate: parameters that explain the light best, and what it leaves open around them and along the
    scale that inertia tells."""
    box, shading = problem.box(TISSUE), problem.first
    prior = box_information(box)
    low, high = box[0] + 1e-9, box[1] - 1e-9
    starts = [np.clip(np.concatenate([logs[:3] + step, logs[3:]]), low, high) for step in (0.0, *FIRMER)]
    optima = _on_threads(lambda start: find_optimum(problem.copy(), start, box, FEW, FALL), starts)
    mean, covariance, best = combine(distinct(optima), prior)
    unexplained = f"A press leaves {1 - shading.skill:.0%} of how the tissue's brightness changes"
    known = press_fields(problem, mean, best, box, best.logs)
    known["course"] = dataclasses.replace(known["course"], view_angle=None)
    return PressResult(
        **known,
        covariance=covariance[:3, :3] + shading.law_errors @ shading.law_errors.T,
        information=about_tissue(best.information, prior),
        noise=float(shading.noise.mean()),
        misfit=float(shading.noise.mean() / max(shading.sequence.noise.mean(), 1e-9)),
        light=LightFit(
            1 - shading.skill, float(mean[-1]) if mean[-1] > NINETY * math.sqrt(covariance[-1, -1]) else 0.0
        ),
        # A press that leaves a larger share of the change of light, root mean square, is no explanation.
        refuted=f"{unexplained}, so it isn't explained." if shading.skill < 0.6 else "",
    )
