"""Relative force of a pull from the motion around an instrument, if a sheet explains that motion."""

from dataclasses import dataclass

import numpy as np

from palpate.estimators.result import ENDS, LEAST_SKILL
from palpate.physics.identifiability import LIMIT, NINETY

LEAST_LEAD = 0.1
"""Least lead over the skill of a grip far from the instrument: any motion spreads smoothly."""
HELD = 0.01
"""Constant in `force_error`: the ratio of equal forces is uncertain, too."""


@dataclass(frozen=True, eq=False)
class PullResult:
    """Fit of a sheet on a foundation to a pull; T frames that move.

    A displacement alone determines neither k_s nor k_d nor a force in any unit.
    """

    skill: float
    """Skill, 1 - error / motion, in frames that were not fitted: 0 as if nothing moved, 1 = exact."""
    rival: float
    """Skill if the most moving tissue far from the instrument is taken as the grip instead; -∞ where none moves."""
    times: np.ndarray
    """Time since the run's first frame, shape [T] [s]."""
    force: np.ndarray
    """Force at the grip over that of the last frame, along its direction, shape [T]."""
    force_sd: np.ndarray
    """Standard deviation of `force`, shape [T]; 0 in the last frame."""
    explanation: str = ""

    @property
    def explained(self) -> bool:
        """True if the tissue moves with the instrument as a sheet would."""
        return self.skill >= max(LEAST_SKILL, self.rival + LEAST_LEAD)

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of what is determined."""
        return ("relative_force",) if self.explained and self.force_sd.max() < LIMIT else ()

    @property
    def verdict(self) -> str:
        """`relative_force` or `undetermined`."""
        return "relative_force" if self.determined else "undetermined"

    @property
    def curves(self) -> np.ndarray:
        """Force and the ends of its 90 % interval, shape [3, T]."""
        return self.force + np.outer([*ENDS.values()], NINETY * self.force_sd)


def force_error(force: np.ndarray, skill: float) -> np.ndarray:
    """Return the model's error of relative forces [T] up to a factor, proportional to what the sheet leaves.

    The error is least at rest and at the last frame's force, where the ratio is 0 and 1 for any tissue.
    """
    return (1 - skill) * np.sqrt(np.abs(force * (1 - force)) + HELD)
