"""The force of every run of contact, forces.json: mean, peak, and the time for which it is unknown.

A press's force is its estimate's, as long as that was observed; a pull's comes from the motion around the instrument.
It is in newtons where something tells them, else relative to the run's own peak.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.common.files import as_json
from palpate.estimators.estimate import PressResult
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.result import ENDS, Quantity
from palpate.physics.load import PressShape
from palpate.results import store
from palpate.results.artefacts.base import Artefact
from palpate.results.verdicts import NOTES, state

RELATIVE = "of this contact's own peak (relative, not N)"
SAME_INSTANT = 1e-6
"""Times nearer to each other than this are one [s]."""
LATER = "What the force is after the part of the contact that was observed and estimated is not known."


class ForceFile(Artefact):
    """forces.json."""

    name = store.REPORT

    def finish(self) -> None:
        self.path.write_text(as_json(self.clip.report()) + "\n", encoding="utf-8")


@dataclass(frozen=True, eq=False)
class ContactForce:
    """The force of a run of contact in its T frames in contact; not a number where it is unknown."""

    onset_frame: int
    onset_time_s: float
    verdict: str
    frames: np.ndarray
    """Indices of those frames in the clip, shape [T]."""
    curves: np.ndarray
    """Force along that of the last frame and the ends of its 90 % interval, shape [3, T], in `unit`; of a press over
    its F, without interval."""
    unit: str
    why: str
    """Reason why it is unknown somewhere."""
    pressed: np.ndarray
    """Force profile of a press, its force over F, where that was observed, shape [T]: with F it is the force."""
    direction: np.ndarray | None
    """Unit vector of a press's force on the tissue, shape [3], in the camera's axes; nobody knows a pull's."""
    ratio: Quantity | None
    """|F|/k_s of a press [scene units]; None where it isn't determined."""

    @classmethod
    def of(
        cls,
        run: InteractionEstimate,
        estimates: Sequence[FrameEstimate],
        newtons: np.ndarray | None = None,
        seconds: float = math.inf,
    ) -> "ContactForce":
        """Return the force of a run that has ended.

        Args:
            run: the run.
            estimates: of all frames so far, by index in the clip.
            newtons: force of a pull where its fit has it, and the ends of its 90 % interval, shape [3, K] [N].
            seconds: time after the onset up to which an estimate by depth constrains the force [s].
        """
        begun = bisect_left(estimates, run.onset_time_s - SAME_INSTANT, key=lambda estimate: estimate.time_s)
        touched = [index for index in range(begun, len(estimates)) if estimates[index].contact is not False]
        while touched and not estimates[touched[-1]].contact:
            touched.pop()
        found, times = run.main_estimate, np.array([estimates[index].time_s for index in touched])
        curves, pressed = np.full((3, len(touched)), np.nan), np.full(len(touched), np.nan)
        unit, why, direction, ratio = "", run.detail or "Nothing is determined of the force.", None, None
        press, pull = run.estimate, run.grip
        if run.field is not None:
            why = "--estimator online tells no force."
        elif pull is not None and found is pull:
            unit = RELATIVE if newtons is None else "N, by the force that was measured for a while"
            why = "Frames without a picture, or in which too little moves, tell no force."
            curves = _between(run.onset_time_s + pull.times, pull.curves if newtons is None else newtons, times)
        elif press is not None:
            direction = None if run.interaction is None else np.sign(press.theta[2]) * run.interaction.direction
            pressed = _pressed(run, press, times - run.onset_time_s, seconds)
            if "force_over_stiffness" in press.determined and press.light is None:
                ratio = press.quantity("force_over_stiffness")
            if any(name.startswith("force") for name in press.determined):
                curves[0], unit, why = pressed, RELATIVE, LATER
            elif press.given_verdict:
                why = NOTES[run.verdict].text
        place = run.onset_frame, run.onset_time_s, state(run)
        return cls(*place, np.array(touched, int), curves, unit, why, pressed, direction, ratio)

    def in_newtons(self, row: Mapping[str, Any]) -> "ContactForce":
        """Convert a press's force to newtons by its row of calibrated.csv; unchanged where that does not determine the
        force."""
        if "force" not in row.get("determined", "").split(";") or not np.isfinite(self.pressed).any():
            return self
        curves = np.stack([self.pressed * row.get(f"force{end}", math.nan) for end in ENDS])
        return replace(self, curves=curves, unit=row["force_unit"], why=LATER)

    @property
    def relative(self) -> np.ndarray:
        """The force over its peak and the ends of its 90 % interval, shape [3, T]."""
        curves = self.curves
        peak = max(curves[0, np.isfinite(curves[0])], key=abs, default=0.0)
        if not peak:
            return curves
        return np.concatenate([curves[:1] / peak, np.sort(curves[1:] / peak, axis=0)])

    def record(self, estimates: Sequence[FrameEstimate], lasts: np.ndarray) -> dict[str, Any]:
        """Return the entry of the run in forces.json.

        Args:
            estimates: of all of the clip's frames.
            lasts: how long each of those lasts, shape [N] [s].
        """
        seconds, known = lasts[self.frames], np.isfinite(self.curves[0])
        curves = self.relative if self.unit == RELATIVE else self.curves
        # What not every contact has; null where it lacks.
        optional = [f"{name}{end}" for name in ("mean", "peak", "force_over_stiffness_mm") for end in ENDS]
        found: dict[str, Any] = dict.fromkeys([*optional, "peak_time_s", "metric_by"])
        if known.any():
            top = int(np.nanargmax(np.abs(curves[0])))
            means = curves[:, known] @ seconds[known] / seconds[known].sum()
            for name, values in (("mean", means), ("peak", curves[:, top])):
                found |= {f"{name}{end}": value for end, value in zip(ENDS, values, strict=True)}
            found["peak_time_s"] = estimates[self.frames[top]].time_s
        found |= {name: getattr(self, name) for name in ("onset_frame", "onset_time_s", "verdict", "direction")}
        found |= {"unit": self.unit if known.any() else "", "why": "" if known.all() and len(known) else self.why}
        for name, some in (("contact", known | ~known), ("unknown", ~known)):
            found |= {f"{name}_frames": some.sum(), f"{name}_s": seconds[some].sum()}
        found |= {"time_s": [estimates[index].time_s for index in self.frames], "frame_s": seconds}
        return found | {f"force{end}": curve for end, curve in zip(ENDS, curves, strict=True)}

    def in_millimetres(self, length: ClipLength | None) -> dict[str, Any]:
        """Return |F|/k_s in millimetres, where a scene unit's length is known.

        The errors of both are independent of each other, so that their logarithms' variances add up.
        """
        if length is None or length.metres is None or self.ratio is None or not self.ratio.value > 0:
            return {}
        mm = Quantity(1000 * length.metres * self.ratio.value, math.hypot(self.ratio.log_sd, length.log_sd))
        found = {f"force_over_stiffness_mm{end}": mm.end(side) for end, side in ENDS.items()}
        return found | {"metric_by": length.by}


def forces_record(
    contacts: Sequence[ContactForce],
    estimates: Sequence[FrameEstimate],
    fps: float,
    calibrated: Sequence[Mapping[str, Any]] = (),
    length: ClipLength | None = None,
) -> dict[str, Any]:
    """Return the content of forces.json.

    Args:
        contacts: the clip's runs of contact.
        estimates: of its frames.
        fps: the last frame lasts as long as one of so many a second; all others last until the next one's time stamp.
        calibrated: rows of calibrated.csv, one a run of contact.
        length: of a scene unit.
    """
    times = np.array([estimate.time_s for estimate in estimates])
    lasts = np.diff(times, append=times[-1:] + 1 / fps)
    rows = {row["onset_frame"]: row for row in calibrated}
    scaled = [contact.in_newtons(rows.get(contact.onset_frame, {})) for contact in contacts]
    records = [contact.record(estimates, lasts) | contact.in_millimetres(length) for contact in scaled]
    return {"notice": "Research software, not a medical device.", "contacts": records}


def _pressed(run: InteractionEstimate, found: PressResult, since: np.ndarray, seconds: float) -> np.ndarray:
    """Return a press's force over F at times since the onset, shape [T]; not a number after its last observation."""
    shape, (delay, release) = found.course.shape or PressShape(), found.course.delays
    last, contact = math.inf if found.light else seconds, run.interaction
    observed = None if contact is None else contact.shading if found.light else contact.observation
    if observed is not None and len(observed.times):
        last = min(last, observed.times[-1])
    end = math.inf if run.load_s is None else run.load_s + release - shape.fall
    factor = _risen(since - delay, shape.rise) - _risen(since - end, shape.fall)
    return np.where(since <= last + SAME_INSTANT, factor, np.nan)


def _risen(since: np.ndarray, duration: float) -> np.ndarray:
    """Return the share of a ramp of some duration that has risen since it began, shape as given."""
    return np.clip(since / duration, 0, 1) if duration else (since >= -SAME_INSTANT).astype(np.float64)


def _between(kept: np.ndarray, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return curves [C, K] at other times, shape [C, T]; not a number where frames are missing.

    Of a long pull every n-th frame is kept, and the force between two of them that follow on is on the line between.
    """
    after = np.minimum(np.searchsorted(kept, times - SAME_INSTANT), len(kept) - 1)
    gaps = np.diff(kept, prepend=-math.inf)
    near = np.abs(kept[after] - times) <= SAME_INSTANT
    inside = near | ((gaps[after] <= 1.5 * gaps.min()) & (times <= kept[-1]))
    return np.where(inside, [np.interp(times, kept, each) for each in values], np.nan)
