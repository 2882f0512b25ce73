"""The direct estimator: θ of one contact from its motion through the simulator, without a trained network.

The strongest classical rival of a network (docs/identifiability.md). Levenberg–Marquardt with a trust region
(`estimators.contact_optima`) finds what explains the motion best, in φ = (log k_s, log k_d, log |F|) and, where the
instants are not known, in the delays of the press (`estimators.delayed_problem`). Around these optima the posterior is
sampled (`estimators.posterior_sampling`), with a uniform prior on the box of these and with noise as tracked contacts
have it (`estimators.tracking_noise`): mean and covariance of φ are the estimate.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data.clip_cache import PreparedClip
from data.collected import CollectedClip
from data.samples import ContactCase, Horizon, SampleSettings, contact_cases
from estimators.contact_optima import Optimum, combine, distinct, evidence_shares, find_optimum
from estimators.contact_problem import ContactProblem
from estimators.delayed_problem import DelayedProblem, about_tissue
from estimators.estimate import ContactEstimate, NoEstimate
from estimators.oblique import effective_misfit, is_oblique, view_angle
from estimators.onset import STAMP, onset_error
from estimators.posterior_sampling import Draws, Mixture, sample_posterior
from estimators.tracking_noise import log_likelihoods, variance_scale
from physics.identifiability import bounds, box_information
from physics.mechanics import Mechanics

LEAST_SIGMA = 3e-5
"""A smaller σ is refused [scene units]: that is the fitted simulator's own error (docs/identifiability.md), which would
be taken for motion of the tissue."""
LEAST_OBSERVATIONS = 3
"""Frames after the onset in which the tissue was followed."""
DOUBTFUL_MISFIT = 1.5
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


@dataclass(frozen=True)
class DirectSettings:
    """The model that is fitted."""

    mechanics: Mechanics = dataclasses.field(
        default_factory=lambda: Mechanics(time_step=0.0025, steps=400, scheme="dkd", window_error=1e-6)
    )
    """Integrator; its own error must lie below the noise: of second order, with half the paper's step."""
    stiffness: tuple[float, float] = (0.05, 1.0)
    """Range of k_s [normalised]."""
    damping: tuple[float, float] = (0.005, 0.5)
    """Range of k_d [normalised]."""
    force: tuple[float, float] = (0.01, 0.3)
    """Range of |F| [normalised]."""
    noise: float | None = None
    """σ of every observed coordinate [scene units], at least LEAST_SIGMA; None = the clip's own depth noise."""

    onset_within: float = 0.0
    """How far from the time stamp of the first frame in contact the press may have begun [s]."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "force"):
            low, high = getattr(self, name)
            if not 0 < low < high < math.inf:
                raise ValueError(f"{name} is [{low}, {high}]; give two positive numbers, the lower one first.")
        if self.noise is not None and not LEAST_SIGMA <= self.noise < math.inf:
            raise ValueError(f"noise is {self.noise}; give a length of {LEAST_SIGMA:g} or more, or leave it out.")

    def matched(self, fps: float, onset: str) -> DirectSettings:
        """The same for clips of so many frames a second, whose presses begin as one of `estimators.onset.ONSETS`."""
        return dataclasses.replace(
            self, mechanics=self.mechanics.matched(1 / fps), onset_within=onset_error(onset, fps)
        )

    @property
    def box(self) -> np.ndarray:
        """Lower and upper φ, shape [2, 3]."""
        return np.log(np.array([self.stiffness, self.damping, self.force]).T)


def fit_contact(case: ContactCase, settings: DirectSettings) -> ContactEstimate:
    """Fit θ to one contact.

    Args:
        case: the contact; its steps must have been made with the settings' time step.
        settings: the model that is fitted.

    Returns:
        The estimate. Where the beginning of the press isn't known its delay is fitted as well
        (`estimators.delayed_problem`), and the information is what there would be if it were known. Where the contact
        is pressed aslant to the line of sight its uncertainty is widened (`estimators.oblique`), because what it was
        fitted to may not be the bottom of the dent.

    Raises:
        NoEstimate: fewer than three observations, or no noise level.
    """
    noise = settings.noise if settings.noise is not None else case.noise
    if not (math.isfinite(noise) and noise > 0):
        raise NoEstimate("The depth's noise isn't known; set geometry.smoothing above 0, or give the noise.")
    if len(case.steps) < LEAST_OBSERVATIONS:
        raise NoEstimate(
            f"The contact was followed over {len(case.steps)} frames after its onset; {LEAST_OBSERVATIONS} are needed."
        )
    if settings.onset_within > 0:
        problem = DelayedProblem(case, settings.mechanics, noise, settings.onset_within)
        return _fit(problem, problem.box(settings.box))
    return _fit(ContactProblem(case, settings.mechanics, noise), settings.box)


def _fit(problem: ContactProblem, box: np.ndarray) -> ContactEstimate:
    """Fit a problem's parameters, those of θ first, within their box, shape [2, D]."""
    low, high = box
    candidates = problem.candidates(low, high)
    paths = problem.coarse_paths(candidates)
    prior = box_information(box)
    optima = distinct(
        [find_optimum(problem, start, low, high) for start in problem.best_starts(candidates, paths, low, high)]
    )
    draws = _sample(problem, optima, box, prior, candidates, paths)
    if draws.effective < TOO_FEW:
        # Most likely all starts have missed the best optimum, and some draw came near it.
        optima = distinct([*optima, find_optimum(problem, draws.likeliest, low, high)])
        draws = _sample(problem, optima, box, prior, candidates, paths)
    mean, spread, best = combine(optima, prior)
    judges = mean[None]
    if draws.effective >= TOO_FEW:
        mean, spread, judges = draws.mean, draws.covariance, draws.thinned(JUDGES)
    information = problem.information(mean)
    residual = (problem.path(best.logs) - problem.observed) @ problem.case.direction
    found = ContactEstimate(
        theta=problem.theta(mean),
        covariance=spread[:3, :3],
        information=information[:3, :3],
        noise=problem.noise,
        misfit=float(np.sqrt(np.square(residual).mean())) / problem.noise,
        at_bound=np.minimum(best.logs - low, high - best.logs)[:3] < AT_BOUND,
        decisive=cautious([about_tissue(problem.information(logs), prior) for logs in judges]),
        delays=problem.delays(mean),
        delays_at_end=bool((np.abs(mean[3:]) > DELAY_AT_END).any()),
        view_angle=view_angle(problem.case),
    )
    if not is_oblique(found):
        return found
    hidden = about_tissue(information / effective_misfit(found) ** 2, prior)
    return found.less_certain(np.linalg.inv(hidden + prior[:3, :3]))


def _sample(
    problem: ContactProblem,
    optima: Sequence[Optimum],
    box: np.ndarray,
    prior: np.ndarray,
    candidates: np.ndarray,
    paths: np.ndarray,
) -> Draws:
    """The posterior around its optima; candidates [C, 3] with their motions [C, M, 3] are draws as well."""
    # The coarse step's error hardly varies over the posterior.
    best = optima[0].logs
    coarse_error = problem.coarse_paths(best[None])[0] - problem.path(best)
    direction = problem.case.direction.astype(np.float64)
    observed = (problem.observed + coarse_error) @ direction / problem.noise
    shares = np.maximum(evidence_shares(optima, prior), LEAST_SHARE)
    start = Mixture(
        shares / shares.sum(),
        np.array([optimum.logs for optimum in optima]),
        np.array([WIDER * np.linalg.inv(_tempered(optimum, len(observed)) + prior) for optimum in optima]),
    )
    return sample_posterior(
        lambda logs: log_likelihoods(observed, problem.coarse_paths(logs) @ direction / problem.noise),
        box,
        start,
        (candidates, log_likelihoods(observed, paths @ direction / problem.noise)),
    )


def _tempered(optimum: Optimum, frames: int) -> np.ndarray:
    """Information [3, 3] at an optimum, less where it explains the motion badly."""
    return optimum.information / max(variance_scale(2 * optimum.cost, frames), 1.0)


def cautious(information: Sequence[np.ndarray]) -> np.ndarray:
    """Of several draws' information, each [3, 3], one than which a share TRUST of them is at least as telling.

    How much a motion tells depends on θ itself. A verdict at the mean alone would be as uncertain as that.
    """
    order = sorted(information, key=lambda found: float(bounds(found).max()))
    return order[math.ceil(TRUST * len(order)) - 1]


def fit_clip(
    clip: PreparedClip | CollectedClip, settings: DirectSettings, horizon_frames: Horizon = None, onset: str = STAMP
) -> dict[int, ContactEstimate | NoEstimate]:
    """Fit every run of contact of a prepared clip whose onset was seen; an estimate, or why there is none, by onset.

    Args:
        clip: the clip.
        settings: the model that is fitted.
        horizon_frames: only these frames after an onset are used; None = as many as the rollout lasts.
    """
    settings = settings.matched(clip.fps, onset)
    samples = SampleSettings(observation="trajectory", horizon_frames=horizon_frames, mechanics=settings.mechanics)
    found: dict[int, ContactEstimate | NoEstimate] = {}
    for first, case in contact_cases(clip, samples).items():
        try:
            found[first] = fit_contact(case, settings)
        except NoEstimate as reason:
            found[first] = reason
    return found
