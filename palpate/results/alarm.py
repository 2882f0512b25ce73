"""The alarm of `infer.py --force-limit`: the probability that the force is above a limit, with two thresholds.

Research software, not a medical device: no alarm does not mean that a force is safe.
"""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import ndtr

from palpate.estimators.estimate import PressResult
from palpate.estimators.records import FrameEstimate
from palpate.estimators.result import Quantity

BELOW, ABOVE, UNKNOWN = "below", "above", "unknown"


@dataclass
class ForceAlarm:
    """Alarm that takes the frames of a clip in order and tests whether the force is above a limit.

    A crossing that is missed costs (1 - raised)/raised times what a false alarm does, where `raised` is chosen well.

    Args:
        limit: of the force's magnitude [`unit`].
        unit: N, or the unit of the column `force`.
        seconds: an estimate is of so much after the onset of contact; what the force is later is unknown [s].
        raised: probability that the force is above the limit from which on there is an alarm.
        cleared: probability below which an alarm ends, and a force is below the limit; from there to `raised` it is
            unknown without an alarm.
    """

    limit: float
    unit: str
    seconds: float
    raised: float = 0.9
    cleared: float = 0.5
    alarms: int = 0
    """Number of times that the probability has reached `raised`."""
    frames: Counter[str] = field(default_factory=Counter)
    """Number of frames of each state."""

    def __post_init__(self) -> None:
        self.end_run()

    def end_run(self) -> None:
        """Forget the run of contact, which has ended; the next frame in contact is the onset of another."""
        self._onset, self._above = np.nan, False

    def watch(
        self, frame: FrameEstimate, force_of: Callable[[PressResult], Quantity | None] | None = None
    ) -> FrameEstimate:
        """Return the frame's estimate with its state, by `force_of` it (default: `known_force`)."""
        force = None if frame.estimate is None else (force_of or known_force)(frame.estimate)
        return replace(frame, alarm=self.push(frame.time_s, frame.contact, self.probability(force)))

    def probability(self, force: Quantity | None) -> float | None:
        """Return the probability that a force's magnitude is above the limit; None where it isn't determined."""
        return None if force is None else float(ndtr(math.log(abs(force.value) / self.limit) / force.log_sd))

    def push(self, time_s: float, contact: bool | None, probability: float | None) -> str:
        """Return the state of the next frame: BELOW, ABOVE or UNKNOWN, and empty where nothing touches the tissue.

        An alarm outlasts frames whose force is unknown within its run of contact.

        Args:
            time_s: time stamp [s].
            contact: whether tool and tissue touch; None = undecided, which counts as contact of unknown force.
            probability: as in `probability`.
        """
        if contact and np.isnan(self._onset):
            self._onset = time_s
        state = "" if contact is False else UNKNOWN
        if contact and probability is not None and time_s - self._onset <= self.seconds + 1e-6:
            above = probability >= (self.cleared if self._above else self.raised)
            self.alarms += above and not self._above
            self._above, state = above, ABOVE if above else BELOW if probability < self.cleared else UNKNOWN
        self.frames[state or "no_contact"] += 1
        return state

    def record(self) -> dict[str, Any]:
        """Return the entry of run.json: the limit, the number of alarms, and the number of frames of each state."""
        frames = {state: self.frames[state] for state in ("no_contact", BELOW, ABOVE, UNKNOWN)}
        given = {"limit": self.limit, "unit": self.unit, "raised": self.raised, "cleared": self.cleared}
        return given | {"alarms": self.alarms, "frames": frames}

    def sentence(self) -> str:
        """Return the alarms in words."""
        reached = f"the force reached the limit {self.limit:g} in {self.unit}: {self.alarms} times"
        unknown = f"unknown, neither safe nor unsafe, in {self.frames[UNKNOWN]} of {self.frames.total()} frames"
        return f"{reached}; it is {unknown}; research software, not a medical device"


def known_force(found: PressResult) -> Quantity | None:
    """Return |F| [scene units]; None where it isn't determined."""
    return found.quantity("force") if "force" in found.determined else None
