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
    """against stretch, the median over tissue where it is determined, relative: a particle's mass over the square of a
    frame's time, not N/m; compares places within a run of contact, not clips; all of it in fields.npz"""
    distance_stiffness_low: float | None = column("", None)
    """its 10 % quantile over that tissue, not an interval"""
    distance_stiffness_high: float | None = column("", None)
    """its 90 % quantile over that tissue, not an interval"""
    distance_stiffness_log_sd: float | None = column("", None)
    """standard deviation of the log of stiffness over its mean, the median over that tissue"""
    shape_stiffness: float | None = column("", None)
    """against bending, the median over tissue where it is determined, likewise, not comparable with
    distance_stiffness; all of it in fields.npz"""
    shape_stiffness_low: float | None = column("", None)
    """its 10 % quantile over that tissue, not an interval"""
    shape_stiffness_high: float | None = column("", None)
    """its 90 % quantile over that tissue, not an interval"""
    shape_stiffness_log_sd: float | None = column("", None)
    """standard deviation of the log of stiffness over its mean, the median over that tissue"""
    field_known: float = column("", 0.0)
    """share of the particles whose stiffness against stretch is determined: surer than before anything was observed,
    the tissue there has stretched, and the fit explains the motion"""
    shape_known: float = column("the same of stiffness against bending", 0.0)
    skill: float = column("", math.nan)
    """1 - error / motion so far of the tissue simulated under the instrument alone; below 0.35 the fit does not explain
    the motion, and nothing is determined"""
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
    """Where the motion so far determines it, shape [N], bool; nowhere where the fit does not explain the motion."""


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
    """Tetrahedra of a volume, shape [V, 4]; none of a sheet."""
    positions: np.ndarray
    """Particles now, without the background's motion, shape [N, 3] [scene units]."""
    pixels: np.ndarray
    """Where they are in the picture, with it, shape [N, 2] [px of the source frame]."""
    distance: StiffnessMap
    """Against stretch along the surface."""
    shape: StiffnessMap
    """Against changes of a neighbourhood's shape."""
    skill: float
    """1 - error / motion so far of the simulation that the instrument alone leads; not a number: nothing has moved."""
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
        """Whether tissue that the instrument moves explains the motion so far."""
        return self.skill >= LEAST_SKILL

    @property
    def verdict(self) -> str:
        """`stiffness_ratios` where something is known of either stiffness, else `undetermined`."""
        return "stiffness_ratios" if any(each.known.any() for each in self.maps.values()) else "undetermined"


@dataclass(frozen=True, eq=False)
class FieldResult:
    """What the motion of tissue that an instrument drives tells of stiffness place by place; T frames, rest first."""

    last: ParticleField
    """Field as it was in the last frame."""
    times: np.ndarray
    """Since the run's first frame, shape [T] [s]."""
    course: np.ndarray
    """Root mean squares over the points of what is observed, predicted, and the difference, shape [T, 3] [px]."""
    stretched: bool
    """Whether tissue has anywhere stretched by as much as settings ask for."""
    driven: DrivenTissue
    """What was simulated, as it was left."""
    skills: Mapping[str, float] = field(default_factory=dict)
    """How well later frames are predicted from earlier ones, by model (`estimators.online.forecast`): skill."""

    @property
    def skill(self) -> float:
        """1 - error / motion of that simulation over all frames; not a number where nothing has moved."""
        return self.last.skill

    @property
    def explained(self) -> bool:
        """Whether tissue that the instrument moves explains the motion."""
        return self.last.explained

    @property
    def simpler(self) -> bool:
        """Whether a sheet of one number predicts better than the field, which then counts for nothing."""
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
        """What the fit comes to, a sentence; empty where nothing has moved, or too little to stretch anything."""
        if math.isnan(self.skill):
            return ""
        left = f"{1 - self.skill:.0%} of the motion"
        if not self.explained:
            text = f"The fit does not explain the motion: tissue simulated under the instrument alone leaves {left}"
            return f"{text} ({1 - LEAST_SKILL:.0%} at most count as explained), so no stiffness is given or coloured."
        if not self.stretched:
            return ""
        if self.simpler:
            better, worse = self.skills[SHEET], self.skills[FIELD]
            text = f"A {SHEET} predicts later frames from earlier ones better (skill {better:.2f}) than stiffness"
            return f"{text} place by place does ({worse:.2f}), so where it is stiffer is not determined."
        if not self.determined:
            text = f"Tissue simulated under the instrument alone leaves {left}, but no place's stiffness is determined:"
            return f"{text} others explain the motion as well, so none is given or coloured."
        shares = [f"{each.known.mean():.0%}" for each in self.last.maps.values()]
        text = f"Tissue simulated under the instrument alone leaves {left}; stiffness is determined at"
        return f"{text} {shares[0]} of the particles against stretch, at {shares[1]} against bending."
