"""The alarm of `infer.py --force-limit`: whether the upper end of the force's interval has reached a limit.

Research software, not a medical device: no alarm does not mean that a force is safe.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palpate.estimators.estimate import PressResult
from palpate.estimators.records import FrameEstimate

BELOW, ABOVE, UNKNOWN = "below", "above", "unknown"
NO_CONTACT = "no_contact"
"""What run.json calls frames without any; their state is empty."""
STATES = (NO_CONTACT, BELOW, ABOVE, UNKNOWN)
"""What run.json counts."""


@dataclass
class ForceAlarm:
    """Takes the frames of a clip in order and says of each whether the force has reached a limit.

    Args:
        limit: of the force's magnitude [`unit`].
        unit: N, or the unit of the column `force`.
        seconds: an estimate is of so much after the onset of contact; what the force is later is unknown [s].
    """

    limit: float
    unit: str
    seconds: float
    alarms: int = 0
    """How often the upper end has reached the limit."""
    frames: Counter[str] = field(default_factory=Counter)
    """Number of frames of each of STATES."""

    def __post_init__(self) -> None:
        self.end_run()

    def end_run(self) -> None:
        """The run of contact has ended; the next frame in contact is the onset of another."""
        self._onset, self._above = np.nan, False

    def watch(
        self, frame: FrameEstimate, upper_end: Callable[[PressResult], float | None] | None = None
    ) -> FrameEstimate:
        """Return the frame's estimate with its state, by `upper_end` of the force (default: `upper_force`)."""
        upper = None if frame.estimate is None else (upper_end or upper_force)(frame.estimate)
        return replace(frame, alarm=self.push(frame.time_s, frame.contact, upper))

    def push(self, time_s: float, contact: bool | None, upper: float | None) -> str:
        """The state of the next frame: BELOW, ABOVE or UNKNOWN, and empty where nothing touches the tissue.

        An alarm outlasts frames whose force is unknown within its run of contact.

        Args:
            time_s: time stamp [s].
            contact: whether tool and tissue touch; None = undecided, which counts as contact of unknown force.
            upper: upper end of the 90 % interval of the force's magnitude [`unit`]; None = the force isn't determined.
        """
        if contact and np.isnan(self._onset):
            self._onset = time_s
        state = "" if contact is False else UNKNOWN
        if contact and upper is not None and time_s - self._onset <= self.seconds + 1e-6:
            # An alarm ends when the upper end falls under nine tenths of the limit.
            above = upper >= self.limit * (0.9 if self._above else 1)
            self.alarms += above and not self._above
            self._above, state = above, ABOVE if above else BELOW
        self.frames[state or NO_CONTACT] += 1
        return state

    def record(self) -> dict[str, Any]:
        """What run.json keeps: the limit, the number of alarms, and the number of frames of each state."""
        frames = {state: self.frames[state] for state in STATES}
        return {"limit": self.limit, "unit": self.unit, "alarms": self.alarms, "frames": frames}

    def sentence(self) -> str:
        """Return the alarms in words."""
        return (
            f"the force reached the limit {self.limit:g} in {self.unit}: {self.alarms} times; it is unknown, neither "
            f"safe nor unsafe, in {self.frames[UNKNOWN]} of {self.frames.total()} frames; research software, not a "
            "medical device"
        )


def upper_force(found: PressResult) -> float | None:
    """Upper end of the 90 % interval of |F| [scene units]; None where the force isn't determined."""
    force = found.quantity("force") if "force" in found.determined else None
    return None if force is None else float(force.end(1))
