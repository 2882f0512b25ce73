"""The direct estimator: θ of one contact from its motion through the simulator, without a trained network.

The strongest classical rival of a network (docs/identifiability.md). Levenberg–Marquardt with a trust region
(`estimators.direct.problem`) finds what explains the motion best, in φ = (log k_s, log k_d, log |F|) and, where the
instants are not known, in the delays of the press (`estimators.direct.delayed`). Around these optima the posterior is
sampled (`estimators.direct.sampling`), with a uniform prior on the box of these and with noise as tracked contacts
have it (`estimators.direct.error_model`): mean and covariance of φ are the estimate.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence

import numpy as np

from data.contact.geometry import GeometrySettings
from data.contact.interaction import Horizon, Interaction
from data.depth.normalise import DepthSettings
from data.prepared import PreparedFrame
from data.settings import PrepareSettings
from estimators.contract import Chosen, ClipInfo, Said
from estimators.direct.delayed import DelayedProblem, about_tissue
from estimators.direct.error_model import log_likelihoods, variance_scale
from estimators.direct.problem import ContactProblem, Optimum, combine, distinct, evidence_shares, find_optimum
from estimators.direct.sampling import Draws, Mixture, sample_posterior
from estimators.estimate import Estimate, NoEstimate
from estimators.oblique import effective_misfit, is_oblique, remark, view_angle
from estimators.onset import onset_error
from estimators.runs import RunSession, frame_estimate
from physics.identifiability import bounds, box_information
from physics.load import held
from physics.mechanics import PARAMETERS, RECOMMENDED, Bounds, Mechanics
from physics.msd.simulation import simulate

LEAST_SIGMA = 3e-5
"""A smaller σ is refused [scene units]: that is the fitted simulator's own error (docs/identifiability.md), which would
be taken for motion of the tissue."""
SMOOTHING = 4.0
"""Default width over which the resting shape is smoothed [grid px]."""
WHOLE = "This estimator fits whole runs of contact: see interactions.csv."
LEAST_OBSERVATIONS = 3
"""Frames after the onset in which the tissue was followed."""
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

FITTED = Mechanics(time_step=0.0025, steps=400, scheme="dkd", window_error=1e-6)
"""The default integrator; its own error must lie below the noise: of second order, with half the paper's step."""


class DirectEstimator:
    """Fits every run of contact when it has ended; needs no network.

    Args:
        onset: when a press begins, one of `estimators.onset.ONSETS`.
        horizon: how much of a contact is looked at.
        noise: σ of every observed coordinate [scene units], at least LEAST_SIGMA; None = the clip's own depth noise.
        mechanics: integrator of the fitted model.
        bounds: admissible box, in which the prior is uniform; F presses.

    Raises:
        ValueError: a noise that is too small or not finite, or a box that reaches 0.
    """

    name = "direct"

    def __init__(
        self,
        onset: str,
        horizon: Horizon = None,
        noise: float | None = None,
        mechanics: Mechanics = FITTED,
        bounds: Bounds = RECOMMENDED,
    ) -> None:
        if noise is not None and not LEAST_SIGMA <= noise < math.inf:
            raise ValueError(f"noise is {noise}; give a length of {LEAST_SIGMA:g} or more, or leave it out.")
        self.onset, self.horizon, self.noise, self.mechanics, self.bounds = onset, horizon, noise, mechanics, bounds
        model = {"mechanics": dataclasses.asdict(mechanics), "bounds": dataclasses.asdict(bounds)}
        self.described = {"name": self.name, "onset": onset, "horizon": horizon, "noise": noise, **model}
        """All that the fits depend on beside the clip."""
        self.log_box = bounds.log_box
        """Of φ, shape [2, 3]."""

    def preparation(self, chosen: Chosen) -> PrepareSettings:
        """Smoothed tissue, the camera's motion taken off, and otherwise what the user chooses."""
        smoothing = SMOOTHING if chosen.smoothing is None else chosen.smoothing
        return PrepareSettings(
            depth=DepthSettings(**chosen.depth),
            geometry=GeometrySettings(smoothing=smoothing, rigid_motion="subtract"),
            masks=chosen.masks or "auto",
            layout=chosen.layout,
        )

    def start(self, clip: ClipInfo) -> DirectSession:
        """Open a session."""
        return DirectSession(self, clip)


class DirectSession(RunSession):
    """One clip: a record for every frame, and a fit for every run of contact."""

    def __init__(self, estimator: DirectEstimator, clip: ClipInfo) -> None:
        super().__init__(clip, estimator.mechanics, estimator.horizon)
        self.estimator = estimator
        self._within = onset_error(estimator.onset, clip.fps)

    def push(self, frame: PreparedFrame) -> Iterator[Said]:
        """The next frame."""
        yield from self._ended(self._runs.push(frame))
        yield frame_estimate(frame, self.clip, doubts=WHOLE if frame.in_contact else "", whole=True)

    def fit(self, contact: Interaction) -> Estimate:
        """Fit θ to one contact.

        Where the beginning of the press isn't known its delay is fitted as well (`estimators.direct.delayed`), and the
        information is what there would be if it were known. Where the contact is pressed aslant to the line of sight
        its uncertainty is widened (`estimators.oblique`), because what it was fitted to may not be the bottom of the
        dent.

        Raises:
            NoEstimate: fewer than three observations, or no noise level.
        """
        estimator, count = self.estimator, len(contact.observation)
        noise = contact.noise if estimator.noise is None else estimator.noise
        if not (math.isfinite(noise) and noise > 0):
            raise NoEstimate("The depth's noise isn't known; set geometry.smoothing above 0, or give the noise.")
        if count < LEAST_OBSERVATIONS:
            raise NoEstimate(
                f"The contact was followed over {count} frames after its onset; {LEAST_OBSERVATIONS} are needed."
            )
        if self._within > 0:
            problem = DelayedProblem(contact, self.mechanics, noise, self._within)
            return _fit(problem, problem.box(estimator.log_box))
        return _fit(ContactProblem(contact, self.mechanics, noise), estimator.log_box)

    def _whole(self, contact: Interaction) -> tuple[Estimate, tuple[np.ndarray, np.ndarray], str]:
        start = time.perf_counter()
        try:
            found = self.fit(contact)
        finally:
            self.seconds["fit"] += time.perf_counter() - start
        return found, simulated_motion(contact, found, self.mechanics), doubts(found, self.estimator.bounds)


def simulated_motion(contact: Interaction, found: Estimate, mechanics: Mechanics) -> tuple[np.ndarray, np.ndarray]:
    """Times from the first frame in contact to the last observation [s], and the motion along the force, [T] each."""
    delay, release = (*found.delays, 0.0, 0.0)[:2]
    steps = contact.steps + math.ceil(max(-delay, 0.0) / mechanics.time_step)
    loaded = (contact.load_seconds + release - delay) / mechanics.time_step if contact.released else math.inf
    press = dataclasses.replace(contact.load, factor=held(loaded, steps))
    path = simulate(found.theta, contact.mesh, press, mechanics) @ np.asarray(contact.direction, np.float64)
    began = delay + mechanics.time_step * np.arange(steps + 1)
    times = np.linspace(0, contact.steps * mechanics.time_step, steps + 1)
    return times, np.interp(times, began, np.concatenate([[0.0], path]))


def doubts(found: Estimate, bounds: Bounds) -> str:
    """Sentences on why an estimate can't be trusted; empty where nothing speaks against it."""
    oblique = remark(found)
    told = [oblique] if oblique else []
    if not found.explained:
        told.append(
            f"The model does not explain the data: they lie {found.misfit:.2g} times the noise from it"
            # An oblique one was widened by its misfit.
            + ("." if oblique else ", so the uncertainties are too small.")
        )
    if found.delays_at_end:
        told.append(
            "The press seems to have begun or ended a whole frame from where it was seen to; don't trust the fit."
        )
    for name, stuck, (low, high) in zip(PARAMETERS, found.at_bound, np.exp(bounds.log_box).T, strict=True):
        if stuck:
            told.append(f"The best fit lies at the end of the {name}'s admissible range, {low:g} to {high:g}.")
    return " ".join(told)


def _fit(problem: ContactProblem, box: np.ndarray) -> Estimate:
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
    judges = mean[None]
    if draws.effective >= TOO_FEW:
        mean, spread, judges = draws.mean, draws.covariance, draws.thinned(JUDGES)
    information = problem.information(mean)
    residual = (problem.path(best.logs) - problem.moved) @ problem.direction
    found = Estimate(
        theta=problem.theta(mean),
        covariance=spread[:3, :3],
        information=information[:3, :3],
        noise=problem.sigma,
        misfit=float(np.sqrt(np.square(residual).mean())) / problem.sigma,
        largest_misfit=LARGEST_MISFIT,
        at_bound=np.minimum(best.logs - low, high - best.logs)[:3] < AT_BOUND,
        expected_information=trusted_information([about_tissue(problem.information(logs), prior) for logs in judges]),
        delays=tuple((problem.within * mean[3:]).tolist()),
        delays_at_end=bool((np.abs(mean[3:]) > DELAY_AT_END).any()),
        view_angle=view_angle(problem.contact),
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
    start = Mixture(
        shares / shares.sum(),
        np.array([optimum.logs for optimum in optima]),
        np.array([WIDER * np.linalg.inv(_tempered(optimum, len(observed)) + prior) for optimum in optima]),
    )
    candidates, paths = known
    return sample_posterior(
        lambda logs: likelihoods(problem.coarse_paths(logs)), box, start, (candidates, likelihoods(paths))
    )


def _tempered(optimum: Optimum, frames: int) -> np.ndarray:
    """Information [3, 3] at an optimum, less where it explains the motion badly."""
    return optimum.information / max(variance_scale(2 * optimum.cost, frames), 1.0)


def trusted_information(information: Sequence[np.ndarray]) -> np.ndarray:
    """Of several draws' information, each [3, 3], one than which a share TRUST of them is at least as telling.

    How much a motion tells depends on θ itself. A verdict at the mean alone would be as uncertain as that.
    """
    order = sorted(information, key=lambda found: float(bounds(found).max()))
    return order[math.ceil(TRUST * len(order)) - 1]
