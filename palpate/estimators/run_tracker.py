"""Runs of contact, collected frame by frame."""

import math
from collections.abc import Sequence

import numpy as np

from palpate.data.contact.evidence import CERTAIN
from palpate.data.contact.interaction import InteractionBuilder
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.sequence import RestingLight
from palpate.estimators.contract import ClipInfo
from palpate.estimators.records import InteractionEstimate
from palpate.observations.kinds import OBSERVATIONS

NO_ONSET = "The onset of the contact was not observed; without it the rest shape and the load's beginning are unknown."
UNDECIDED = "Contact is not decided: the instrument hovered, and neither motion nor depth shows whether it touches."
RECORDED = ("depth", "shading")
"""Observations that are recorded of every run where they can be."""


class Run:
    """One run of contact; its frames are dropped as they pass, and only their observations are kept."""

    def __init__(
        self,
        first: PreparedFrame,
        clip: ClipInfo,
        seconds: float,
        rest_light: RestingLight | None = None,
        observations: Sequence[str] = RECORDED,
    ) -> None:
        frame = first.frame
        self.index, self.number, self.time_s, self.detail = frame.index, frame.number, frame.time_s, first.detail
        """Index in the clip, number, time stamp [s] and warnings of the first frame."""
        self.instrument = first.instrument
        """Number of the instrument that touches."""
        self.last = frame.index
        """Index of the last frame in contact."""
        self.contact = math.nan
        """Largest probability of contact so far."""
        self.hovered = False
        """True if the tool was found to hover within the run or right after it."""
        self.undecided = False
        """True if contact is undecided in a frame of the run."""
        self.builder: InteractionBuilder | None = None
        """Builder of the interaction from its observations; None where the onset was not observed."""
        self.lit = rest_light is not None
        """True if the run's light is compared with that at rest; it may be a pull, then, as nothing else is
        measured."""
        self.note(first)
        contact = first.geometry
        if contact is not None and first.track_start == frame.index:
            found = contact.mesh, contact.vertex, contact.normal, contact.noise
            begun = {name: OBSERVATIONS[name].recorder(first, clip.size, rest_light) for name in observations}
            recorders = {name: recorder for name, recorder in begun.items() if recorder is not None}
            self.builder = InteractionBuilder(*found, first, clip.geometry, seconds, recorders)

    def note(self, current: PreparedFrame) -> None:
        """Take in the contact probability of a frame within the run or right after it."""
        self.contact = float(np.fmax(self.contact, current.contact_probability))
        self.hovered |= current.hovers
        self.undecided |= current.undecided

    @property
    def passed(self) -> bool:
        """True if the tool only passed over the tissue: it hovered all the time, and contact was never likely."""
        return self.hovered and not self.undecided and not self.contact >= CERTAIN

    def add(self, current: PreparedFrame) -> None:
        """Add a frame of the run, in contact or followed after it."""
        if current.in_contact:
            self.last = current.frame.index
        if self.builder is not None:
            self.builder.add(current)

    def estimate(self, **results) -> InteractionEstimate:
        """Return the run's record, with the results of an estimator as fields of `InteractionEstimate`."""
        load = None if self.builder is None else self.builder.load_seconds
        return InteractionEstimate(self.index, self.number, self.time_s, load, **results, instrument=self.instrument)

    @property
    def unobserved(self) -> str:
        """Reason why nothing can be estimated of a run without observations, or without contact."""
        if self.passed:
            return "No contact: the instrument moves, and the tissue next to it does not move with it."
        if self.builder is None:
            doubt = UNDECIDED if self.undecided and not self.contact >= CERTAIN else ""
            return f"{doubt} {self.detail or NO_ONSET}".strip()
        return f"{self.detail} The tissue at the contact could not be followed after its onset.".strip()


class RunTracker:
    """Tracker of a clip's runs of contact.

    Args:
        clip: the clip.
        seconds: longest motion of a run that counts, from its onset [s].
        observations: names of those that are recorded.
    """

    def __init__(self, clip: ClipInfo, seconds: float, observations: Sequence[str] = RECORDED) -> None:
        self._clip, self._seconds, self._observations = clip, seconds, observations
        self._light, self._reference = RestingLight(), 0
        """Light at rest, and the number of the picture in whose view it is."""
        self.current: Run | None = None
        """The current run, after its release as well, as long as its tissue is followed."""

    def push(self, frame: PreparedFrame) -> Run | None:
        """Pass the next frame; returns the run that has ended before it, or None."""
        if frame.light_view is not None and frame.light_view.reference != self._reference:
            self._reference = frame.light_view.reference
            self._light.clear()
        ended = self._push(frame)
        if self.current is None and frame.make_light is not None:
            self._light.push(frame.make_light)
        return ended

    def _push(self, frame: PreparedFrame) -> Run | None:
        run = self.current
        if run is not None:
            if frame.frame.index - run.last <= self._clip.bridge_frames + 1:
                run.note(frame)
            if self._belongs(frame, run):
                run.add(frame)
                return None
            missing = frame.frame.index - run.last
            if run.builder is None and not frame.in_contact and missing <= self._clip.bridge_frames:
                return None  # the gap may be flicker
        what = self._clip, self._seconds, self._light if len(self._light) else None, self._observations
        self.current = Run(frame, *what) if frame.in_contact else None
        return run

    def _belongs(self, frame: PreparedFrame, run: Run) -> bool:
        if run.builder is not None:
            return frame.track_start == run.index
        missing = frame.frame.index - run.last - 1
        return frame.in_contact and frame.track_start < 0 and missing <= self._clip.bridge_frames

    def finish(self) -> Run | None:
        """Return the run that the clip's end has cut off, or None."""
        run, self.current = self.current, None
        return run
