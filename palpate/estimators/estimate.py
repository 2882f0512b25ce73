"""Parameters θ of a press: what an estimator says of them, and how well they are known."""

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from palpate.estimators.result import Quantity, column
from palpate.physics.identifiability import LIMIT, bounds, combination_bounds, verdict
from palpate.physics.load import PressShape
from palpate.physics.mechanics import PARAMETERS

COMBINATIONS = {
    "stiffness": (1.0, 0.0, 0.0),
    "damping": (0.0, 1.0, 0.0),
    "force": (0.0, 0.0, 1.0),
    "damping_over_stiffness": (-1.0, 1.0, 0.0),
    "force_over_stiffness": (-1.0, 0.0, 1.0),
    "force_over_damping": (0.0, -1.0, 1.0),
}
"""Products of powers, by their exponents: k_s, k_d, |F|, k_d/k_s [s], |F|/k_s [scene units], |F|/k_d."""
REPORTED = tuple(name for name in COMBINATIONS if name != "force_over_damping")
"""Combinations that are reported as numbers; F/k_d follows from them, and is only reported as determined or not."""
SYMBOLS = dict(zip(COMBINATIONS, ("k_s", "k_d", "|F|", "k_d/k_s", "|F|/k_s", "|F|/k_d"), strict=True))


@dataclass(frozen=True)
class PressNumbers:
    """Columns of a press."""

    stiffness: Quantity | None = column("k_s", None)
    damping: Quantity | None = column("k_d", None)
    force: Quantity | None = column("|F|", None)
    damping_over_stiffness: Quantity | None = column("k_d/k_s", None)
    force_over_stiffness: Quantity | None = column("|F|/k_s", None)
    stiffness_bound: float | None = column("", None)
    """Cramér–Rao bound on the sd of log k_s (0.1: 10 %), were the onset known"""
    damping_bound: float | None = column("", None)
    """Cramér–Rao bound on the sd of log k_d (0.1: 10 %), were the onset known"""
    force_bound: float | None = column("", None)
    """Cramér–Rao bound on the sd of log |F| (0.1: 10 %), were the onset known"""


@dataclass(frozen=True)
class PressCourse:
    """Course of a press: how and when the instrument pressed, as far as that was fitted."""

    delay_s: float | None = column("", None)
    """s from the onset frame to the beginning of the press, as fitted; empty: taken to be 0, or no estimate"""
    release_delay_s: float | None = column("", None)
    """s from the first frame after contact to the end of the press; empty: the same, or not observed"""
    at_end: bool = False
    """True if a delay lies at the end of its range."""
    shape: PressShape | None = None
    """Patch, direction and course of the press; None = taken to be a step on one vertex."""
    view_angle: float | None = None
    """Angle between the contact's direction and the line of sight [degrees] (`estimators.oblique`); None = not
    known, or the dent is too shallow to hide its bottom."""

    @property
    def delays(self) -> tuple[float, float]:
        """Both delays [s], 0 where they were not fitted."""
        return self.delay_s or 0.0, self.release_delay_s or 0.0


@dataclass(frozen=True)
class LightFit:
    """Residual of a fit to the shading of the tissue."""

    left: float = np.nan
    """Share of the change of light that the model leaves, root mean square."""
    lag: float = 0.0
    """Lag of coded pictures behind the light [levels of 8 bits]; 0 where that lies within 90 % of none."""


class NoEstimate(ValueError):
    """A contact can't be estimated; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class PressResult:
    """θ and how well it is known."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3] [scene units (normalised)]."""
    covariance: np.ndarray | None = None
    """Covariance of φ = (log k_s, log k_d, log |F|), shape [3, 3]; None from an estimator that gives none."""
    information: np.ndarray | None = None
    """Fisher information of φ from the observed motion, at `theta`, shape [3, 3]."""
    noise: float = np.nan
    """Standard deviation of every observed coordinate [scene units]."""
    misfit: float = np.nan
    """Root mean square of observed minus simulated displacement along the force over `noise`: 1 where the model
    explains the data. Not across it, where a measured normal that is off by a few degrees (8-bit depth) tells more than
    the tissue; so a sideways motion that the model can't explain is not determined."""
    largest_misfit: float = np.inf
    """Largest misfit with which the model still explains the motion."""
    at_bound: np.ndarray = field(default_factory=lambda: np.zeros(3, bool))
    """Mask of the parameters that lie at the end of their range, shape [3], bool."""
    expected_information: np.ndarray | None = None
    """Inverse of the expected Cramér–Rao bound, by which the verdict is given, shape [3, 3]; None = that of
    `covariance`. Not that at `theta`: where an estimate is badly known, so is the information at it."""
    given_verdict: str = ""
    """Verdict of an estimator that knows no uncertainty: `onset_in_view` or `undetermined`."""
    course: PressCourse = PressCourse()
    light: LightFit | None = None
    """Fit to the tissue's light, observed instead of its depth: lengths count in its distance; None = by depth."""
    refuted: str = ""
    """Sentence on another model that explains the motion better; empty where none is known."""

    @property
    def log_sd(self) -> np.ndarray:
        """Standard deviations of the logarithms, shape [3]: relative errors, while they are small."""
        return np.sqrt(np.diag(self.covariance))  # ty: ignore[no-matching-overload]  of an estimate that knows it

    @property
    def verdict(self) -> str:
        """`determined`, `ratios` or `undetermined` (see physics.identifiability.verdict).

        Nothing is determined by a model that does not explain the motion.
        """
        if not self.explained:
            return "undetermined"
        return self.given_verdict or verdict(self.verdict_information)

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the COMBINATIONS that are determined."""
        if self.given_verdict or not self.explained:
            return ()
        limits = combination_bounds(self.verdict_information, list(COMBINATIONS.values()))
        return tuple(name for name, limit in zip(COMBINATIONS, limits, strict=True) if limit < LIMIT)

    @property
    def explanation(self) -> str:
        """Explanation beside verdict and numbers: why nothing is determined, or what the estimate comes from."""
        if not self.explained:
            return "nothing is determined, because the model does not explain the motion"
        light = "by the shading of the tissue, for want of measured depth: lengths and forces are relative"
        return f"{light} to its distance" if self.light else ""

    @property
    def verdict_information(self) -> np.ndarray:
        """Information by which the verdict is given, shape [3, 3]."""
        if self.expected_information is not None:
            return self.expected_information
        return np.linalg.inv(self.covariance)  # ty: ignore[no-matching-overload]  as above

    @property
    def explained(self) -> bool:
        """True if the model explains the motion."""
        return not self.misfit > self.largest_misfit and not self.refuted

    def widened(self, added: np.ndarray) -> Self:
        """Return the result with a covariance [3, 3] added to its own, and to that of its verdict."""
        # (D⁻¹ + A)⁻¹ = (1 + DA)⁻¹D, which exists where D is singular, too.
        expected = np.linalg.solve(np.eye(3) + self.verdict_information @ added, self.verdict_information)
        own = {"covariance": self.covariance + added, "expected_information": (expected + expected.T) / 2}
        return replace(self, **own)

    def quantity(self, name: str) -> Quantity | None:
        """Return one of the COMBINATIONS; None where it is a ratio to a parameter that is 0."""
        row = np.array(COMBINATIONS[name])
        with np.errstate(divide="ignore", invalid="ignore"):
            value = float(np.prod(np.abs(self.theta) ** row))
        # Rounding may leave the variance of a well known ratio of badly known parameters below 0.
        log_sd = None if self.covariance is None else float(np.sqrt(max(row @ self.covariance @ row, 0.0)))
        return Quantity(value, log_sd) if np.isfinite(value) else None

    @property
    def numbers(self) -> PressNumbers:
        """Columns of the press; what the estimator does not give is missing."""
        limits = () if self.information is None else zip(PARAMETERS, bounds(self.information).tolist(), strict=True)
        found: dict[str, Any] = {name: self.quantity(name) for name in REPORTED}
        return PressNumbers(**found | {f"{name}_bound": limit for name, limit in limits})
