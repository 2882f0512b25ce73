"""Contact in every frame of a clip, by whether tissue moves with the instrument; depth is not looked at."""

from __future__ import annotations

from data.contact.evidence import THRESHOLD, ContactEvidence
from evaluation.real.pulled import PulledClip, read_views


def contact_measures(clip: PulledClip) -> dict[str, object]:
    """Probability of contact in every frame that shows an instrument, by the frame's number, and the share in contact.

    Raises:
        InputError: the clip can't be read.
    """
    found: dict[str, object] = {}
    evidence, last = ContactEvidence(), None
    shown = touching = 0
    for number, picture, tool in read_views(clip):
        if picture is None or isinstance(tool, str) or not tool.any():
            continue
        if last is not None and number - last != 1:
            evidence = ContactEvidence()
        last = number
        probability = evidence.push(picture, tool)
        shown, touching = shown + 1, touching + (probability >= THRESHOLD)
        found[f"contact_frame_{number:04d}"] = probability
    return {"frames in contact": touching / shown if shown else float("nan")} | found
