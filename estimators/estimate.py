"""What an estimator says of θ, and how well that is known."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from palpate.physics.identifiability import LIMIT, NINETY, bounds, combination_bounds, verdict
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
"""Those with numbers of their own; F/k_d follows from them, and only whether it is determined is said."""
SYMBOLS = dict(zip(COMBINATIONS, ("k_s", "k_d", "|F|", "k_d/k_s", "|F|/k_s", "|F|/k_d"), strict=True))
LEAST_SKILL = 0.35
"""Of a grip's model: instruments that pass over tissue reach 0.1 to 0.3 with a whole mask, pulls 0.4 and more."""
BY_LIGHT = "by the shading of the tissue, for want of measured depth: lengths and forces are relative to its distance"


class NoEstimate(ValueError):
    """A contact can't be estimated; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """θ and how well it is known."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3] [scene units (normalised)]."""
    covariance: np.ndarray | None = None
    """Covariance of φ = (log k_s, log k_d, log |F|), shape [3, 3]; None from an estimator that gives none."""
    information: np.ndarray | None = None
    """Fisher information of φ from the observed motion, at `theta`, shape [3, 3]."""
    noise: float = math.nan
    """Standard deviation of every observed coordinate [scene units]."""
    misfit: float = math.nan
    """Root mean square of observed minus simulated displacement along the force over `noise`: 1 where the model
    explains the data. Not across it, where a measured normal that is off by a few degrees (8-bit depth) tells more than
    the tissue; so a sideways motion that the model can't explain is not determined."""
    largest_misfit: float = math.inf
    """Beyond it the model does not explain the motion."""
    at_bound: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3, bool))
    """Whether a parameter lies at its range's end, shape [3], bool."""
    expected_information: np.ndarray | None = None
    """Inverse of the expected Cramér–Rao bound, by which the verdict is given, shape [3, 3]; None = that of
    `covariance`. Not that at `theta`: where an estimate is badly known, so is the information at it."""
    given_verdict: str = ""
    """Verdict of an estimator that knows no uncertainty: `onset_in_view` or `undetermined`."""
    delays: tuple[float, ...] = ()
    """Fitted times from the first frame in contact to the beginning of the press, and from the first one after it to
    its end [s]; none of either that was not fitted."""
    delays_at_end: bool = False
    """Whether one of them lies at its range's end."""
    shape: PressShape | None = None
    """Patch, direction and course of the press where they were fitted; None = taken to be a step on one vertex."""
    view_angle: float | None = None
    """Angle between the contact's direction and the line of sight [degrees] (see estimators.oblique); None = not
    known."""
    by_light: bool = False
    """Whether the light of the tissue was observed instead of its depth, so that lengths count in its distance."""
    left: float = math.nan
    """Share of the change of light that the model leaves, root mean square; not a number where no light is fitted."""
    lag: float = 0.0
    """How far coded pictures lag behind the light [levels of 8 bits]; 0 where that lies within 90 % of none."""
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
        """What verdict and numbers alone don't say."""
        if not self.explained:
            return "nothing is determined, because the model does not explain the motion"
        return BY_LIGHT * self.by_light

    @property
    def verdict_information(self) -> np.ndarray:
        """Information by which the verdict is given, shape [3, 3]."""
        if self.expected_information is not None:
            return self.expected_information
        return np.linalg.inv(self.covariance)  # ty: ignore[no-matching-overload]  as above

    @property
    def explained(self) -> bool:
        """Whether the model explains the motion."""
        return not self.misfit > self.largest_misfit and not self.refuted

    def widened(self, added: np.ndarray) -> Self:
        """The same with a covariance [3, 3] added to its own, and to that of its verdict."""
        # (D⁻¹ + A)⁻¹ = (1 + DA)⁻¹D, which exists where D is singular, too.
        expected = np.linalg.solve(np.eye(3) + self.verdict_information @ added, self.verdict_information)
        return dataclasses.replace(
            self, covariance=self.covariance + added, expected_information=(expected + expected.T) / 2
        )

    def numbers(self) -> dict[str, Any]:
        """Every REPORTED combination with its log-normal standard deviation, 90 % interval and bound, and the verdict.

        What the estimator does not give is missing, and so is a ratio to a parameter that is 0.
        """
        found: dict[str, Any] = {"verdict": self.verdict, "determined": ";".join(self.determined)}
        for name in REPORTED:
            row = np.array(COMBINATIONS[name])
            with np.errstate(divide="ignore", invalid="ignore"):
                value = float(np.prod(np.abs(self.theta) ** row))
            if not math.isfinite(value):
                continue
            found[name] = value
            if self.covariance is not None:
                # Rounding may leave the variance of a well known ratio of badly known parameters below 0.
                log_sd = math.sqrt(max(row @ self.covariance @ row, 0.0))
                found[f"{name}_sd"] = float(value * np.exp(log_sd**2 / 2) * np.sqrt(np.expm1(log_sd**2)))
                found[f"{name}_low"] = float(value * np.exp(-NINETY * log_sd))
                found[f"{name}_high"] = float(value * np.exp(NINETY * log_sd))
        if self.information is not None:
            limits = bounds(self.information)
            found |= {f"{name}_bound": float(limit) for name, limit in zip(PARAMETERS, limits, strict=True)}
        return found
