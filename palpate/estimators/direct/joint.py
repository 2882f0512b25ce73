"""One press fitted to several observations together: the sum of their whitened residuals."""

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import AT_BOUND, DELAY_AT_END, fit_press
from palpate.estimators.direct.motion import Kind, PressMotion, about_tissue
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.direct.problem import apart, combine, distinct, evenly_spread, find_optimum
from palpate.estimators.estimate import NoEstimate, PressCourse, PressResult
from palpate.estimators.oblique import view_angle
from palpate.observations.base import JointLikelihood
from palpate.observations.kinds import OBSERVATIONS
from palpate.physics.identifiability import box_information
from palpate.physics.mechanics import Mechanics

STARTS, LOOKS = 3, 2
"""Fits where no depth gives a start, and rounds of each, before which residuals are weighted anew."""


def fit_together(
    contact: Interaction,
    names: tuple[str, ...],
    mechanics: Mechanics,
    within: float,
    noise: float | None,
    tissue: np.ndarray,
) -> PressResult:
    """Fit a press to observations of some names; with depth among them from what depth alone explains best.

    Args:
        contact: with records of these names.
        names: of `observations.kinds`.
        mechanics, within, noise, tissue: as of `fit_press`.

    Raises:
        NoEstimate: nothing was recorded of one of them.
    """
    for name in names:
        if name not in contact.observations or not len(contact.observations[name].times):
            raise NoEstimate(f"No frame after the onset shows {name} of the tissue around the contact.")
    kind: Kind = PressMotion
    depth = fit_press(contact, mechanics, within, noise, tissue) if "depth" in names else None
    if depth is not None and depth.course.shape is not None:
        kind = PatchMotion
    observations = [OBSERVATIONS[name](contact, *[noise] * (name == "depth")) for name in names]
    problem = JointLikelihood(observations, lambda vertices, times: kind(contact, mechanics, vertices, times, within))
    box, found = problem.box(tissue), []
    starts = _starts(problem, box) if depth is None else _of_depth(problem, depth)[None]
    for logs in starts:
        for _ in range(LOOKS):
            problem.look(np.clip(logs, box[0] + 1e-9, box[1] - 1e-9), outliers=depth is not None)
            optimum = find_optimum(problem, np.clip(logs, box[0] + 1e-9, box[1] - 1e-9), box)
            logs = optimum.logs
        found.append(optimum)
    prior, motion = box_information(box), problem.motion
    mean, covariance, best = combine(distinct(found), prior)
    misfit, delays = problem.misfit(best.logs), best.logs[motion.delays]
    return PressResult(
        theta=motion.theta(mean),
        covariance=max(1.0, misfit) ** 2 * covariance[:3, :3],
        information=about_tissue(best.information, prior),
        noise=contact.noise,
        misfit=misfit,
        largest_misfit=1.5,
        at_bound=np.minimum(best.logs - box[0], box[1] - best.logs)[:3] < AT_BOUND,
        course=PressCourse(
            *(within * delays).tolist(),
            at_end=bool((np.abs(delays) > DELAY_AT_END).any()),
            shape=motion.shape(problem.press(mean)),
            view_angle=view_angle(contact),
        ),
    )


def _of_depth(problem: JointLikelihood, found: PressResult) -> np.ndarray:
    """All parameters from an estimate by depth, those of the other observations as in their priors."""
    motion = problem.motion
    delays = np.array(found.course.delays)[: motion.delays.stop - motion.delays.start]
    press = np.concatenate([np.log(np.abs(found.theta)), delays / (motion.within or 1.0)])
    if found.course.shape is not None:
        press = motion.parameters(press, found.course.shape)
    return problem.started(press)


def _starts(problem: JointLikelihood, box: np.ndarray) -> np.ndarray:
    """Parameters with the smallest sums of squares among points of a Sobol sequence, delays in the middle, [S, D]."""
    coarse = problem.copy(problem.motion.coarser())
    candidates = evenly_spread(*(problem.press(end) for end in box), 64)
    candidates[:, problem.motion.centred] = 0
    tried, misfits = [problem.started(candidate) for candidate in candidates], []
    for logs in tried:
        coarse.look(logs)
        misfits.append(float(np.square(coarse.residual(logs)).sum()))
    return apart(np.array(tried), np.array(misfits), *box, STARTS)
