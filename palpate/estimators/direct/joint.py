"""One press fitted to several observations together: the sum of their whitened residuals."""

from functools import partial

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import fit_press, press_fields
from palpate.estimators.direct.motion import Kind, PressMotion, about_tissue
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.direct.problem import chosen_starts, combine, distinct, find_optimum
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.observations.base import JointLikelihood
from palpate.observations.kinds import OBSERVATIONS
from palpate.physics.identifiability import box_information
from palpate.physics.mechanics import Mechanics


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
        mechanics, within, noise, tissue: as in `fit_press`.

    Raises:
        NoEstimate: nothing was recorded of one of them.
    """
    for name in names:
        if name not in contact.observations or not len(contact.observations[name].times):
            raise NoEstimate(f"No frame after the onset shows {name} of the tissue around the contact.")
    # All observations are of the contact where it was found, so depth alone may not move it either.
    depth = fit_press(contact, mechanics, within, noise, tissue, tries=0) if "depth" in names else None
    kind: Kind = PatchMotion if depth is not None and depth.course.shape is not None else PressMotion
    observations = [OBSERVATIONS[name](contact, *[noise] * (name == "depth")) for name in names]
    problem = JointLikelihood(observations, partial(kind, contact, mechanics, within=within))
    box, found = problem.box(tissue), []
    for logs in chosen_starts(problem, box) if depth is None else [_of_depth(problem, depth)]:
        for _ in range(2):  # after each residuals are weighted anew
            begin = np.clip(logs, box[0] + 1e-9, box[1] - 1e-9)
            problem.look(begin, outliers=depth is not None)
            optimum = find_optimum(problem, begin, box)
            logs = optimum.logs
        found.append(optimum)
    prior = box_information(box)
    mean, covariance, best = combine(distinct(found), prior)
    problem.look(best.logs)
    misfit = problem.misfit(best.logs)
    return PressResult(
        **press_fields(problem, mean, best, box, best.logs),
        covariance=max(1.0, misfit) ** 2 * covariance[:3, :3],
        information=about_tissue(best.information, prior),
        noise=contact.noise,
        misfit=misfit,
        largest_misfit=1.5,
    )


def _of_depth(problem: JointLikelihood, found: PressResult) -> np.ndarray:
    """Return all parameters from an estimate by depth, those of the other observations as in their priors."""
    motion = problem.motion
    delays = np.array(found.course.delays)[: motion.delays.stop - motion.delays.start]
    press = np.concatenate([np.log(np.abs(found.theta)), delays / (motion.within or 1.0)])
    if found.course.shape is not None:
        press = motion.parameters(press, found.course.shape)
    return problem.started(press)
