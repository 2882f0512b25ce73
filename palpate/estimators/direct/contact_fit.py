"""A contact's dent fitted from start to verdict: optima, the posterior, the estimate."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.motion import about_tissue
from palpate.estimators.direct.patch import RADII, PatchMotion
from palpate.estimators.direct.problem import (
    DELAYS,
    Optimum,
    apart,
    combine,
    dent_problem,
    distinct,
    evenly_spread,
    evidence_shares,
    find_optimum,
    suiting_forces,
)
from palpate.estimators.direct.sampling import Draws, Mixture, sample_posterior
from palpate.estimators.estimate import PressCourse, PressResult
from palpate.estimators.oblique import effective_misfit, hides_bottom, is_oblique, view_angle
from palpate.observations.base import JointLikelihood
from palpate.physics.identifiability import bounds, box_information
from palpate.physics.load import PressShape
from palpate.physics.mechanics import Mechanics


def press_fields(
    problem: JointLikelihood, mean: np.ndarray, best: Optimum, box: np.ndarray, logs: np.ndarray
) -> dict[str, Any]:
    """Return fields of `PressResult` that every fit has: θ, and how and when the instrument pressed.

    Args:
        problem, mean, best: what was fitted, the mean [D] and the best optimum.
        box: lower and upper ends of all parameters, shape [2, D].
        logs: parameters whose delays count, shape [D].
    """
    motion, delays = problem.motion, logs[problem.motion.delays]
    at_end = bool((np.abs(delays) > 0.9).any())  # the press may have begun or ended beyond
    shape, angle = motion.shape(problem.press(mean)), view_angle(problem.first.contact)
    course = PressCourse(*(motion.within * delays).tolist(), at_end=at_end, shape=shape, view_angle=angle)
    at_bound = np.minimum(best.logs - box[0], box[1] - best.logs)[:3] < 1e-3
    return {"theta": motion.theta(mean), "at_bound": at_bound, "course": course}


def trusted_information(information: Sequence[np.ndarray]) -> np.ndarray:
    """Return the one of several draws' information [3, 3] that two thirds of them equal or exceed.

    The information of a motion depends on θ itself. A verdict at the mean alone would be as uncertain as that.
    """
    order = sorted(information, key=lambda found: float(bounds(found).max()))
    # Half would trust the prior, with its too pliable tissue; two thirds and more gave the most right verdicts.
    return order[math.ceil(2 / 3 * len(order)) - 1]


FITS = 3
"""Starts that are fitted to the end; where there are more, the best of them."""
NARROW = 0.1
"""Standard deviation of log θ below which a posterior counts as normal and is not sampled."""


def field_optima(problem: JointLikelihood, tissue: np.ndarray) -> list[Optimum]:
    """Return the optima of a sequence's fit, the best first; the problem has looked at that one.

    Args:
        problem: the depth-change sequence.
        tissue: the box of φ, shape [2, 3].
    """
    box = problem.motion.box(tissue)
    found = []
    for logs in raced(problem.coarser(), field_starts(problem, box), box):
        problem.look(logs)
        found.append(find_optimum(problem, logs, box))
    optima = distinct(found)
    for _ in range(problem.motion.looks):
        problem.look(optima[0].logs, finer=True, outliers=True)
        optima = distinct([find_optimum(problem, optimum.logs, box) for optimum in optima])
        # Optima whose misfit is so much larger than the best one's are out [nats].
        optima = [optimum for optimum in optima if optimum.cost < optima[0].cost + 20.0]
    return optima


def refutes(misfit: float, problem: JointLikelihood) -> bool:
    """Return whether a misfit refutes a fit: above 1.1, and its square 5 standard deviations above 1 (patches in
    validation gave 23)."""
    return misfit > 1.1 and (misfit**2 - 1) * math.sqrt(problem.first.counted / 2) > 5.0


def sampled(problem: JointLikelihood, optima: list[Optimum], tissue: np.ndarray) -> PressResult:
    """Return the posterior around the optima of a sequence's fit, with its verdict; `tissue` as in `field_optima`.

    Where the contact may hide its own bottom, or the model is refuted, the covariance of a large noise is added to its
    own.
    """
    box = problem.motion.box(tissue)
    prior = box_information(box)
    mean, spread, best = combine(optima, prior)
    misfit = problem.misfit(best.logs)
    scale = max(1.0, misfit) ** 2
    spread, judges = scale * spread, mean[None]
    if problem.motion.sampled and (len(optima) > 1 or (np.diag(spread)[:3] > NARROW**2).any()):
        draws = _sample_field(problem, optima, best, box, scale)
        # Fewer effective draws say less than the optima themselves; the information of 15 draws is compared.
        if draws.effective >= 10.0:
            mean, spread, judges = draws.mean, draws.covariance, draws.thinned(15)
    information = problem.information(mean)
    found = PressResult(
        **press_fields(problem, mean, best, box, mean),
        covariance=spread[:3, :3],
        information=information[:3, :3],
        expected_information=trusted_information([about_tissue(problem.information(logs), prior) for logs in judges]),
        noise=problem.first.noise.total,
        misfit=misfit,
        largest_misfit=1.5,
    )
    if is_oblique(found):
        contact, course = problem.first.contact, found.course
        assert course.view_angle is not None
        dent = contact.mesh.vertices[problem.first.vertices], problem.motion.at(best.logs)[0]
        if not hides_bottom(*dent, np.asarray(contact.direction, np.float64), course.view_angle):
            found = dataclasses.replace(found, course=dataclasses.replace(course, view_angle=None))
    wrong = effective_misfit(found) ** 2
    if refutes(misfit, problem):
        # What a wrong model leaves in a frame, beyond the noise, is one error however many pixels show it.
        wrong += (misfit**2 - 1) * problem.first.counted / len(problem.first.times)
    if wrong <= scale and not is_oblique(found):
        return found
    return found.widened(np.linalg.inv(about_tissue(information / wrong, prior) + prior[:3, :3]))


def fit_press(
    contact: Interaction, mechanics: Mechanics, within: float, noise: float | None, tissue: np.ndarray, tries: int = 2
) -> PressResult:
    """Fit a depth-change sequence by a step on the contact vertex and, where that is refuted, by a press of any shape.

    The shape (`estimators.direct.patch`) is kept where it explains more than so many further parameters would by
    chance (Schwarz 1978).

    Args:
        contact, mechanics, within, noise: as in `JointLikelihood`.
        tissue: the box of φ, shape [2, 3].
        tries: how often the contact may be moved to the vertex at which the dent seems to lie.
    """
    step = dent_problem(contact, mechanics, within, noise)
    plain = field_optima(step, tissue)
    # Whether a step is refuted shows before its posterior is sampled, which takes as long as all the rest.
    best = combine(plain, box_information(step.motion.box(tissue)))[2]
    misfit = step.misfit(best.logs)
    if not refutes(misfit, step):
        return sampled(step, plain, tissue)
    elsewhere, aside = recentred(step, best.logs)
    if tries and any(aside):
        found = fit_press(elsewhere, mechanics, within, noise, tissue, tries - 1)
        if found.misfit < misfit:
            shape = found.course.shape or PressShape(RADII[0])
            row, column = np.add(shape.offset, aside).tolist()
            shape = dataclasses.replace(shape, offset=(row, column))
            return dataclasses.replace(found, course=dataclasses.replace(found.course, shape=shape))
    patch = dent_problem(contact, mechanics, within, noise, PatchMotion)
    shaped = sampled(patch, field_optima(patch, tissue), tissue)
    further = patch.motion.box(tissue).shape[1] - step.motion.box(tissue).shape[1]
    counted = step.first.counted
    explained = counted * (misfit**2 - shaped.misfit**2)
    return shaped if explained > further * math.log(counted) else sampled(step, plain, tissue)


def recentred(problem: JointLikelihood, logs: np.ndarray) -> tuple[Interaction, tuple[int, int]]:
    """Move a contact to where its fitted dent explains most of what is observed: an instrument hides where it presses.

    Returns:
        The contact there, and by how many rows and columns it was moved.
    """
    contact, sequence = problem.first.contact, problem.first.contact.observations["depth"]
    simulated = problem.first.change(problem.motion.at(logs)[0] + problem.offset, logs).reshape(sequence.change.shape)
    around = sequence.change if sequence.around is None else sequence.around
    # By so many rows and columns; by two where nothing more is kept around.
    most = max((around.shape[1] - simulated.shape[1]) // 2, 2)
    places = {tuple(pixel): vertex for vertex, pixel in enumerate(contact.mesh.pixels.tolist())}
    own, found = contact.mesh.pixels[contact.vertex], []
    for row, column in itertools.product(range(-most, most + 1), repeat=2):
        vertex = places.get((own[0] + row, own[1] + column))
        change = sequence.elsewhere(row, column).change
        inner = np.isfinite(change - simulated)
        dent, shown = simulated[inner], change[inner].astype(np.float64)
        if vertex is not None and len(dent):
            explained = max(float(dent @ shown), 0.0) ** 2 / max(float(dent @ dent), 1e-30)
            found.append((-explained, abs(row) + abs(column), row, column, vertex))
    *_, row, column, vertex = min(found)
    load = dataclasses.replace(contact.load, vertices=np.array([vertex]))
    return dataclasses.replace(contact.having(depth=sequence.elsewhere(row, column)), load=load), (row, column)


def field_starts(problem: JointLikelihood, box: np.ndarray) -> np.ndarray:
    """Return parameters with the smallest misfits among many, each with the force and the delay that suit it best, [S,
    D].

    Tissue is taken to stay in its pixels, which is true of most of a dent.
    """
    low, high = box
    motion, depth = problem.motion, problem.first
    candidates = evenly_spread(low, high)
    candidates[:, motion.centred] = 0
    delays = DELAYS if motion.within else np.zeros(1)
    observed = depth.observed
    still = depth.patches.covering(np.zeros((len(depth.times), len(depth.vertices), 3)))
    misfits = np.empty(len(candidates))
    for index, candidate in enumerate(candidates):
        path, ratio = motion.coarse_path(candidate)
        step = ratio * motion.mechanics.time_step
        sunk = np.concatenate([np.zeros((1, path.shape[1])), depth.patches.sunk(path.astype(np.float64))])
        since = motion.times - motion.within * delays[:, None]
        places = np.clip(np.rint(since / step), 0, len(path)).astype(np.int64)
        tried = depth.patches.shown(sunk[places.ravel()], np.tile(still, (len(delays), 1, 1)))
        tried = tried.reshape(len(delays), *observed.shape)
        forces, unexplained = suiting_forces(tried, observed, np.tile(candidate[2], len(tried)), low[2], high[2])
        best = int(np.argmin(unexplained))
        misfits[index], candidate[2], candidate[motion.delays] = unexplained[best], forces[best], delays[best]
    return apart(candidates, misfits, low, high, motion.starts)


def raced(problem: JointLikelihood, starts: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Refine starts [S, D] and keep the best, FITS at most, by successive halving.

    Every round (Jamieson & Talwalkar 2016) decides for every start anew what the pixels show, and leaves the better
    half.

    Args:
        problem: of coarse time steps.
        starts: as in `field_starts`; FITS of them or fewer stay as they are.
        box: of all parameters, shape [2, D].
    """
    while len(starts) > FITS:
        best = []
        for logs in starts:
            problem.look(logs)
            # Evaluations of a start in a round, after which it is decided anew what the pixels show.
            found = find_optimum(problem, logs, box, 4)
            # What comes out of sight must not seem explained.
            best.append((found.cost - 0.5 * problem.first.seen.sum(), found.logs))
        best.sort(key=lambda pair: pair[0])
        starts = np.array([logs for _, logs in best[: len(best) // 2]])
    return starts


def first_draws(optima: Sequence[Optimum], scale: float, prior: np.ndarray) -> Mixture:
    """Return the mixture of a posterior's first draws: half of them around its optima, half in its tails.

    Args:
        optima: at least one; D parameters.
        scale: σ² is so many times as large as the optima take it to be.
        prior: information of the admissible box, shape [D, D].
    """
    # Every optimum gets at least this share of the first draws, relative to the likeliest.
    shares = np.maximum(evidence_shares(optima, prior), 0.02)
    # The first draws are this much wider than the optima, in variance.
    # Half of the first draws are spread so many times as far as the optima say, as far as the box allows (a defensive
    # mixture, Hesterberg 1995). Only inertia tells the common scale of k_s, k_d and F, and the less the larger that is:
    # towards firm tissue the posterior has a long tail. Draws as narrow as an optimum miss it, and don't know that.
    widths = [1.2 * np.linalg.inv(o.information / (scale * wide**2) + prior) for wide in (1.0, 3.0) for o in optima]
    places = np.array([optimum.logs for optimum in optima])
    return Mixture(np.tile(0.5 * shares / shares.sum(), 2), np.tile(places, (2, 1)), np.array(widths))


def _sample_field(
    problem: JointLikelihood, optima: list[Optimum], best: Optimum, box: np.ndarray, scale: float
) -> Draws:
    """Return the posterior around the optima, σ² being `scale` times as large as the depth-change sequence says."""
    prior = box_information(box)
    motion, depth = problem.motion, problem.first
    error = motion.finer(best.logs) - motion.quick(best.logs)

    def log_likelihood(logs: np.ndarray) -> np.ndarray:
        left = [depth.whitened(depth.change(motion.quick(item) + error, item) - depth.observed) for item in logs]
        return np.array([-0.5 * float(each @ each) / scale for each in left])

    return sample_posterior(log_likelihood, box, first_draws(optima, scale, prior))
