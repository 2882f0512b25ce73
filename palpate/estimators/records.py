"""Records of estimators: of a frame, and of a whole run of contact."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.estimate import PressCourse, PressNumbers, PressResult
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.online.particle_field import FieldNumbers, FieldResult, ParticleField
from palpate.estimators.result import Result, Table, column, group
from palpate.physics.mechanics import PARAMETERS, Mechanics

VERDICT = (
    "determined, ratios (only k_d/k_s, and F/k_s or F/k_d), relative_force (only that, of a pull), "
    "stiffness_ratios (only where tissue is stiffer, of --estimator online), undetermined; onset_in_view: the model "
    "doesn't say"
)
DETERMINED = "parameters and ratios that are determined, joined by ; (in fit.png: the curve of relative_force)"
"""Text of the column `determined` in all tables."""


@dataclass(frozen=True, eq=False)
class Touch:
    """Contact of an instrument in a frame; what does not exist is None, never 0."""

    contact_probability: float | None = column("", None)
    """probability that tissue next to the tool moves with it or sinks under it; below 0.5 it hovers; empty: no contact
    to judge"""
    contact_distance: float | None = column("scene units", None)
    """Distance between the nearest tool and tissue points."""
    contact_u: float | None = column("px of the source frame, column", None)
    contact_v: float | None = column("px of the source frame, row", None)
    instrument: int | None = column("", None)
    """instrument that touches, numbered from left to right as first seen; empty: none"""
    simulated_displacement: float | None = column("scene units", None)
    """Length of the simulated displacement of the contact vertex."""
    observed_displacement: float | None = column("scene units", None)
    """Length of the observed displacement of the contact point."""
    arrow: np.ndarray | None = None
    """Tail and tip (u, v) of the force that acts on the contact point, shape [2, 2] [px of the source frame]."""


@dataclass(frozen=True)
class RelativeForce:
    """Force of a pull in a frame."""

    relative_force: float = column()
    """force of a pull at the grip over its peak in this contact; empty: not known, or no pull"""
    relative_force_low: float = column("lower end of the 90 % interval of relative_force")
    relative_force_high: float = column("upper end of the 90 % interval of relative_force")


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """Row of parameters.csv: a frame's status, its contact, and its parameters or the reason why there are none.

    A quantity that does not exist for the frame (or that the estimator does not give) is None, never 0.
    """

    frame: int = column("number of the frame in its source")
    time_s: float = column("s")
    estimate: PressResult | None = group(PressNumbers, kw_only=True)
    """Parameters of the press."""
    contact: bool | None = column("1 or 0; empty: undecided", None, kw_only=True)
    touch: Touch = group(Touch, Touch(), kw_only=True)
    field: ParticleField | None = group(FieldNumbers, kw_only=True)
    """Stiffness over the tissue, from an estimator that finds it place by place."""
    status: str = column("ok, or why the frame has no parameters")
    """`ok`, unreadable, repeated, no_mask, no_tool, no_tissue, bad_depth or no_contact."""
    verdict: str = column(VERDICT, "", kw_only=True)
    """The estimate's; `undetermined` for a frame in contact of which nothing can be said; empty unless the status is
    ok, and from an estimator of whole runs only."""
    determined: str | None = column(DETERMINED, None, kw_only=True)
    """Determined quantities, as the estimate has it, or what the end of the contact leaves of that."""
    pull: RelativeForce | None = group(RelativeForce, kw_only=True)
    detail: str = column("sentences about the status, or about what can't be trusted", "")
    alarm: str | None = column("", None, kw_only=True)
    """state of the force limit: above where the upper end of the force's 90 % interval has reached it, else below;
    unknown where the force is not determined, or contact not decided: neither safe nor unsafe; empty: no contact"""

    def __post_init__(self) -> None:
        if self.determined is None and self.estimate is not None:
            object.__setattr__(self, "determined", ";".join(self.estimate.determined))


@dataclass(frozen=True)
class Onset:
    """Columns that name a contact in every table."""

    onset_frame: int = column("number of the run's first frame in contact")
    onset_time_s: float = column("s")


@dataclass(frozen=True)
class Followed:
    """Columns of what was observed of a contact."""

    instrument: int | None = column("instrument that touches, numbered from left to right as first seen")
    frames: int = column("frames after the onset in which its tissue was followed")
    load_s: float | None = column()
    """s from the onset to the release; empty: the onset or the release was not observed"""


@dataclass(frozen=True)
class Outcome:
    """Columns of what was concluded of a contact."""

    skill: float = column()
    """skill, 1 - error / motion, root mean squares: 0 as if the tissue kept still, 1 exact; of a pull, in frames that
    were not fitted; of a press in those that were fitted, of the contact's motion along the force, by light of the
    tissue's light; of --estimator online as in parameters.csv, of all frames"""
    verdict: str = column(VERDICT)
    determined: str = column(DETERMINED)
    explanation: str = column("reason why nothing is determined, or source of the estimate other than measured depth")
    noise: float | None = column("standard deviation of every observed coordinate, scene units")
    misfit: float | None = column()
    """root mean square of observed minus simulated displacement along the force over the noise; 1: it fits"""
    at_bound: str = column("parameters that lie at the end of their admissible range")
    status: str = column("ok or no_estimate")
    detail: str = column("sentence about the status, or about an estimate that can't be trusted")


@dataclass(frozen=True, eq=False)
class InteractionEstimate:
    """One whole run of contact: its parameters, or the reason why there are none."""

    onset: int
    """Index of the run's first frame in contact in its clip."""
    onset_frame: int
    """Number of that frame."""
    onset_time_s: float
    """Time stamp of that frame [s]."""
    load_s: float | None = None
    """Time from the onset to the release [s]; None where either was not observed."""
    interaction: Interaction | None = None
    """Observation of the run; None where the tissue was not followed from an onset."""
    estimate: PressResult | None = None
    """Parameters of the press."""
    simulated: tuple[np.ndarray, np.ndarray] | None = None
    """Times since the onset [s] and the simulated motion along the force then [scene units], shape [T] each."""
    mechanics: Mechanics | None = None
    """Constants of the sheet of springs that was simulated; None where it was another model."""
    grip: PullResult | None = None
    """Pull estimated from the motion around, where the contact's own motion determines nothing."""
    field: FieldResult | None = None
    """Stiffness place by place, from the estimator that finds that."""
    detail: str = ""
    """Reason why there is no estimate, or why it can't be trusted."""
    instrument: int | None = None
    """Number of the instrument that touches."""

    @property
    def beside(self) -> PullResult | FieldResult | None:
        """Result that gives the verdict in place of the press's: a pull's where it alone determines something."""
        if self.field is not None:
            return self.field
        known = self.estimate is not None and self.estimate.verdict != "undetermined"
        return None if known or self.grip is None or self.grip.verdict == "undetermined" else self.grip

    @property
    def main_estimate(self) -> Result | None:
        """Result by which the verdict is given."""
        return self.beside or self.estimate

    @property
    def verdict(self) -> str:
        """Verdict in a word; empty where nothing was estimated."""
        return "" if self.main_estimate is None else self.main_estimate.verdict

    @property
    def skill(self) -> float:
        """Skill, 1 - error / change, root mean squares: 0 as if the tissue kept still, 1 exact; not a number without
        either.

        Of a pull in frames that were not fitted; of a press in those that were: by light of how the tissue's light
        changes, else of the contact's motion along the force.
        """
        press, contact = self.estimate, self.interaction
        if self.beside is not None:
            return self.beside.skill
        if press is not None and press.light is not None:
            return 1 - press.light.left
        if press is None or contact is None or self.simulated is None:
            return math.nan
        along = contact.along
        known = np.isfinite(along)
        left = along - np.interp(contact.observation.times, *self.simulated)
        change = np.linalg.norm(along[known])
        return float(1 - np.linalg.norm(left[known]) / change) if change > 0 else math.nan

    @property
    def rows(self) -> tuple[Any, ...]:
        """Columns of the contact in interactions.csv, as in `CONTACTS`."""
        found, press, contact = self.main_estimate, self.estimate, self.interaction
        stuck, fit = "", (None, None)
        if press is not None:
            stuck = " ".join(name for name, at_end in zip(PARAMETERS, press.at_bound, strict=True) if at_end)
            fit = press.noise, press.misfit
        frames = 0 if contact is None else len(contact.observation)
        frames = frames if self.beside is None else len(self.beside.times)
        conclusion = ("", "", "") if found is None else (found.verdict, ";".join(found.determined), found.explanation)
        status = "no_estimate" if found is None else "ok"
        observed = Onset(self.onset_frame, self.onset_time_s), Followed(self.instrument, frames, self.load_s)
        pressed = () if press is None else (press.course, press.numbers)
        return *observed, *pressed, Outcome(self.skill, *conclusion, *fit, stuck, status, self.detail)


FRAMES = Table((FrameEstimate,))
"""parameters.csv, with the column of --force-limit last."""
CONTACTS = Table((Onset, Followed, PressCourse, PressNumbers, Outcome))
"""interactions.csv."""
