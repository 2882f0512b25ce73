"""A depth-change sequence of a dent fitted by a slab of finite elements, from a grid of starts to verdict.

Tissue right under the tip is left out: how the tip presses there is known least. What the slab itself gets wrong counts
among the errors. The posterior, its valley followed, holds besides what a finer mesh changes
(`estimators.direct.slab_posterior`), and firm regions beneath; tissue that relaxes refutes the model
(`estimators.direct.slab_posterior`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import press_estimate
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_motion import FirmRegion, SlabMotion
from palpate.estimators.direct.slab_posterior import (
    DONE,
    ROUGH,
    Valley,
    averaged,
    descend,
    find_tip,
    firm_regions,
    follow_valley,
    moved_by_mesh,
    relaxation,
    slab_start,
    with_firm_regions,
)
from palpate.estimators.estimate import Estimate, NoEstimate
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.fem import NoBody
from palpate.physics.fem.slab import Slab, slab_beneath
from palpate.physics.mechanics import theta_of

BLIND = 4.5
"""Tissue nearer to the contact isn't compared [grid px]."""
UNLIKE = MODEL_ERRORS.slab_young**2 + np.diag(np.square([0.0, MODEL_ERRORS.slab_damping, MODEL_ERRORS.slab_force]))
"""Covariance of (log E, log d, log |F|) by what law and tip get wrong: of log E, and of log d/E and log F/E besides."""
UNLIKE_FIRM = MODEL_ERRORS.firm_young**2 + np.diag(np.square([0.0, MODEL_ERRORS.firm_damping, MODEL_ERRORS.firm_force]))
"""The same where a firm region lies beneath, which is not one of those that are tried."""
FINE, FINER = (10, 10, 3), (12, 12, 4)
"""Cells of the quadratic elements whose small motions are fitted, and of those by which their error is measured."""
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
        slab = slab_beneath(*under)
        fine, finer = (slab_beneath(*under, cells, order=2) for cells in (FINE, FINER))
    except NoBody as error:
        raise NoEstimate(f"No slab fits under the tissue: {error}") from error

    def problem_of(
        place: tuple[float, float], relaxing: bool = False, body: Slab = fine, region: FirmRegion | None = None
    ) -> SequenceProblem[SlabMotion]:
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
    known = {"theta": theta, "covariance": spread, "outliers": problem.outliers}
    refuted = relaxation(problem, logs, problem_of(place, relaxing=True), fits, scale)
    found = press_estimate(problem, box, logs, logs, problem.information(logs), refuted=refuted, **known)
    return found, (np.append(0.0, problem.motion.times), np.append(0.0, path))


def settled(problem: SequenceProblem[SlabMotion]) -> tuple[np.ndarray, Valley, float]:
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
    if contact.sequence is None:
        raise ValueError("the contact has no depth-change sequence; gather it with frames that have depth and labels.")
    side = contact.sequence.change.shape[1] // 2
    rows, columns = np.mgrid[-side : side + 1, -side : side + 1]
    change = np.where(np.hypot(rows, columns) < BLIND, np.nan, contact.sequence.change)
    return dataclasses.replace(contact, sequence=dataclasses.replace(contact.sequence, change=change))
