"""A film of a dent fitted by a slab of finite elements, from a grid of starts to verdict.

Tissue right under the tip is left out: how the tip presses there is known least. The middle of the tip is a pixel or
two from the contact's vertex, and is found first, from small motions. Exact derivatives of the motion give gradient and
Gauss–Newton matrix; the latter is corrected from step to step by the gradients seen (BFGS with Powell's damping;
Nocedal & Wright 2006, procedure 18.2), because it takes the valley along which E, d and F rise together for steeper
than it is. What the slab itself gets wrong counts among the errors. The posterior, its valley followed, holds besides
what a finer mesh changes, and firm regions beneath (`estimators.direct.slab_posterior`).

A standard linear solid is fitted, too. Where it explains the film better than damping proportional to mass does, with a
firm region or without, that model is refuted, however small its misfit.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np

from data.contact.interaction import Interaction
from estimators.direct.contact_fit import AT_BOUND, DELAY_AT_END, LARGEST_MISFIT
from estimators.direct.field import FilmProblem
from estimators.direct.motion import about_tissue
from estimators.direct.slab_motion import FirmRegion, SlabMotion
from estimators.direct.slab_posterior import DIFFERENCE, Firm, averaged, firm_regions, follow_valley, moved_by_mesh
from estimators.estimate import Estimate, NoEstimate
from estimators.oblique import effective_misfit, is_oblique, view_angle
from physics.fem import NoBody
from physics.fem.slab import Slab, slab_beneath
from physics.identifiability import box_information
from physics.mechanics import theta_of

BLIND = 4.5
"""Tissue nearer to the contact isn't compared [grid px]."""
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
RELAXING = np.log([1 / 1.8, 1.0, 1 / 1.6, 0.1])
"""Where the fit of a standard linear solid begins: log E and log |F| added to those of damping by mass, which takes the
fast modulus for the slow one; log γ; log τ."""
REFUTED = 10.0
"""Fall of χ²/2 over the square of the misfit, from which on the standard linear solid is believed."""
MODEL_ERROR = 0.15
"""Standard deviation of the slab's own error over its motion: mesh, law and tip are not the tissue's. It is the same
within a ring around the contact and a part of the time, and independent elsewhere."""
RINGS = 6.0, 8.0
"""Between rings [grid px]."""
EARLY = 2.5
"""Frames after the press begins, and after it ends, that are parts of their own."""
UNLIKE = np.square(0.1) + np.diag(np.square([0.0, 0.05, 0.1]))
"""Covariance of (log E, log d, log |F|) by what law and tip get wrong: 0.1 of log E, 0.05 of log d/E, 0.1 of log F/E.
On eight drawn presses on tissue that is alike throughout the ratios were off by as much (root mean squares)."""
UNLIKE_FIRM = np.square(0.3) + np.diag(np.square([0.0, 0.15, 0.3]))
"""The same where a firm region lies beneath, which is not one of those that are tried: 0.3, 0.15 and 0.3."""
FINE, FINER = (10, 10, 3), (12, 12, 4)
"""Cells of the quadratic elements whose small motions are fitted, and of those by which their error is measured."""
REGIONS, FIRMER = 2, (1.8, 3.2)
"""Firm regions that are fitted, the likeliest ones, and by which factors they are firmer."""
LOWER = 1.0
"""Fall of χ²/2 along the valley from which on a better fit is looked for there."""


class SlabProblem(FilmProblem[SlabMotion]):
    """A film against a slab, which is known to be off by MODEL_ERROR."""

    def model_errors(self, sunk: np.ndarray) -> np.ndarray:
        """As of `FilmProblem`: a column a ring and part of the time."""
        side = self.film.change.shape[1] // 2
        apart = np.hypot(*np.mgrid[-side : side + 1, -side : side + 1]).ravel()
        times, load = self.film.times, self.contact.load_seconds if self.contact.released else math.inf
        early = EARLY * float(np.diff(times, prepend=0.0).min())
        part = np.searchsorted([early, load, load + early], times) if load > early else np.searchsorted([early], times)
        ring = np.searchsorted(RINGS, apart)
        cells = ring[:, None] * (1 + part.max()) + part
        return MODEL_ERROR * sunk.T[..., None] * (cells[..., None] == np.unique(cells))


def fit_slab(
    contact: Interaction, thickness: float, within: float = 0.0, noise: float | None = None
) -> tuple[Estimate, tuple[np.ndarray, np.ndarray]]:
    """Fit a film.

    Args:
        contact: with a film of three frames or more.
        thickness: of the tissue [scene units].
        within: as of `SlabMotion`.
        noise: σ of every pixel in every frame [scene units]; None = as the film says.

    Returns:
        the estimate, its θ being (E, d, F) as of `estimators.direct.slab_motion`; times since the onset [s] and the
        fitted motion of the contact along the force then [scene units], shape [N + 1] each.

    Raises:
        NoEstimate: no slab fits under the tissue, none can be followed, or nothing moves clearly.
    """
    try:
        under = contact.mesh, contact.vertex, contact.direction, thickness
        slab = slab_beneath(*under)
        fine, finer = (slab_beneath(*under, cells, order=2) for cells in (FINE, FINER))
    except NoBody as error:
        raise NoEstimate(f"No slab fits under the tissue: {error}") from error

    def problem_of(
        place: tuple[float, float], relaxing: bool = False, body: Slab = fine, region: FirmRegion | None = None
    ) -> SlabProblem:
        def motion(vertices: np.ndarray, times: np.ndarray) -> SlabMotion:
            pixels = contact.mesh.pixels[vertices]
            return SlabMotion(contact, slab, pixels, times, within, relaxing, body, place, region)

        return SlabProblem(beside, motion, noise)

    beside = _beside_tip(contact)
    place = find_tip(problem_of, slab.place)
    problem = problem_of(place)
    box = problem.motion.box
    logs = slab_start(problem)
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
        except NoEstimate:  # the valley was told by small motions; as it is, the slab can't be followed there
            problem.look(logs, outliers=True)
    misfit = problem.misfit(logs)
    if not misfit > 0:
        raise NoEstimate("No pixel of the dent moves clearly, so that nothing shows whether a slab explains it.")
    coarse = moved_by_mesh(problem, problem_of(place, body=finer).motion, logs)
    fits = with_firm_regions(
        problem, logs, firm_regions(problem, logs, thickness, scale), lambda region: problem_of(place, region=region)
    )
    firm, shift, unsure = averaged([Firm(fall / scale, shift) for fall, shift in fits])
    spread = valley.covariance + np.outer(coarse, coarse) + unsure + (1 - firm) * UNLIKE + firm * UNLIKE_FIRM
    at = int(np.flatnonzero(problem.patches.vertices == contact.vertex)[0])
    path = problem.motion.at(logs)[0][:, at] @ np.asarray(contact.direction, np.float64)
    firmest = max(0.0, *(fall for fall, _ in fits))
    rival = _relaxation(problem, logs, problem_of(place, relaxing=True), scale * REFUTED + firmest)
    information = problem.information(logs)
    found = Estimate(
        theta=theta_of(np.clip(valley.mean + shift, *box[:, :3])),
        covariance=spread,
        information=information[:3, :3],
        noise=problem.film.noise.total,
        misfit=misfit,
        largest_misfit=LARGEST_MISFIT,
        at_bound=np.minimum(logs - box[0], box[1] - logs)[:3] < AT_BOUND,
        delays=tuple((within * logs[3:]).tolist()),
        delays_at_end=bool((np.abs(logs[3:]) > DELAY_AT_END).any()),
        view_angle=view_angle(contact),
        outliers=problem.outliers,
        refuted=rival,
    )
    if is_oblique(found):
        prior = box_information(box)
        hidden = about_tissue(information / effective_misfit(found) ** 2, prior)
        found = found.widened(np.linalg.inv(hidden + prior[:3, :3]))
    return found, (np.append(0.0, problem.motion.times), np.append(0.0, path))


def with_firm_regions(
    plain: SlabProblem,
    logs: np.ndarray,
    regions: list[tuple[FirmRegion, np.ndarray]],
    problem_of: Callable[[FirmRegion], SlabProblem],
) -> list[tuple[float, np.ndarray]]:
    """What slabs with a firm region explain of a film better than the best fit of one that is alike throughout.

    Args:
        plain: of the latter, fitted, at parameters `logs`.
        regions: likeliest first, with where their fits begin.
        problem_of: the film with a region.

    Returns:
        of every fit the fall of χ²/2 and the shift of (log E, log d, log |F|), shape [3].
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
            found.append((_fall(plain, logs, other, start), start[:3] - logs[:3]))
    return found


def _fall(plain: SlabProblem, logs: np.ndarray, other: SlabProblem, others: np.ndarray) -> float:
    """Of χ²/2, as a fit weights it, from that fit to another."""
    moved = other.motion.at(others)[0]
    left = plain.whitened(other.change(moved, others) - plain.observed)
    return 0.5 * float(np.square(plain.residual(logs)).sum() - left @ left)


def _relaxation(plain: SlabProblem, logs: np.ndarray, other: SlabProblem, better: float) -> str:
    """A sentence where a standard linear solid explains a film better than the best fit of a slab damped by mass.

    Args:
        plain: fitted, at parameters `logs`.
        other: of a standard linear solid.
        better: by so much of χ²/2.
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
    if not _fall(plain, logs, other, found) > better:
        return ""
    ratio, time = np.exp(found[[1, 3]])
    return (
        f"The motion relaxes: a standard linear solid (γ {ratio:.2g}, τ {time:.2g} s) explains it better than damping "
        "proportional to mass does, so stiffness and damping are not the tissue's."
    )


def _beside_tip(contact: Interaction) -> Interaction:
    """The contact with a film that doesn't show the tissue under the tip."""
    if contact.film is None:
        raise ValueError("the contact has no film; gather it with frames that have depth and labels.")
    side = contact.film.change.shape[1] // 2
    rows, columns = np.mgrid[-side : side + 1, -side : side + 1]
    change = np.where(np.hypot(rows, columns) < BLIND, np.nan, contact.film.change)
    return dataclasses.replace(contact, film=dataclasses.replace(contact.film, change=change))


def slab_start(problem: SlabProblem) -> np.ndarray:
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
    problem_of: Callable[[tuple[float, float]], SlabProblem], place: tuple[float, float]
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


def descend(problem: SlabProblem, start: np.ndarray, box: np.ndarray, enough: float) -> np.ndarray:
    """Parameters [D] of the least χ² near a start within a box [2, D].

    Args:
        enough: fall of χ²/2 to be expected of a step, below which none is made.

    Raises:
        NoEstimate: the motion at the start can't be followed.
    """

    def at(logs: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        residual, jacobian = problem.linearise(logs)
        return 0.5 * float(residual @ residual), jacobian.T @ residual, jacobian.T @ jacobian

    logs = start
    value, gradient, curvature = at(logs)
    if not math.isfinite(value):
        raise NoEstimate("The slab can't be followed where the fit begins; the dent may be too deep for it.")
    curvature = curvature + box_information(box)
    for _ in range(MOST_STEPS):
        step = -np.linalg.solve(curvature, gradient)
        step = np.clip(logs + step * min(1.0, LARGEST_STEP / np.abs(step).max()), *box) - logs
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
