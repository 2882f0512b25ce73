"""What an estimator says about one frame: the record that tables and pictures are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from physics.identifiability import verdict

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


@dataclass(frozen=True)
class ContactEstimate:
    """Parameters of one whole run of contact, with their uncertainty."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3] [scene units (normalised)]."""
    covariance: np.ndarray
    """Covariance of (log k_s, log k_d, log |F|), shape [3, 3]."""
    information: np.ndarray
    """Fisher information of the same from the observed contact trajectory at `theta`, shape [3, 3]."""
    noise: float
    """Standard deviation of every observed coordinate [scene units]."""
    misfit: float
    """Root mean square of observed minus simulated displacement over `noise`: 1 where the model explains the data."""
    at_bound: np.ndarray
    """Whether a parameter lies at its range's end, shape [3], bool."""

    @property
    def log_sd(self) -> np.ndarray:
        """Standard deviations of the logarithms, shape [3]: relative errors, while they are small."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def verdict(self) -> str:
        """`determined`, `ratios` or `undetermined` (see physics.identifiability.verdict)."""
        return verdict(self.information)
