"""What the motion around an instrument tells that holds tissue, and what of it is determined."""

import math
from dataclasses import dataclass, field

import numpy as np

from palpate.estimators.estimate import LEAST_SKILL, NINETY
from palpate.estimators.grip.sheet import WIDENS, SheetMotion
from palpate.estimators.grip.stiffness_fit import StiffnessField
from palpate.physics.identifiability import LIMIT

LEAST_LEAD = 0.1
"""Over the skill of the same model with tissue far from the instrument as its grip: any motion spreads smoothly."""

NO_SHEET = "stiffening, not determined: the motion is no sheet's of one stiffness, as of uneven or stiffening tissue"
WIDENING = "stiffening, not determined: larger pulls spread farther, as where tissue stiffens or comes to rest late"


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
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    """Followed tissue at rest, to draw a map where it is by then, shape [N, 2] [px of the map's picture]."""
    moved: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 2)))
    """Its displacement at the times, not a number where it is lost, shape [T, N, 2], float32 [px]."""
    sheet: SheetMotion | None = None
    """How the sheet moves at the times; None where it does not explain the motion to within the noise."""
    widens: float = 0.0
    """As of `FoundationFit`."""

    @property
    def explained(self) -> bool:
        """Whether the tissue moves with the instrument as a sheet would, and not with something else."""
        return self.skill >= max(LEAST_SKILL, self.rival + LEAST_LEAD)

    @property
    def verdict(self) -> str:
        """`foundation`, `relative_force` or `undetermined`."""
        if "foundation_over_stiffness" in self.determined:
            return "foundation"
        return "relative_force" if "relative_force" in self.determined else "undetermined"

    @property
    def explanation(self) -> str:
        """Why stiffening isn't determined; empty where a linear sheet holds for all pulls."""
        return WIDENING if self.widens > WIDENS else NO_SHEET * (self.explained and self.sheet is None)

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of what is determined."""
        if not self.explained:
            return ()
        known = {
            "foundation_over_stiffness": self._width("foundation_over_stiffness") < LIMIT,
            "relative_force": np.isfinite(self.force).all() and self.force_sd.max() < LIMIT,
            "stiffness_ratios": self.stiffness is not None and self.stiffness.tells,
        }
        return tuple(name for name, sure in known.items() if sure)

    def _width(self, name: str) -> float:
        """Standard deviation of the logarithm that a quantity's 90 % interval says."""
        return math.log(getattr(self, f"{name}_high") / getattr(self, f"{name}_low")) / (2 * NINETY)
