"""What an estimator says of a frame, and of a whole run of contact."""

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.estimate import Estimate
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.online.particle_field import FieldEstimate, ParticleField
from palpate.physics.mechanics import Mechanics


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
    """`ok`, or why the frame has no parameters: unreadable, repeated, no_mask, no_tool, no_tissue, bad_depth,
    no_contact."""
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
    instrument: int | None = None
    """Number of the instrument that touches (`data.contact.instruments`)."""
    simulated_displacement: float | None = None
    """Length of the simulated displacement of the contact vertex [scene units]."""
    observed_displacement: float | None = None
    """Length of the observed displacement of the contact point [scene units]."""
    arrow: np.ndarray | None = None
    """Tail and tip (u, v) of the force that acts on the contact point, shape [2, 2] [px of the source frame]; None
    without force."""
    field: ParticleField | None = None
    """Stiffness over the tissue, from an estimator that finds it place by place."""
    alarm: str | None = None
    """Whether the force has reached a limit (`results.alarm`), empty without contact; None without a limit."""
    determined: str | None = None
    """What its contact leaves determined, joined by ;; None = what the estimate says."""
    relative_force: float | None = None
    """Force of a pull over its peak in its contact."""
    relative_force_low: float | None = None
    """Lower end of its 90 % interval."""
    relative_force_high: float | None = None
    """Upper end."""

    @functools.cached_property
    def values(self) -> dict[str, Any]:
        """Everything by name, the numbers of estimate and field included; what is not known is missing or None."""
        numbers = {} if self.estimate is None else self.estimate.numbers()
        field = {} if self.field is None else self.field.numbers()
        agreed = {} if self.determined is None else {"determined": self.determined}
        return {**vars(self), **numbers, **field, **agreed, "verdict": self.verdict}


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
    mechanics: Mechanics | None = None
    """Constants of the sheet of springs that was simulated; None where it was another model."""
    grip: GripEstimate | None = None
    """What the motion around tells, where nothing is determined by the contact's own."""
    field: FieldEstimate | None = None
    """What it tells of stiffness place by place, from the estimator that finds that."""
    detail: str = ""
    """Why there is no estimate, or why it can't be trusted."""
    instrument: int | None = None
    """Number of the instrument that touches."""

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

    @property
    def skill(self) -> float:
        """1 - error / change, root mean squares: 0 as if the tissue kept still, 1 exact; not a number without either.

        Of a pull in frames that were not fitted; of a press in those that were: by light of how the tissue's light
        changes, else of the contact's motion along the force.
        """
        found, contact = self.main_estimate, self.interaction
        if isinstance(found, GripEstimate | FieldEstimate):
            return found.skill
        if found is not None and found.by_light:
            return 1 - found.left
        if found is None or contact is None or self.simulated is None:
            return math.nan
        along = contact.along
        known = np.isfinite(along)
        left = along - np.interp(contact.observation.times, *self.simulated)
        change = np.linalg.norm(along[known])
        return float(1 - np.linalg.norm(left[known]) / change) if change > 0 else math.nan
