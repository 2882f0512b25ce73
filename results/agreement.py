"""Frames' records brought into agreement with their contact once it has ended."""

import dataclasses
import math
from collections.abc import Sequence

from palpate.estimators.estimate import Estimate
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.results.alarm import BELOW, UNKNOWN

LESS = "The whole contact determines less than its frames until here did: see interactions.csv."
REVISED = ("verdict", "determined", "relative_force", "relative_force_low", "relative_force_high", "detail", "alarm")
"""Columns of parameters.csv that may change when a contact ends."""


def agreed(frame: FrameEstimate, run: InteractionEstimate, force: Sequence[float]) -> FrameEstimate:
    """Return a frame's record that is no surer than its contact, with what a pull or a fit by shading determines.

    Args:
        frame: as it was estimated when it came.
        run: the contact that it may belong to.
        force: the pull's force in this frame over its peak, and the ends of its 90 % interval; NaN where unknown.
    """
    if not frame.contact or frame.time_s < run.onset_time_s:
        return frame
    main = run.main_estimate
    if isinstance(main, GripEstimate) and main.determined:
        value, low, high = (None if math.isnan(each) else float(each) for each in force)
        relative = {"relative_force": value, "relative_force_low": low, "relative_force_high": high}
        return dataclasses.replace(frame, verdict=main.verdict, determined=";".join(main.determined), **relative)
    found, verdict = frame.estimate, run.verdict or "undetermined"
    if found is None and isinstance(main, Estimate) and main.by_light:
        return dataclasses.replace(frame, estimate=main, verdict=verdict, determined=";".join(main.determined))
    if frame.verdict in ("", "undetermined", "onset_in_view"):
        return frame
    names = () if found is None or main is None else (name for name in found.determined if name in main.determined)
    known = ";".join(names)
    if frame.verdict == verdict or verdict == "determined":
        return frame if found is None else dataclasses.replace(frame, determined=known)
    lowered = verdict if (frame.verdict, verdict) == ("determined", "ratios") else "undetermined"
    alarm = UNKNOWN if frame.alarm == BELOW else frame.alarm
    changed = {"verdict": lowered, "determined": known if lowered == "ratios" else "", "alarm": alarm}
    return dataclasses.replace(frame, detail=f"{frame.detail} {LESS}".strip(), **changed)
