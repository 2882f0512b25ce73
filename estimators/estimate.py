"""What an estimator says: of a frame, of a whole run of contact, and of θ itself with how well it is known."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.grip.stiffness_field import StiffnessField
from palpate.physics.identifiability import LIMIT, bounds, combination_bounds, covariance, describe, verdict
from palpate.physics.load import PressShape
from palpate.physics.mechanics import PARAMETERS

NINETY = 1.6448536269514722
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""
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
LEAST_LEAD = 0.1
"""Over the skill of the same model with tissue far from the instrument as its grip: any motion spreads smoothly."""
LARGEST_SLAB_ERROR = 0.1
"""Share of the motion around a grip; a slab that leaves more of it is refuted: drawn pulls leave 0.005 to 0.03."""


BY_LIGHT = (
    "by the brightness of the tissue, for want of measured depth: lengths and forces are relative to its distance"
)


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
    outliers: float | None = None
    """Share of what was observed that lies so far from the model that it counted less; None where all counts
    equally."""
    modes: int = 1
    """Tissues far apart that explain the motion about as well; mean and covariance are those of all of them."""
    shape: PressShape | None = None
    """Patch, direction and course of the press where they were fitted; None = taken to be a step on one vertex."""
    view_angle: float | None = None
    """Angle between the contact's direction and the line of sight [degrees] (see estimators.oblique); None = not
    known."""
    by_light: bool = False
    """Whether the light of the tissue was observed instead of its depth, so that lengths count in its distance."""
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
        """The verdict's reason in words (see physics.identifiability.describe)."""
        if not self.explained:
            return "nothing is determined, because the model does not explain the motion"
        described = "" if self.given_verdict else describe(self.verdict_information)
        return f"{described}; {BY_LIGHT}" if self.by_light else described

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

    def widened(self, added: np.ndarray) -> Estimate:
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
        if self.shape is not None:
            found |= {
                "press_radius": self.shape.radius,
                "press_lean_deg": math.degrees(math.atan(math.hypot(*self.shape.lean))),
                "press_rise_s": self.shape.rise,
                "press_fall_s": self.shape.fall,
            }
        if self.information is not None:
            limits = bounds(self.information)
            found |= {f"{name}_bound": float(limit) for name, limit in zip(PARAMETERS, limits, strict=True)}
        return found


@dataclass(frozen=True, eq=False)
class ParticleField:
    """Stiffness over a sheet or a volume of tissue that an instrument drives, in one frame; N particles.

    Stiffness counts in m/Δt², a particle's mass over the square of a frame's time: it compares places within a run of
    contact, not clips, and no force follows from it.
    """

    onset_frame: int
    """Number of the frame in which the run began, and where the tissue is taken to be at rest."""
    rest: np.ndarray
    """Particles there, shape [N, 3] [scene units]."""
    faces: np.ndarray
    """Triangles that the camera saw there, shape [F, 3]."""
    tetrahedra: np.ndarray
    """Of a volume, shape [V, 4]; none of a sheet."""
    positions: np.ndarray
    """Particles now, without the background's motion, shape [N, 3] [scene units]."""
    pixels: np.ndarray
    """Where they are in the picture, with it, shape [N, 2] [px of the source frame]."""
    distance: np.ndarray
    """Stiffness against stretch along the surface, shape [N] [m/Δt²]."""
    shape: np.ndarray
    """Against changes of a neighbourhood's shape, likewise."""
    distance_log_sd: np.ndarray
    """Standard deviation of the logarithm of `distance` over its mean where tissue has stretched, shape [N]."""
    shape_log_sd: np.ndarray
    """Likewise of `shape`."""
    known: np.ndarray
    """Where the motion so far determines `distance`, shape [N], bool; nowhere where the fit does not explain it."""
    shape_known: np.ndarray
    """Likewise of `shape`."""
    skill: float
    """1 - error / motion so far of the simulation that the instrument alone leads; not a number: nothing has moved."""
    gap: float | None
    """Norm of the deformation by which the simulation missed what the frame shows [scene units]; None = nothing."""

    def numbers(self) -> dict[str, float]:
        """Columns of a frame: quantiles over what is known, and how much and how well that is."""
        found = {
            "field_known": float(self.known.mean()),
            "shape_known": float(self.shape_known.mean()),
            "skill": self.skill,
        }
        if self.gap is not None:
            found["gap"] = self.gap
        for name, values, log_sd, known in (
            ("distance_stiffness", self.distance, self.distance_log_sd, self.known),
            ("shape_stiffness", self.shape, self.shape_log_sd, self.shape_known),
        ):
            if known.any():
                low, middle, high = np.quantile(values[known], (0.1, 0.5, 0.9)).tolist()
                found |= {f"{name}_low": low, name: middle, f"{name}_high": high}
                found[f"{name}_log_sd"] = float(np.median(log_sd[known]))
        return found

    @property
    def explained(self) -> bool:
        """Whether tissue that the instrument moves explains the motion so far."""
        return self.skill >= LEAST_SKILL

    @property
    def verdict(self) -> str:
        """`stiffness_ratios` where something is known of either stiffness, else `undetermined`."""
        return "stiffness_ratios" if self.known.any() or self.shape_known.any() else "undetermined"


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """One frame: its status, its contact, and its parameters or the reason why there are none.

    A quantity that does not exist for the frame (or that the estimator does not give) is None, never 0.
    """

    frame: int
    """Number of the frame in its source."""
    time_s: float
    """Time stamp of the frame [s]."""
    status: str
    """`ok`, or why the frame has no parameters: unreadable, no_mask, no_tool, no_tissue, bad_depth, no_contact."""
    detail: str = ""
    """Sentences about the status, or about what can't be trusted although the status is ok."""
    estimate: Estimate | None = None
    """Its parameters."""
    verdict: str = ""
    """The estimate's; `undetermined` for a frame in contact of which nothing can be said; empty unless the status is
    ok, and from an estimator of whole runs only."""
    contact: bool | None = None
    """Whether tool and tissue touch; None where that could not be decided."""
    contact_probability: float | None = None
    """Of contact, by whether tissue moves with the tool; None where outlines and depth show that there is none."""
    contact_distance: float | None = None
    """Distance between the nearest tool and tissue points [scene units]."""
    contact_u: float | None = None
    """Column of the tissue's contact point [px of the source frame]."""
    contact_v: float | None = None
    """Row of the tissue's contact point [px of the source frame]."""
    simulated_displacement: float | None = None
    """Length of the simulated displacement of the contact vertex [scene units]."""
    observed_displacement: float | None = None
    """Length of the observed displacement of the contact point [scene units]."""
    arrow: np.ndarray | None = None
    """Tail and tip (u, v) of the force that acts on the contact point, shape [2, 2] [px of the source frame]; None
    without force."""
    field: ParticleField | None = None
    """Stiffness over the tissue, from an estimator that finds it place by place."""

    @functools.cached_property
    def values(self) -> dict[str, Any]:
        """Everything by name, the numbers of estimate and field included; what is not known is missing or None."""
        numbers = {} if self.estimate is None else self.estimate.numbers()
        return {
            **vars(self),
            **numbers,
            **({} if self.field is None else self.field.numbers()),
            "verdict": self.verdict,
        }


@dataclass(frozen=True, eq=False)
class GripEstimate:
    """What the motion around an instrument tells where the onset of contact was not observed; T frames that move.

    The tissue at the instrument is taken as given, a sheet on a foundation explains the rest. Neither k_s nor k_d nor a
    force in any unit is determined by a displacement.
    """

    foundation_over_stiffness: float
    """Stiffness of a node's foundation over a spring's, nodes 8 px apart."""
    foundation_over_stiffness_low: float
    """Lower end of its 90 % interval."""
    foundation_over_stiffness_high: float
    """Upper end."""
    skill: float
    """1 - error / motion in frames that were not fitted: 0 as if nothing moved, 1 = exact."""
    rival: float
    """The same if the most moving tissue far from the instrument is taken as the grip instead."""
    times: np.ndarray
    """Since the run's first frame, shape [T] [s]."""
    force: np.ndarray
    """At the grip over that of the last frame, shape [T]."""
    force_sd: np.ndarray
    """Its standard deviation, shape [T]."""
    reaction_over_stiffness: float
    """What holds the tissue in the last frame over a spring's stiffness [px]: times depth over focal length F/k_s."""
    reaction_over_stiffness_low: float
    """Lower end of its 90 % interval."""
    reaction_over_stiffness_high: float
    """Upper end."""
    stiffness: StiffnessField | None = None
    """Where the tissue is stiffer, if it is attached homogeneous; None where that could not be fitted."""
    points: np.ndarray = dataclasses.field(default_factory=lambda: np.empty((0, 2)))
    """Followed tissue at rest, to draw a map where it is by then, shape [N, 2] [px of the map's picture]."""
    moved: np.ndarray = dataclasses.field(default_factory=lambda: np.empty((0, 0, 2)))
    """Its displacement at the times, not a number where it is lost, shape [T, N, 2], float32 [px]."""
    reaction_over_young: float = math.nan
    """What holds the tissue in the last frame over E, if a slab of given thickness lies beneath; nan where none was
    fitted [scene units²]."""
    reaction_over_young_low: float = math.nan
    """Lower end of its 90 % interval."""
    reaction_over_young_high: float = math.nan
    """Upper end."""
    slab_error: float = 0.0
    """What the slab does not explain of the points' motion, besides noise, over the motion."""

    @property
    def explained(self) -> bool:
        """Whether the tissue moves with the instrument as a sheet would, and not with something else."""
        return self.skill >= max(LEAST_SKILL, self.rival + LEAST_LEAD)

    @property
    def verdict(self) -> str:
        """`reaction`, `foundation`, `relative_force` or `undetermined`."""
        if "reaction_over_young" in self.determined:
            return "reaction"
        if "foundation_over_stiffness" in self.determined:
            return "foundation"
        return "relative_force" if "relative_force" in self.determined else "undetermined"

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of what is determined."""
        if not self.explained:
            return ()
        known = {
            "reaction_over_young": self.slab_error <= LARGEST_SLAB_ERROR and self._width("reaction_over_young") < LIMIT,
            "foundation_over_stiffness": self._width("foundation_over_stiffness") < LIMIT,
            "relative_force": np.isfinite(self.force).all() and self.force_sd.max() < LIMIT,
            "stiffness_ratios": self.stiffness is not None and self.stiffness.tells,
        }
        return tuple(name for name, sure in known.items() if sure)

    def _width(self, name: str) -> float:
        """Standard deviation of the logarithm that a quantity's 90 % interval says."""
        return math.log(getattr(self, f"{name}_high") / getattr(self, f"{name}_low")) / (2 * NINETY)


@dataclass(frozen=True, eq=False)
class FieldEstimate:
    """What the motion of tissue that an instrument drives tells of stiffness place by place; T frames, rest first."""

    last: ParticleField
    """As it was in the last frame."""
    picture: np.ndarray
    """The run's first one, in whose pixels all places are, uint8 [h, w, 3] RGB."""
    places: np.ndarray
    """Of the particles at rest, shape [N, 2] [px]."""
    points: np.ndarray
    """Followed points that the instrument does not hold, at rest, shape [Q, 2] [px]."""
    observed: np.ndarray
    """Their displacement in the last frame that shows some, shape [Q, 2] [px]; not observed = NaN."""
    predicted: np.ndarray
    """The same by the simulation that the instrument alone leads."""
    times: np.ndarray
    """Since the run's first frame, shape [T] [s]."""
    course: np.ndarray
    """Root mean squares over the points of what is observed, predicted, and the difference, shape [T, 3] [px]."""
    numbers: dict[str, np.ndarray]
    """What `ParticleField.numbers` says in every frame, by name, not a number where it says nothing, shape [T] each."""
    stretched: bool
    """Whether tissue has anywhere stretched by as much as settings ask for."""

    @property
    def skill(self) -> float:
        """1 - error / motion of that simulation over all frames; not a number where nothing has moved."""
        return self.last.skill

    @property
    def explained(self) -> bool:
        """Whether tissue that the instrument moves explains the motion."""
        return self.last.explained

    @property
    def verdict(self) -> str:
        """`stiffness_ratios` or `undetermined`."""
        return self.last.verdict

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of what is determined."""
        return () if self.verdict == "undetermined" else (self.verdict,)

    @property
    def explanation(self) -> str:
        """What the fit comes to, a sentence; empty where nothing has moved, or too little to stretch anything."""
        if math.isnan(self.skill):
            return ""
        left = f"{1 - self.skill:.0%} of the motion"
        if not self.explained:
            return (
                f"The fit does not explain the motion: tissue simulated under the instrument alone leaves {left} "
                f"({1 - LEAST_SKILL:.0%} at most count as explained), so no stiffness is given or coloured."
            )
        if not self.stretched:
            return ""
        if not self.determined:
            return (
                f"Tissue simulated under the instrument alone leaves {left}, but no place's stiffness is determined: "
                "others explain the motion as well, so none is given or coloured."
            )
        return (
            f"Tissue simulated under the instrument alone leaves {left}; stiffness is determined at "
            f"{self.last.known.mean():.0%} of the particles against stretch, at {self.last.shape_known.mean():.0%} "
            "against bending."
        )


@dataclass(frozen=True, eq=False)
class InteractionEstimate:
    """One whole run of contact: its parameters, or the reason why there are none."""

    onset: int
    """Index of the run's first frame in contact in its clip."""
    onset_frame: int
    """Number of that frame."""
    onset_time_s: float
    """Its time stamp [s]."""
    load_s: float | None = None
    """Time from the onset to the release [s]; None where either was not observed."""
    interaction: Interaction | None = None
    """What was observed; None where the tissue was not followed from an onset."""
    estimate: Estimate | None = None
    """Its parameters."""
    simulated: tuple[np.ndarray, np.ndarray] | None = None
    """Times since the onset [s] and the simulated motion along the force then [scene units], shape [T] each."""
    grip: GripEstimate | None = None
    """What the motion around tells, where nothing is determined by the contact's own."""
    field: FieldEstimate | None = None
    """What it tells of stiffness place by place, from the estimator that finds that."""
    detail: str = ""
    """Why there is no estimate, or why it can't be trusted."""

    @property
    def main_estimate(self) -> Estimate | GripEstimate | FieldEstimate | None:
        """The one by which the verdict is given: a grip's where it tells something and the press nothing."""
        if self.field is not None:
            return self.field
        known = self.estimate is not None and self.estimate.verdict != "undetermined"
        useful = self.grip is not None and self.grip.verdict != "undetermined"
        return self.grip if useful and not known else self.estimate

    @property
    def verdict(self) -> str:
        """What is determined in a word; empty where nothing was estimated."""
        return "" if self.main_estimate is None else self.main_estimate.verdict


def mixture(found: Sequence[Estimate]) -> Estimate:
    """Several estimates of one contact that count equally as one, the moment-matched mixture.

    What else it says is that of the one which explains the motion best.
    """
    best = min(found, key=lambda item: item.misfit)
    if len(found) == 1:
        return best
    logs = np.log(np.abs([item.theta for item in found]))
    apart = np.cov(logs, rowvar=False, bias=True)
    expected = np.mean([covariance(item.verdict_information) for item in found], axis=0) + apart
    return dataclasses.replace(
        best,
        theta=np.exp(logs.mean(axis=0)) * np.sign(best.theta),
        covariance=np.mean([item.covariance for item in found], axis=0) + apart,
        expected_information=np.linalg.inv(expected),
    )
