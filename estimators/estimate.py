"""What an estimator says about one frame: the record that tables and pictures are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["", "onset_in_view", "undetermined"]


@dataclass(frozen=True)
class FrameEstimate:
    """Parameters of one frame, or the reason why there are none.

    A quantity that does not exist for the frame (or that the model does not give) is None, never 0.
    """

    frame: int
    """Number of the frame in its source."""
    time_s: float
    """Time stamp of the frame [s]."""
    status: str
    """`ok`, or why the frame has no parameters: unreadable, no_mask, no_tool, no_tissue, bad_depth, no_contact."""
    detail: str = ""
    """One sentence about the status, or about something missing although the status is ok."""
    verdict: Verdict = ""
    """Whether the model's window shows the onset of contact; without it the response that separates stiffness,
    damping and force is out of view, and the numbers are `undetermined`. Empty unless the status is ok."""
    stiffness: float | None = None
    """k_s [scene units (normalised)]."""
    stiffness_sd: float | None = None
    """Standard deviation of `stiffness`."""
    damping: float | None = None
    """k_d [scene units (normalised)]."""
    damping_sd: float | None = None
    """Standard deviation of `damping`."""
    force: float | None = None
    """Magnitude |F| [scene units (normalised)], never negative."""
    force_sd: float | None = None
    """Standard deviation of `force`."""
    contact: bool | None = None
    """Whether tool and tissue touch; None where that could not be decided."""
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
