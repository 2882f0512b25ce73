"""The direct estimator: θ of one contact by nonlinear least squares through the simulator, without a trained network.

The strongest classical rival of a network (spec, section 2, item 10). Levenberg–Marquardt with a trust region
(`scipy.optimize.least_squares`) over φ = (log k_s, log k_d, log |F|) with the rollout's exact Jacobian, from several
starts. The covariance at an optimum is the inverse Fisher information, which is the Cramér–Rao bound there; where
several optima explain the data, mean and covariance are those of their mixture.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats.qmc import Sobol

from data.clip_cache import PreparedClip
from data.collected import CollectedClip
from data.samples import ContactCase, SampleSettings, contact_cases
from estimators.estimate import ContactEstimate, NoEstimate
from physics.identifiability import covariance, fisher_information, least_informative, log_jacobian
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate, simulate_sensitivities

CANDIDATES = 128
"""Points of a Sobol sequence over the box among which the starts are chosen: an under-damped response has many local
optima, one for every number of swings."""
STARTS = 6
"""Fits, begun at the candidates that explain the data best."""
SCREENING_STEP = 0.005
"""Time step with which candidates are compared [s]."""
TOLERANCE = 1e-8
MOST_EVALUATIONS = 60
SAME = 0.05
"""Optima nearer to each other than this in every log-parameter are one."""
NEGLIGIBLE = 1e-3
"""Optima with less than this share of the likeliest one's evidence are left out."""
AT_BOUND = 1e-3
"""Estimates this near to the end of their range in φ lie at it."""


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
    """σ of every observed coordinate [scene units]; None = the clip's own depth noise."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "force"):
            low, high = getattr(self, name)
            if not 0 < low < high < math.inf:
                raise ValueError(f"{name} is [{low}, {high}]; give two positive numbers, the lower one first.")
        if self.noise is not None and not self.noise > 0:
            raise ValueError(f"noise is {self.noise}; give a positive length or leave it out.")

    @property
    def box(self) -> np.ndarray:
        """Lower and upper φ, shape [2, 3]."""
        return np.log(np.array([self.stiffness, self.damping, self.force]).T)


def fit_contact(case: ContactCase, settings: DirectSettings) -> ContactEstimate:
    """Fit θ to one contact.

    Args:
        case: the contact; its steps must have been made with the settings' time step.

    Raises:
        NoEstimate: fewer than three observations, or no noise level.
    """
    noise = settings.noise if settings.noise is not None else case.noise
    if not (math.isfinite(noise) and noise > 0):
        raise NoEstimate("the depth's noise isn't known; set geometry.smoothing above 0, or give the noise.")
    if len(case.steps) < 3:
        raise NoEstimate(f"the contact was followed over {len(case.steps)} frames after its onset; 3 are needed.")
    problem = ContactProblem(case, settings.mechanics, noise)
    low, high = settings.box
    ends = [
        least_squares(
            problem.residual, start, problem.jacobian, (low, high), method="trf",
            x_scale="jac", ftol=TOLERANCE, xtol=TOLERANCE, gtol=TOLERANCE, max_nfev=MOST_EVALUATIONS,
        )
        for start in problem.starts(low, high)
    ]  # fmt: skip
    optima = _distinct([Optimum(end.x, end.cost, fisher_information(end.jac, 1.0)) for end in ends])
    mean, spread, likeliest = combine(optima, np.diag(12 / (high - low) ** 2))
    return ContactEstimate(
        theta=problem.theta(mean),
        covariance=spread,
        information=least_informative(problem.information, mean, spread, settings.box),
        noise=noise,
        misfit=math.sqrt(2 * likeliest.cost / len(case.steps)),
        at_bound=np.minimum(mean - low, high - mean) < AT_BOUND,
    )


class Optimum(NamedTuple):
    """A local optimum of the misfit."""

    logs: np.ndarray
    """φ, shape [3]."""
    cost: float
    """Half of χ²."""
    information: np.ndarray
    """Fisher information of φ, shape [3, 3]."""


def combine(optima: Sequence[Optimum], prior: np.ndarray) -> tuple[np.ndarray, np.ndarray, Optimum]:
    """Mean [3] and covariance [3, 3] of φ over several optima, and the likeliest of them.

    Each optimum stands for a normal distribution whose share is its evidence by Laplace's method, exp(-χ²/2) times the
    volume of φ that explains the data as well: a slightly worse fit of many φ can be likelier than the best of few.

    Args:
        optima: at least one.
        prior: information of the admissible box, which limits that volume, shape [3, 3].
    """
    volumes = [-0.5 * np.linalg.slogdet(optimum.information + prior)[1] for optimum in optima]
    logs = np.array([volume - optimum.cost for volume, optimum in zip(volumes, optima, strict=True)])
    shares = np.exp(logs - logs.max())
    shares = np.where(shares < NEGLIGIBLE, 0.0, shares)
    shares /= shares.sum()
    places = np.array([optimum.logs for optimum in optima])
    mean = shares @ places
    apart = np.einsum("o,op,oq->pq", shares, places - mean, places - mean)
    within = sum(share * covariance(optimum.information) for share, optimum in zip(shares, optima, strict=True))
    return mean, within + apart, optima[int(np.argmax(shares))]


def _distinct(optima: Sequence[Optimum]) -> list[Optimum]:
    """The optima without those that another start found as well, the best first."""
    kept: list[Optimum] = []
    for optimum in sorted(optima, key=lambda item: item.cost):
        if all(np.abs(optimum.logs - other.logs).max() > SAME for other in kept):
            kept.append(optimum)
    return kept


def fit_clip(clip: PreparedClip | CollectedClip, settings: DirectSettings) -> dict[int, ContactEstimate | NoEstimate]:
    """Fit every run of contact of a prepared clip whose onset was seen; an estimate, or why there is none, by onset."""
    settings = dataclasses.replace(settings, mechanics=settings.mechanics.matched(1 / clip.fps))
    samples = SampleSettings(observation="trajectory", mechanics=settings.mechanics)
    found: dict[int, ContactEstimate | NoEstimate] = {}
    for onset, case in contact_cases(clip, samples).items():
        try:
            found[onset] = fit_contact(case, settings)
        except NoEstimate as reason:
            found[onset] = reason
    return found


class ContactProblem:
    """Residuals and their exact derivatives by φ, each in units of the noise."""

    def __init__(self, case: ContactCase, mechanics: Mechanics, noise: float) -> None:
        self.case, self.noise = case, noise
        steps = int(case.steps.max()) + 1
        self.mechanics = dataclasses.replace(mechanics, steps=steps, load_steps=0)
        self.load_steps = min(case.load_steps, steps)
        self.observed = case.displacement.astype(np.float64)
        self._at: np.ndarray | None = None

    @staticmethod
    def theta(logs: np.ndarray) -> np.ndarray:
        """θ with F pressing."""
        return np.exp(logs) * (1.0, 1.0, -1.0)

    def starts(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """φ of the candidates with the smallest misfit, shape [STARTS, 3]."""
        candidates = low + Sobol(3, rng=0).random(CANDIDATES) * (high - low)
        coarse = max(1, round(SCREENING_STEP / self.mechanics.time_step))
        steps = -(-self.mechanics.steps // coarse)
        mechanics = dataclasses.replace(
            self.mechanics, time_step=coarse * self.mechanics.time_step, steps=steps, window_error=1e-3
        )
        seen = (self.case.steps + 1) // coarse - 1
        case, load_steps = self.case, min(round(self.load_steps / coarse), steps)
        misfits = []
        for logs in candidates:
            path = simulate(self.theta(logs), case.mesh, case.vertex, case.direction, mechanics, load_steps=load_steps)
            misfits.append(np.square(path[seen] - self.observed).sum())
        return candidates[np.argsort(misfits)[:STARTS]]

    def information(self, logs: np.ndarray) -> np.ndarray:
        """Fisher information at φ, shape [3, 3]."""
        return fisher_information(self.jacobian(logs), 1.0)

    def residual(self, logs: np.ndarray) -> np.ndarray:
        """(Φ - d)/σ, flattened."""
        self._evaluate(logs)
        return self._residual

    def jacobian(self, logs: np.ndarray) -> np.ndarray:
        """Its derivatives by φ."""
        self._evaluate(logs)
        return self._jacobian

    def _evaluate(self, logs: np.ndarray) -> None:
        if self._at is not None and np.array_equal(logs, self._at):
            return
        theta, case = self.theta(logs), self.case
        arguments = theta, case.mesh, case.vertex, case.direction, self.mechanics
        path, slopes = simulate_sensitivities(*arguments, load_steps=self.load_steps, dtype=np.float64)
        self._at = logs.copy()
        self._residual = ((path[case.steps] - self.observed) / self.noise).ravel()
        self._jacobian = (log_jacobian(slopes[case.steps], theta) / self.noise).reshape(-1, 3)
