"""A depth-change sequence of a dent fitted by a slab of finite elements, from a grid of starts to verdict.

Tissue right under the tip is left out: how the tip presses there is known least. What the slab itself gets wrong counts
among the errors. The middle of the tip is a pixel or two from the contact's vertex, and is found first, from small
motions. Then a trust region goes down by exact derivatives of the motion. (On six drawn slabs, 0.3 to 0.8 off in every
logarithm at first, it took 36 simulations in all, where Gauss and Newton's matrix corrected by the observed gradients
took 47, and χ²/2 ended 0 to 69 lower.)

E, d and F rise together along a valley that is far from normal: the larger they are the less inertia tells them apart.
So χ² is followed along it, d and F (and the delays) fitted at every E, with small motions by the slab's modes, to which
the fit's own strains are added as they are at the best fit. Elements of finite size let tissue move too early, which
passes for another E: a finer mesh says by how much.

Tissue may be neither homogeneous nor damped in proportion to its mass. It may be firmer in some place beneath: some
places are compared to first order, the likeliest are fitted anew, and the posterior is the mean over these fits and
that of homogeneous tissue (Bayesian model averaging). And it may relax: where a standard linear solid explains the
sequence better than damping does, with a firm region or without, that model is refuted, however small its misfit.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import AT_BOUND, press_estimate
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.problem import find_optimum, suiting_forces
from palpate.estimators.direct.slab_motion import FirmRegion, SlabMotion
from palpate.estimators.estimate import Estimate, NoEstimate
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.fem import NoBody
from palpate.physics.fem.slab import CELLS, Place, Slab, slab_beneath
from palpate.physics.identifiability import box_information
from palpate.physics.mechanics import theta_of

BLIND = 4.5
"""Tissue nearer to the contact isn't compared [grid px]."""
UNLIKE = MODEL_ERRORS.slab_young**2 + np.diag(np.square([0.0, MODEL_ERRORS.slab_damping, MODEL_ERRORS.slab_force]))
"""Covariance of (log E, log d, log |F|) by what law and tip get wrong: of log E, and of log d/E and log F/E besides."""
UNLIKE_FIRM = MODEL_ERRORS.firm_young**2 + np.diag(np.square([0.0, MODEL_ERRORS.firm_damping, MODEL_ERRORS.firm_force]))
"""The same where a firm region lies beneath, which is not one of those that are tried."""
FINE, FINER = CELLS, (12, 12, 4)
"""Cells of the quadratic elements whose small motions are fitted, and of those by which their error is measured."""
SlabProblem = SequenceProblem[SlabMotion]
LOWER = 1.0
"""Fall of χ²/2 along the valley from which on a better fit is looked for there."""


def fit_slab(
    contact: Interaction, thickness: float, within: float = 0.0, noise: float | None = None
) -> tuple[Estimate, tuple[np.ndarray, np.ndarray]]:
    """Fit a depth-change sequence.

    Args:
        contact: with a depth-change sequence of three frames or more.
        thickness: of the tissue [scene units].
        within: as of `SlabMotion`.
        noise: σ of every pixel in every frame [scene units]; None = as the depth-change sequence says.

    Returns:
        the estimate, its θ being (E, d, F) as of `estimators.direct.slab_motion`; times since the onset [s] and the
        fitted motion of the contact along the force then [scene units], shape [N + 1] each.

    Raises:
        NoEstimate: no slab fits under the tissue, none can be followed, or nothing moves clearly.
    """
    try:
        under = contact.mesh, contact.vertex, contact.direction, thickness
        slab = slab_beneath(*under, CELLS)
        fine, finer = (slab_beneath(*under, cells, order=2) for cells in (FINE, FINER))
    except NoBody as error:
        raise NoEstimate(f"No slab fits under the tissue: {error}") from error

    def problem_of(
        place: Place, relaxing: bool = False, body: Slab = fine, region: FirmRegion | None = None
    ) -> SlabProblem:
        def motion(vertices: np.ndarray, times: np.ndarray) -> SlabMotion:
            pixels = contact.mesh.pixels[vertices]
            return SlabMotion(contact, slab, pixels, times, within, relaxing, body, place, region)

        return SequenceProblem(visible, motion, noise)

    visible = _without_tip(contact)
    place = find_tip(problem_of, slab.place)
    problem = problem_of(place)
    logs, valley, scale = settled(problem)
    box = problem.motion.box
    if not problem.misfit(logs) > 0:
        raise NoEstimate("No pixel of the dent moves clearly, so that nothing shows whether a slab explains it.")
    coarse = moved_by_mesh(problem, problem_of(place, body=finer).motion, logs)
    regions = firm_regions(problem, logs, thickness, scale)
    fits = with_firm_regions(problem, logs, regions, lambda region: problem_of(place, region=region), scale)
    firm, shift, unsure = averaged(fits)
    spread = valley.covariance + np.outer(coarse, coarse) + unsure + (1 - firm) * UNLIKE + firm * UNLIKE_FIRM
    at = int(np.flatnonzero(problem.patches.vertices == contact.vertex)[0])
    path = problem.motion.at(logs)[0][:, at] @ np.asarray(contact.direction, np.float64)
    theta = theta_of(np.clip(valley.mean + shift, *box[:, :3]))
    known = {"theta": theta, "covariance": spread, "outliers": problem.outliers, "slab": problem.motion}
    refuted = relaxation(problem, logs, problem_of(place, relaxing=True), fits, scale)
    found = press_estimate(problem, box, logs, logs, problem.information(logs), refuted=refuted, **known)
    return found, (np.append(0.0, problem.motion.times), np.append(0.0, path))


class Valley(NamedTuple):
    """The posterior of (log E, log d, log |F|) of a slab that is homogeneous."""

    mean: np.ndarray
    """Shape [3]."""
    covariance: np.ndarray
    """Shape [3, 3]."""
    best: np.ndarray
    """All parameters of the least χ² found, shape [D]."""
    fall: float
    """By so much χ²/2 is less there than where it began."""


def settled(problem: SlabProblem) -> tuple[np.ndarray, Valley, float]:
    """Parameters of the least χ², the valley around them, and the square of the misfit, by which χ² is scaled."""
    box, logs = problem.motion.box, slab_start(problem)
    for outliers, enough in ((False, ROUGH), (True, DONE)):
        problem.look(logs, outliers=outliers)
        logs = descend(problem, logs, box, enough)
    scale = max(1.0, problem.misfit(logs)) ** 2
    valley = follow_valley(problem, logs, box, scale)
    if valley.fall > LOWER:
        problem.look(valley.best, outliers=True)
        try:
            logs = descend(problem, valley.best, box, DONE)
            valley = follow_valley(problem, logs, box, scale)
        except NoEstimate:  # the valley was given by small motions; as it is, the slab can't be followed there
            problem.look(logs, outliers=True)
    return logs, valley, scale


def _without_tip(contact: Interaction) -> Interaction:
    """The contact with a depth-change sequence that doesn't show the tissue under the tip."""
    assert contact.sequence is not None
    side = contact.sequence.change.shape[1] // 2
    rows, columns = np.mgrid[-side : side + 1, -side : side + 1]
    change = np.where(np.hypot(rows, columns) < BLIND, np.nan, contact.sequence.change)
    return dataclasses.replace(contact, sequence=dataclasses.replace(contact.sequence, change=change))


DIFFERENCE = 0.02
"""Of a parameter, for derivatives."""
YOUNG, DAMPING = np.log(np.geomspace(20.0, 2000.0, 11)), np.log(np.geomspace(5e3, 8e5, 7))
"""log E and log d among whose pairs a start is looked for."""
NEARBY, ASTRAY = 0.5, 2.0
"""A step of the tip's middle, for derivatives; and its standard deviation around the contact's vertex, which is a pixel
or two off [grid px]."""
ROUGH, DONE = 3.0, 0.2
"""Fall of χ²/2 in a step, below which outliers are looked for, and the fit is done."""
EVALUATIONS = 10
"""With all that is visible, and again without outliers."""
LONGEST, GROWTH = 0.2, 1.3
"""Steps along the valley, of log E: the first, a standard deviation of the normal distribution around the fit, at most;
and the next over the one before."""
UNLIKELY = 8.0
"""Rise of χ²/2 at which the valley ends."""
MOST = 14
"""Steps one way."""
ROUNDS = 2
"""Gauss–Newton steps of the other parameters at every E."""
BETWEEN = 400
"""Values of log E by which the posterior is summed up."""


def slab_start(problem: SlabProblem) -> np.ndarray:
    """Of a grid of parameters those that explain the sequence best if nothing strains much, with the force that
    suits."""
    motion = problem.motion
    low, high = motion.box
    still = problem.patches.covering(np.zeros((len(motion.times), len(problem.patches.vertices), 3)))
    best, least = np.zeros(len(low)), math.inf
    for young, damping in itertools.product(YOUNG, DAMPING):
        logs = np.zeros(len(low))
        logs[:2] = young, damping
        tried = problem.patches.shown(problem.patches.sunk(motion.by_modes(logs)), still)[None]
        ends = low[2] + AT_BOUND, high[2] - AT_BOUND
        (logs[2],), (unexplained,) = suiting_forces(tried, problem.observed, logs[2:3], *ends)
        if unexplained < least:
            best, least = logs, unexplained
    return best


def find_tip(problem_of: Callable[[Place], SlabProblem], place: Place) -> Place:
    """Column and row of the tip's middle that explain a depth-change sequence better, from small motions [grid px].

    Args:
        problem_of: the depth-change sequence with the tip in some place.
        place: where it is taken to be.
    """
    problem, *nearby = (problem_of((place[0] + x, place[1] + y)) for x, y in ((0, 0), (NEARBY, 0), (0, NEARBY)))
    logs = slab_start(problem)
    problem.look(logs)

    def by_modes(motion: SlabMotion, tried: np.ndarray) -> np.ndarray:
        return problem.left(motion.by_modes(tried), tried)

    left = by_modes(problem.motion, logs)
    slopes = [(by_modes(problem.motion, logs + step) - left) / DIFFERENCE for step in DIFFERENCE * np.eye(len(logs))]
    slopes += [(by_modes(other.motion, logs) - left) / NEARBY for other in nearby]
    jacobian = np.stack(slopes, axis=1)
    prior = np.zeros((len(slopes), len(slopes)))
    prior[:-2, :-2] = box_information(problem.motion.box)
    prior[[-2, -1], [-2, -1]] = 1 / ASTRAY**2
    column, row = -np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ left)[-2:]
    return place[0] + float(column), place[1] + float(row)


def descend(problem: SlabProblem, start: np.ndarray, box: np.ndarray, enough: float) -> np.ndarray:
    """Parameters [D] of the least χ² near a start within a box [2, D].

    Args:
        enough: fall of χ²/2 in a step, below which none is made.

    Raises:
        NoEstimate: the motion at the start can't be followed.
    """

    if not np.isfinite(problem.motion.at(start)[0]).all():
        raise NoEstimate("The slab can't be followed where the fit begins; the dent may be too deep for it.")
    return find_optimum(problem, start, box, EVALUATIONS, enough).logs


def follow_valley(problem: SlabProblem, logs: np.ndarray, box: np.ndarray, scale: float) -> Valley:
    """Follow χ² along the common scale from a fit.

    Args:
        problem: that has looked at it.
        logs: all parameters of it, shape [D].
        box: ends of the parameters, shape [2, D].
        scale: of χ²: the square of the misfit.
    """
    motion, prior = problem.motion, box_information(box)
    strained = motion.at(logs)[0] - motion.by_modes(logs)

    def residual(tried: np.ndarray) -> np.ndarray:
        return problem.left(strained + motion.by_modes(tried), tried)

    def settled(tried: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """With all but E as they suit it, χ²/2, and the covariance of log d and log |F| there."""
        for _ in range(ROUNDS):
            left = residual(tried)
            steps = DIFFERENCE * np.eye(len(tried))[1:]
            slopes = np.stack([(residual(tried + step) - left) / DIFFERENCE for step in steps], axis=1)
            curvature = slopes.T @ slopes / scale + prior[1:, 1:]
            change = -np.linalg.solve(curvature, slopes.T @ left / scale)
            change *= min(1.0, 1.0 / max(np.abs(change).max(), 1e-12))
            tried = np.clip(np.append(tried[0], tried[1:] + change), *box)
        return tried, 0.5 * float(np.square(residual(tried)).sum()) / scale, np.linalg.inv(curvature)

    spread = np.linalg.inv(problem.information(logs) / scale + prior)
    first = min(math.sqrt(spread[0, 0]), LONGEST)
    points = [settled(logs)]
    for way in (1.0, -1.0):
        here, length, least = points[0][0], first, points[0][1]
        for _ in range(MOST):
            here = here + way * length * (np.arange(len(logs)) < 3)
            if not (box[0, 0] < here[0] < box[1, 0]):
                break
            point = settled(np.clip(here, *box))
            here, length, least = point[0], GROWTH * length, min(least, point[1])
            points.append(point)
            if point[1] > least + UNLIKELY:
                break
    points.sort(key=lambda item: item[0][0])
    young = np.array([item[0][0] for item in points])
    density = -np.array([item[1] - 0.5 * np.linalg.slogdet(item[2])[1] for item in points])
    fine = np.linspace(young[0], young[-1], BETWEEN)
    weights = np.exp(np.interp(fine, young, density) - density.max())
    weights /= weights.sum()
    path = np.stack([np.interp(fine, young, [item[0][index] for item in points]) for index in range(3)], axis=1)
    mean = weights @ path
    covariance = np.einsum("w,wi,wj->ij", weights, path - mean, path - mean)
    others = np.array([item[2][:2, :2] for item in points])
    nearest = np.abs(fine[:, None] - young).argmin(axis=1)
    covariance[1:, 1:] += np.einsum("w,wij->ij", weights, others[nearest])
    best = min(points, key=lambda item: item[1])
    value = 0.5 * float(np.square(residual(logs)).sum()) / scale
    return Valley(mean, covariance, best[0], scale * (value - best[1]))


def moved_by_mesh(problem: SlabProblem, finer: SlabMotion, logs: np.ndarray) -> np.ndarray:
    """By how much (log E, log d, log |F|) of a fit would be other by a finer mesh, to first order, shape [3]."""
    change = shown_change(problem, finer.by_modes(logs) - problem.motion.by_modes(logs))
    prior = box_information(problem.motion.box)
    jacobian = problem.jacobian(logs)
    return -np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ change)[:3]


def shown_change(problem: SlabProblem, moved: np.ndarray) -> np.ndarray:
    """What a small difference in the places' motion [N, V, 3] makes of the whitened residual."""
    return problem.whitened(np.nan_to_num(problem.patches.shown(problem.patches.sunk(moved), problem.covering)))


REGION = 9.0
"""Radius of a firm region [grid px]; its top lies an eighth of the thickness deep."""
ASIDE = 0.5, 1.0
"""Of its middle from the contact's normal, over its radius."""
WAYS = 8
"""Directions from the contact in which it may lie."""
USUAL, USUAL_SD = MODEL_ERRORS.firm_usual, MODEL_ERRORS.firm_usual_sd
"""Its E over that around, and the standard deviation of the logarithm over it, by which places are compared."""
REGIONS, FIRMER = 2, (1.8, 3.2)
"""Firm regions that are fitted, the likeliest ones, and by which factors they are firmer."""
RELAXING = np.log([1 / 1.8, 1.0, 1 / 1.6, 0.1])
"""Where the fit of a standard linear solid begins: log E and log |F| added to those of damping by mass, which takes the
fast modulus for the slow one; log γ; log τ."""
REFUTED = 10.0
"""Fall of χ²/2 over the square of the misfit, from which on the standard linear solid is believed."""


class Firm(NamedTuple):
    """A fit with a firm region, in addition to that of tissue that is homogeneous."""

    gain: float
    """Logarithm of how much likelier it makes the sequence: that it was picked from many, and fitted, is not paid
    for."""
    shift: np.ndarray
    """Of (log E, log d, log |F|) away from that fit, shape [3]."""


Regional = tuple[FirmRegion, np.ndarray]
"""A region, and the parameters where a fit with it begins [D]."""


def firm_regions(problem: SlabProblem, logs: np.ndarray, thickness: float, scale: float) -> list[Regional]:
    """Regions beneath that may be firm, likeliest first to first order, and where the fit of each may begin [D].

    Args:
        problem: that has looked at a fit.
        logs: all parameters of it, shape [D].
        thickness: of the slab [scene units].
        scale: as of `follow_valley`.
    """
    motion, contact = problem.motion, problem.contact
    residual, jacobian = problem.linearise(logs)
    matrix = jacobian.T @ jacobian + box_information(motion.box)

    def suiting(values: np.ndarray) -> np.ndarray:
        return -np.linalg.solve(matrix, jacobian.T @ values)

    homogeneous, left = motion.linear(logs), residual + jacobian @ suiting(residual)
    normal = np.asarray(contact.direction, np.float64)
    focal = float(motion.slab.focal_lengths.mean())
    radius = REGION * float(contact.mesh.vertices[contact.vertex, 2]) / focal
    below = contact.mesh.vertices[contact.vertex] - min(radius + thickness / 8, thickness) * normal
    found = []
    for aside in ASIDE:
        for angle in 2 * np.pi * np.arange(WAYS) / WAYS:
            centre = below + aside * radius * np.array([math.cos(angle), math.sin(angle), 0.0])
            region = FirmRegion(centre, radius, math.log(USUAL))
            change = shown_change(problem, motion.linear(logs, region) - homogeneous)
            freed = change + jacobian @ suiting(change)
            # Its firmness has a normal prior around 1, in units of the usual one.
            known = float(freed @ freed) / scale + 1 / USUAL_SD**2
            firm = (1 / USUAL_SD**2 - float(left @ freed) / scale) / known
            less = float(np.square(left).sum() - np.square(left + firm * freed).sum()) / scale
            gain = less - ((firm - 1) / USUAL_SD) ** 2 - math.log(known)
            found.append((gain, region, np.clip(logs + suiting(residual + firm * change), *motion.box)))
    return [item[1:] for item in sorted(found, key=lambda item: -item[0])]


def with_firm_regions(
    plain: SlabProblem,
    logs: np.ndarray,
    regions: list[Regional],
    problem_of: Callable[[FirmRegion], SlabProblem],
    scale: float,
) -> list[Firm]:
    """Fits of the likeliest firm regions, firmer by each of FIRMER; those that can't be followed are left out.

    Args:
        plain: of tissue that is homogeneous, fitted, at parameters `logs`.
        regions: likeliest first, with where their fits begin.
        problem_of: the depth-change sequence with a region.
        scale: as of `follow_valley`.
    """
    found = []
    for region, start in regions[:REGIONS]:
        for times in FIRMER:
            other = problem_of(dataclasses.replace(region, firmer=math.log(times)))
            other.look(start, outliers=True)
            try:
                start = descend(other, start, other.motion.box, DONE)
            except NoEstimate:
                continue
            found.append(Firm(fall(plain, logs, other, start) / scale, start[:3] - logs[:3]))
    return found


def averaged(fits: list[Firm]) -> tuple[float, np.ndarray, np.ndarray]:
    """Over tissue that is homogeneous and that with a firm region, equally likely beforehand.

    Returns:
        the probability that there is one; the mean shift of (log E, log d, log |F|), shape [3]; what it adds to their
        covariance, shape [3, 3].
    """
    gains = np.array([fit.gain for fit in fits] + [math.log(len(fits))] if fits else [0.0])
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    shifts = np.stack([*(fit.shift for fit in fits), np.zeros(3)])
    mean = weights @ shifts
    return float(weights[:-1].sum()), mean, np.einsum("w,wi,wj->ij", weights, shifts - mean, shifts - mean)


def relaxation(plain: SlabProblem, logs: np.ndarray, other: SlabProblem, fits: list[Firm], scale: float) -> str:
    """A sentence where a standard linear solid explains a sequence better than the best fit of a slab damped by mass.

    Args:
        plain: fitted, at parameters `logs`.
        other: of a standard linear solid.
        fits: with firm regions, than which it has to explain more by REFUTED.
        scale: as of `follow_valley`.
    """
    box = other.motion.box
    start = np.concatenate([RELAXING, logs[3:]])
    start[[0, 2]] += logs[[0, 2]]
    start = np.clip(start, *box)
    other.look(start)
    try:
        found = descend(other, start, box, ROUGH)
    except NoEstimate:
        return ""
    if not fall(plain, logs, other, found) / scale > REFUTED + max([0.0, *(fit.gain for fit in fits)]):
        return ""
    ratio, time = np.exp(found[[1, 3]])
    return (
        f"The motion relaxes: a standard linear solid (γ {ratio:.2g}, τ {time:.2g} s) explains it better than damping "
        "proportional to mass does, so stiffness and damping are not the tissue's."
    )


def fall(plain: SlabProblem, logs: np.ndarray, other: SlabProblem, others: np.ndarray) -> float:
    """Of χ²/2, as a fit weights it, from that fit to another, by the pixels that show tissue in both."""
    after = other.change(other.motion.at(others)[0], others)
    before = plain.change(plain.motion.at(logs)[0], logs)
    worse, better = (
        plain.whitened(np.where(np.isfinite(after), change - plain.observed, 0.0)) for change in (before, after)
    )
    return 0.5 * float(worse @ worse - better @ better)
