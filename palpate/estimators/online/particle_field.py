"""Stiffness particle by particle, in a frame and over a run of contact, and what of it is determined."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.forecast import FIELD, SHEET
from palpate.estimators.result import LEAST_SKILL, column


@dataclass(frozen=True)
class FieldNumbers:
    """Columns of a field in a frame: quantiles over what is known, and how much and how well that is."""

    distance_stiffness: float | None = column("", None)
    """stiffness against stretch, the median over tissue where it is determined, relative: a particle's mass over the
    square of a frame's time, not N/m; compares places within a run of contact, not clips; all of it in fields.npz"""
    distance_stiffness_low: float | None = column("", None)
    """10 % quantile of distance_stiffness over tissue where it is determined, not an interval"""
    distance_stiffness_high: float | None = column("", None)
    """90 % quantile of distance_stiffness over tissue where it is determined, not an interval"""
    distance_stiffness_log_sd: float | None = column("", None)
    """standard deviation of the log of stiffness over its mean, the median over that tissue"""
    shape_stiffness: float | None = column("", None)
    """stiffness against bending, the median over tissue where it is determined, relative, not comparable with
    distance_stiffness; all of it in fields.npz"""
    shape_stiffness_low: float | None = column("", None)
    """10 % quantile of shape_stiffness over tissue where it is determined, not an interval"""
    shape_stiffness_high: float | None = column("", None)
    """90 % quantile of shape_stiffness over tissue where it is determined, not an interval"""
    shape_stiffness_log_sd: float | None = column("", None)
    """standard deviation of the log of stiffness over its mean, the median over that tissue"""
    field_known: float = column("", 0.0)
    """share of the particles whose stiffness against stretch is determined: the posterior is narrower than the prior,
    tissue has stretched there, and the fit explains the motion"""
    shape_known: float = column("share of the particles whose stiffness against bending is determined", 0.0)
    skill: float = column("", math.nan)
    """skill so far, 1 - error / motion, of the tissue simulated under the instrument alone; below 0.35 the fit does not
    explain the motion, and nothing is determined"""
    gap: float | None = column("", None)
    """norm of the deformation by which the simulated particles missed what the frame shows, scene units"""


@dataclass(frozen=True, eq=False)
class StiffnessMap:
    """Stiffness of N particles."""

    value: np.ndarray
    """Shape [N] [m/Δt²]."""
    log_sd: np.ndarray
    """Standard deviation of the logarithm of `value` over its mean where tissue has stretched, shape [N]."""
    known: np.ndarray
    """Mask of the particles whose stiffness is determined so far, shape [N], bool; empty if the fit does not explain
    the motion."""


@dataclass(frozen=True, eq=False)
class ParticleField:
    """Stiffness over a sheet or a volume of tissue that an instrument drives, in one frame; N particles.

    Stiffness counts in m/Δt², a particle's mass over the square of a frame's time. It compares places within a run of
    contact, not clips, and no force follows from it.
    """

    onset_frame: int
    """Number of the frame in which the run began, and where the tissue is taken to be at rest."""
    rest: np.ndarray
    """Particles there, shape [N, 3] [scene units]."""
    faces: np.ndarray
    """Triangles that the camera saw there, shape [F, 3]."""
    tetrahedra: np.ndarray
    """Tetrahedra of a volume, shape [V, 4]; none of a sheet."""
    positions: np.ndarray
    """Particles now, without the background's motion, shape [N, 3] [scene units]."""
    pixels: np.ndarray
    """Places of the particles in the picture, with the background's motion, shape [N, 2] [px of the source frame]."""
    distance: StiffnessMap
    """Stiffness against stretch along the surface."""
    shape: StiffnessMap
    """Stiffness against changes of a neighbourhood's shape."""
    skill: float
    """Skill so far, 1 - error / motion, of the simulation driven by the instrument alone; not a number: nothing has
    moved."""
    gap: float | None
    """Norm of the deformation by which the simulation missed what the frame shows [scene units]; None = nothing."""

    @property
    def maps(self) -> dict[str, StiffnessMap]:
        """Both stiffnesses by the beginning of their columns."""
        return {"distance_stiffness": self.distance, "shape_stiffness": self.shape}

    @property
    def numbers(self) -> FieldNumbers:
        """Columns of a frame."""
        shares = {"field_known": float(self.distance.known.mean()), "shape_known": float(self.shape.known.mean())}
        found: dict[str, float] = {}
        for name, stiffness in self.maps.items():
            if stiffness.known.any():
                for end, share in (("_low", 0.1), ("", 0.5), ("_high", 0.9)):
                    found[f"{name}{end}"] = float(np.quantile(stiffness.value[stiffness.known], share))
                found[f"{name}_log_sd"] = float(np.median(stiffness.log_sd[stiffness.known]))
        return FieldNumbers(**found, **shares, skill=self.skill, gap=self.gap)

    @property
    def explained(self) -> bool:
        """True if tissue that the instrument moves explains the motion so far."""
        return self.skill >= LEAST_SKILL

    @property
    def verdict(self) -> str:
        """`stiffness_ratios` where something is known of either stiffness, else `undetermined`."""
        return "stiffness_ratios" if any(each.known.any() for each in self.maps.values()) else "undetermined"


@dataclass(frozen=True, eq=False)
class FieldResult:
    """Stiffness place by place from the motion of tissue that an instrument drives; T frames, rest first."""

    last: ParticleField
    """Field as it was in the last frame."""
    times: np.ndarray
    """Times since the run's first frame, shape [T] [s]."""
    course: np.ndarray
    """Root mean squares over the points of what is observed, predicted, and the difference, shape [T, 3] [px]."""
    stretched: bool
    """True if tissue has stretched anywhere by as much as settings ask for."""
    driven: DrivenTissue
    """Simulated tissue in its last state."""
    skills: Mapping[str, float] = field(default_factory=dict)
    """Skill of predicting later frames from earlier ones, by model (`estimators.online.forecast`)."""

    @property
    def skill(self) -> float:
        """Skill of that simulation over all frames, 1 - error / motion; not a number where nothing has moved."""
        return self.last.skill

    @property
    def simpler(self) -> bool:
        """True if a sheet of one number predicts better than the field, which then counts for nothing."""
        return self.skills.get(SHEET, -math.inf) > self.skills.get(FIELD, math.inf)

    @property
    def verdict(self) -> str:
        """`stiffness_ratios` or `undetermined`."""
        return "undetermined" if self.simpler else self.last.verdict

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of what is determined."""
        return () if self.verdict == "undetermined" else (self.verdict,)

    @property
    def explanation(self) -> str:
        """Sentence on the fit; empty where nothing has moved, or too little to stretch anything."""
        if math.isnan(self.skill):
            return ""
        left = f"{1 - self.skill:.0%} of the motion"
        if not self.last.explained:
            text = f"The fit does not explain the motion: it leaves {left} ({1 - LEAST_SKILL:.0%} at most are allowed),"
            return f"{text} so no stiffness is given or coloured."
        if not self.stretched:
            return ""
        if self.simpler:
            text = f"A {SHEET} predicts later frames from earlier ones better (skill {self.skills[SHEET]:.2f})"
            return f"{text} than the field ({self.skills[FIELD]:.2f}), so where it is stiffer is not determined."
        if not self.determined:
            return f"The fit leaves {left}, but no place's stiffness is determined: others explain the motion as well."
        stretch, bending = (f"{each.known.mean():.0%}" for each in self.last.maps.values())
        return f"The fit leaves {left}; stiffness is determined at {stretch} (stretch), {bending} (bending) of tissue."
