"""Stiffness of an object between two jaws, from force and width."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.estimators.palpation.curves import Grasp

BETWEEN = (2.0, 8.0)
"""Forces within which the slope is taken [N]: below the jaws may still be arriving, above its shape decides."""
FRESH = 0.005
"""Change of the width that tells a new reading from a repeated one [mm]."""


@dataclass(frozen=True)
class GraspSlope:
    """Stiffness of a grasp; of a width that never changes it is infinite."""

    compliance: float
    """Width that is lost per newton [mm/N]."""
    sd: float
    """Its standard deviation [mm/N], counting repeated readings once."""
    samples: int
    """Frames within BETWEEN while the jaws close."""

    @property
    def stiffness(self) -> float:
        """[N/mm]."""
        return 1 / self.compliance if self.compliance > 0 else np.inf


def fit_grasp(grasp: Grasp) -> GraspSlope:
    """Slope of a grasp between BETWEEN, while its force rises to the largest.

    The width is read less often than the force and repeated in between, so it is taken as linear between new readings,
    and regressed on the force, which has the smaller error.

    Raises:
        ValueError: the force passes from one end of BETWEEN to the other within a frame.
    """
    frames, force = np.arange(len(grasp.force)), grasp.force
    new = np.concatenate([[True], np.abs(np.diff(grasp.width)) > FRESH])
    width = np.interp(frames, frames[new], grasp.width[new])
    closing = (frames <= np.argmax(force)) & (force >= BETWEEN[0]) & (force <= BETWEEN[1])
    if closing.sum() < 2 or np.ptp(force[closing]) == 0:
        raise ValueError(
            f"only {int(closing.sum())} frames lie between {BETWEEN[0]:g} and {BETWEEN[1]:g} N while the jaws close; "
            "record more frames a second."
        )
    beyond = force[closing] - force[closing].mean()
    square = float(beyond @ beyond)
    wider = width[closing] - width[closing].mean()
    slope = float(beyond @ wider) / square
    left = wider - slope * beyond
    freedom = max(int((new & closing).sum()), 1)
    sd = float(np.sqrt(left @ left / freedom / square * len(left) / freedom))
    return GraspSlope(-slope, sd, int(closing.sum()))
