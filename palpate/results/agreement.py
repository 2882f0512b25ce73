"""Frames' records brought into agreement with their contact once it has ended."""

from collections.abc import Sequence
from dataclasses import replace

from palpate.estimators.records import FrameEstimate, InteractionEstimate, RelativeForce
from palpate.results.alarm import BELOW, UNKNOWN

LESS = "The whole contact determines less than its frames until here did: see interactions.csv."


def agreed(frame: FrameEstimate, run: InteractionEstimate, force: Sequence[float]) -> FrameEstimate:
    """Return a frame's record that is no surer than its contact, with what a pull or a fit by shading determines.

    Args:
        frame: as it was estimated when it came.
        run: the contact that it may belong to.
        force: the pull's force in this frame over its peak, and the ends of its 90 % interval; NaN where unknown.
    """
    if not frame.contact or frame.time_s < run.onset_time_s:
        return frame
    found, main, verdict = frame.estimate, run.main_estimate, run.verdict or "undetermined"
    known = ";".join(() if main is None else main.determined)
    if main is not None and main is run.grip:
        return replace(frame, verdict=verdict, determined=known, pull=RelativeForce(*force))
    if found is None and main is not None and main is run.estimate and run.estimate.light is not None:
        return replace(frame, estimate=run.estimate, verdict=verdict, determined=known)
    if frame.verdict in ("", "undetermined", "onset_in_view"):
        return frame
    names = () if found is None or main is None else (name for name in found.determined if name in main.determined)
    known = ";".join(names)
    if frame.verdict == verdict or verdict == "determined":
        return frame if found is None else replace(frame, determined=known)
    lowered = verdict if (frame.verdict, verdict) == ("determined", "ratios") else "undetermined"
    alarm, detail = UNKNOWN if frame.alarm == BELOW else frame.alarm, f"{frame.detail} {LESS}".strip()
    return replace(frame, verdict=lowered, determined=known if lowered == "ratios" else "", alarm=alarm, detail=detail)
