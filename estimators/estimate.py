"""What an estimator says about one frame: the record that tables and pictures are made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimators.onset import together
from physics.identifiability import bounds, describe, verdict
from physics.mechanics import PARAMETERS

Verdict = Literal["", "onset_in_view", "determined", "ratios", "undetermined"]
NINETY = 1.6448536269514722
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""


class NoEstimate(ValueError):
    """A contact can't be fitted; the message is a sentence that says why."""


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
    """What is determined, by the estimate's own standard deviations: every parameter (`determined`), only k_s/k_d and
    F/k_d (`ratios`), or not even those (`undetermined`); see physics.identifiability. Models without a posterior only
    say whether their window shows the onset of contact (`onset_in_view`), without which nothing is determined. Empty
    unless the status is ok."""
    stiffness: float | None = None
    """k_s [scene units (normalised)]."""
    stiffness_sd: float | None = None
    """Standard deviation of `stiffness`."""
    stiffness_low: float | None = None
    """Lower end of the 90 % interval of k_s."""
    stiffness_high: float | None = None
    """Upper end of the 90 % interval of k_s."""
    stiffness_bound: float | None = None
    """Cramér–Rao bound on the standard deviation of log k_s at the estimate."""
    damping: float | None = None
    """k_d [scene units (normalised)]."""
    damping_sd: float | None = None
    """Standard deviation of `damping`."""
    damping_low: float | None = None
    """Lower end of the 90 % interval of k_d."""
    damping_high: float | None = None
    """Upper end of the 90 % interval of k_d."""
    damping_bound: float | None = None
    """Cramér–Rao bound on the standard deviation of log k_d at the estimate."""
    force: float | None = None
    """Magnitude |F| [scene units (normalised)], never negative."""
    force_sd: float | None = None
    """Standard deviation of `force`."""
    force_low: float | None = None
    """Lower end of the 90 % interval of |F|."""
    force_high: float | None = None
    """Upper end of the 90 % interval of |F|."""
    force_bound: float | None = None
    """Cramér–Rao bound on the standard deviation of log |F| at the estimate."""
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
    """Fisher information of the same from the observed contact trajectory, at `theta`, shape [3, 3]."""
    noise: float
    """Standard deviation of every observed coordinate [scene units]."""
    misfit: float
    """Root mean square of observed minus simulated displacement along the force over `noise`: 1 where the model
    explains the data. Not across it, where a measured normal that is off by a few degrees (8-bit depth) tells more than
    the tissue; so a sideways motion that the model can't explain is not told."""
    at_bound: np.ndarray
    """Whether a parameter lies at its range's end, shape [3], bool."""
    decisive: np.ndarray | None = None
    """Information by which the verdict is given, shape [3, 3]; None = that of `covariance`. Not that at `theta`: where
    an estimate is badly known, so is the information at it."""
    delays: tuple[float, ...] = ()
    """Fitted times from the first frame in contact to the beginning of the press, and from the first one after it to
    its end [s]; none of either that was not fitted."""
    delays_at_end: bool = False
    """Whether one of them lies at its range's end."""
    view_angle: float | None = None
    """Angle between the contact's direction and the line of sight [degrees] (see estimators.oblique); None = not
    known."""

    @property
    def log_sd(self) -> np.ndarray:
        """Standard deviations of the logarithms, shape [3]: relative errors, while they are small."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def verdict(self) -> str:
        """`determined`, `ratios` or `undetermined` (see physics.identifiability.verdict)."""
        return verdict(self.decisive_information)

    @property
    def explanation(self) -> str:
        """The verdict's reason in words (see physics.identifiability.describe)."""
        return describe(self.decisive_information)

    @property
    def decisive_information(self) -> np.ndarray:
        """Information by which the verdict is given, shape [3, 3]."""
        return np.linalg.inv(self.covariance) if self.decisive is None else self.decisive

    def less_certain(self, added: np.ndarray) -> ContactEstimate:
        """The same with a covariance [3, 3] added to its own, and to that of its verdict."""
        # (D⁻¹ + A)⁻¹ = (1 + DA)⁻¹D, which exists where D is singular, too.
        decisive = np.linalg.solve(np.eye(3) + self.decisive_information @ added, self.decisive_information)
        return dataclasses.replace(self, covariance=self.covariance + added, decisive=(decisive + decisive.T) / 2)


def combined(found: Sequence[ContactEstimate]) -> ContactEstimate:
    """Several estimates of one contact that count alike, as one, with their common mean and covariance.

    What else it says is that of the one which explains the motion best.
    """
    best = min(found, key=lambda item: item.misfit)
    if len(found) == 1:
        return best
    means, signs = np.log(np.abs([item.theta for item in found])), np.sign(best.theta)
    mean, covariance = together(means, np.array([item.covariance for item in found]))
    apart = covariance - np.mean([item.covariance for item in found], axis=0)
    decisive = np.mean([np.linalg.pinv(item.decisive_information) for item in found], axis=0) + apart
    return dataclasses.replace(
        best,
        theta=np.exp(mean) * signs,
        covariance=covariance,
        decisive=np.linalg.inv(decisive),
    )


UNCERTAINTY = {
    column: text.format(symbol)
    for name, symbol in zip(PARAMETERS, ("k_s", "k_d", "|F|"), strict=True)
    for column, text in (
        (f"{name}_low", "lower end of the 90 % interval of {}"),
        (f"{name}_high", "upper end of the 90 % interval of {}"),
        (f"{name}_bound", "Cramér–Rao bound on the standard deviation of log {} (0.1: 10 %), were the onset known"),
    )
}
"""Columns of intervals and bounds, in order, each with what it is."""


def uncertainty(found: ContactEstimate) -> dict[str, float]:
    """The uncertainty fields of a `FrameEstimate`: log-normal standard deviations and 90 % intervals, and bounds."""
    fields: dict[str, float] = {}
    limits = bounds(found.information)
    for name, value, log_sd, limit in zip(PARAMETERS, np.abs(found.theta), found.log_sd, limits, strict=True):
        fields[f"{name}_sd"] = float(value * np.exp(log_sd**2 / 2) * np.sqrt(np.expm1(log_sd**2)))
        fields[f"{name}_low"], fields[f"{name}_high"] = (
            float(value * np.exp(sign * NINETY * log_sd)) for sign in (-1, 1)
        )  # fmt: skip
        fields[f"{name}_bound"] = float(limit)
    return fields
