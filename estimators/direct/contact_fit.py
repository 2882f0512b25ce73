"""A contact's followed point fitted from start to verdict: optima, posterior around them, estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.estimators.direct.error_model import log_likelihoods, variance_scale
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.motion import PressMotion, about_tissue
from palpate.estimators.direct.problem import (
    ContactProblem,
    Optimum,
    combine,
    count_modes,
    distinct,
    evidence_shares,
    find_optimum,
)
from palpate.estimators.direct.sampling import Draws, Mixture, sample_posterior
from palpate.estimators.estimate import Estimate
from palpate.estimators.oblique import effective_misfit, is_oblique, view_angle
from palpate.physics.identifiability import bounds, box_information

LARGEST_MISFIT = 1.5
"""The model does not explain what lies farther from its best fit than this many σ."""
AT_BOUND = 1e-3
"""Best fits this near to the end of their range in φ lie at it."""
DELAY_AT_END = 0.9
"""Delays beyond this share of their range lie at its end: the press may have begun outside of it."""
LEAST_SHARE = 0.02
"""Every optimum gets at least this share of the first draws, relative to the likeliest."""
WIDER = 1.2
"""The first draws are this much wider than the optima, in variance."""
TOO_FEW = 10.0
"""Fewer effective draws say less than the optima themselves."""
JUDGES = 15
"""Draws whose information is compared."""
TRUST = 2 / 3
"""Share of the posterior that must agree that a contact determines its parameters. Half would trust the prior, which
holds more pliable tissue than there is; two thirds and more gave the most right verdicts on validation clips."""


def fit_contact(problem: ContactProblem, box: np.ndarray) -> Estimate:
    """Fit a problem's parameters, those of θ first, within their box, shape [2, D]."""
    low, high = box
    prior = box_information(box)
    candidates = problem.candidates(low, high)
    paths = problem.coarse_paths(candidates)
    starts = problem.best_starts(candidates, paths, low, high)
    optima = distinct([find_optimum(problem, start, low, high) for start in starts])
    draws = _sample(problem, optima, box, (candidates, paths))
    if draws.effective < TOO_FEW:
        # Most likely all starts have missed the best optimum, and some draw came near it.
        optima = distinct([*optima, find_optimum(problem, draws.likeliest, low, high)])
        draws = _sample(problem, optima, box, (candidates, paths))
    mean, spread, best = combine(optima, prior)
    return concluded(problem, box, optima, best, (mean, spread), draws if draws.effective >= TOO_FEW else None)


def concluded(
    problem: ContactProblem | SequenceProblem[PressMotion],
    box: np.ndarray,
    optima: Sequence[Optimum],
    best: Optimum,
    posterior: tuple[np.ndarray, np.ndarray],
    draws: Draws | None,
    **more: Any,
) -> Estimate:
    """What a fit of a press comes to.

    Args:
        problem: that was fitted.
        box: lower and upper ends of all parameters, shape [2, D].
        optima: all that were found, and the best of them.
        posterior: mean [D] and covariance [D, D] of all parameters by these.
        draws: of the posterior, which say them better; None = there are too few.
        more: further fields of the estimate.
    """
    motion, prior, (mean, spread), judges = problem.motion, box_information(box), posterior, posterior[0][None]
    if draws is not None:
        mean, spread, judges = draws.mean, draws.covariance, draws.thinned(JUDGES)
    information = problem.information(mean)
    known = {"theta": motion.theta(mean), "covariance": spread[:3, :3], "shape": motion.shape(mean)}
    trusted = trusted_information([about_tissue(problem.information(logs), prior) for logs in judges])
    more |= {"expected_information": trusted, "modes": count_modes(optima, prior)}
    return press_estimate(problem, box, best.logs, mean, information, **known, **more)


def press_estimate(
    problem: ContactProblem | SequenceProblem,
    box: np.ndarray,
    best: np.ndarray,
    mean: np.ndarray,
    information: np.ndarray,
    **known: Any,
) -> Estimate:
    """The estimate of a press, with the covariance of a large noise added where the contact may hide its own bottom.

    Args:
        problem: that was fitted.
        box: lower and upper ends of all parameters, those of the tissue first, shape [2, D].
        best: parameters that explain it best, shape [D].
        mean: parameters by which the delays are said, shape [D].
        information: of all parameters, shape [D, D].
        known: further fields of the estimate.
    """
    motion, prior = problem.motion, box_information(box)
    found = Estimate(
        information=information[:3, :3],
        noise=problem.sigma,
        misfit=problem.misfit(best),
        largest_misfit=LARGEST_MISFIT,
        at_bound=np.minimum(best - box[0], box[1] - best)[:3] < AT_BOUND,
        delays=tuple((motion.within * mean[motion.delays]).tolist()),
        delays_at_end=bool((np.abs(mean[motion.delays]) > DELAY_AT_END).any()),
        view_angle=view_angle(problem.contact),
        **known,
    )
    if not is_oblique(found):
        return found
    hidden = about_tissue(information / effective_misfit(found) ** 2, prior)
    return found.widened(np.linalg.inv(hidden + prior[:3, :3]))


def _sample(
    problem: ContactProblem, optima: Sequence[Optimum], box: np.ndarray, known: tuple[np.ndarray, np.ndarray]
) -> Draws:
    """The posterior around its optima; known points [C, D] with their motions [C, N, 3] are draws as well."""
    # The coarse step's error hardly varies over the posterior.
    best = optima[0].logs
    coarse_error = problem.coarse_paths(best[None])[0] - problem.path(best)
    direction, sigma, prior = problem.direction, problem.sigma, box_information(box)
    observed = (problem.moved + coarse_error) @ direction / sigma

    def likelihoods(paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return log_likelihoods(observed, paths @ direction / sigma)

    shares = np.maximum(evidence_shares(optima, prior), LEAST_SHARE)
    # Less information where an optimum explains the motion badly.
    trusted = [each.information / max(variance_scale(2 * each.cost, len(observed)), 1.0) for each in optima]
    start = Mixture(
        shares / shares.sum(),
        np.array([optimum.logs for optimum in optima]),
        np.array([WIDER * np.linalg.inv(each + prior) for each in trusted]),
    )
    candidates, paths = known
    return sample_posterior(
        lambda logs: likelihoods(problem.coarse_paths(logs)), box, start, (candidates, likelihoods(paths))
    )


def trusted_information(information: Sequence[np.ndarray]) -> np.ndarray:
    """Of several draws' information, each [3, 3], one than which a share TRUST of them is at least as telling.

    How much a motion tells depends on θ itself. A verdict at the mean alone would be as uncertain as that.
    """
    order = sorted(information, key=lambda found: float(bounds(found).max()))
    return order[math.ceil(TRUST * len(order)) - 1]
