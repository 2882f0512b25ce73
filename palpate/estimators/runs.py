"""Runs of contact, collected frame by frame: the part of a session that all estimators share."""

import contextlib
import dataclasses
import math
import time
from collections import defaultdict, deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Executor, Future
from functools import cache, partial
from typing import ClassVar

import numpy as np

from palpate.data.contact.evidence import CERTAIN
from palpate.data.contact.geometry import FrameGeometry
from palpate.data.contact.interaction import Horizon, Interaction, InteractionBuilder
from palpate.data.contact.tissue_points import grid_to_picture
from palpate.data.prepared import OUT_OF_CONTACT, PreparedFrame
from palpate.data.shading.light import log_light
from palpate.data.shading.sequence import RestingLight
from palpate.estimators.contract import ClipInfo
from palpate.estimators.direct.shading_fit import MECHANICS, fit_shading
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.estimators.grip.recorder import GripRecorder
from palpate.estimators.records import FrameEstimate, InteractionEstimate, Touch
from palpate.observations.kinds import OBSERVATIONS
from palpate.physics.mechanics import Bounds, Mechanics

NO_ONSET = "The onset of the contact was not observed; without it the rest shape and the load's beginning are unknown."
UNDECIDED = "Contact is not decided: the instrument hovered, and neither motion nor depth shows whether it touches."
PASSED = "No contact: the instrument moves, and the tissue next to it does not move with it."
OUTLINES_ALONE = "Contact by outlines alone: nothing has moved yet that would show whether tissue moves with the tool."
NOT_FOLLOWED = "The tissue at the contact could not be followed after its onset."
RECORDED = ("depth", "shading")
"""Observations that are recorded of every run where they can be."""
WHOLE = "Whole runs of contact are fitted, when they have ended: see interactions.csv."


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
        """Whether the tool was found to hover within the run or right after it."""
        self.undecided = False
        """Whether the run begins or goes on in a frame where contact is not decided."""
        self.builder: InteractionBuilder | None = None
        """Builder of the interaction from its observations; None where the onset was not observed."""
        self.lit = rest_light is not None
        """Whether its light is compared with that at rest; it may be a pull, then, as nothing else is measured."""
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
        """Whether the tool only passed over the tissue: it hovered all the time, and contact was never likely."""
        return self.hovered and not self.undecided and not self.contact >= CERTAIN

    def add(self, current: PreparedFrame) -> None:
        """Add a frame of the run, in contact or followed after it."""
        if current.in_contact:
            self.last = current.frame.index
        if self.builder is not None:
            self.builder.add(current)

    def estimate(self, **results) -> InteractionEstimate:
        """The run's record, with the results of an estimator as fields of `InteractionEstimate`."""
        load = None if self.builder is None else self.builder.load_seconds
        return InteractionEstimate(self.index, self.number, self.time_s, load, **results, instrument=self.instrument)

    @property
    def unobserved(self) -> str:
        """Why nothing can be estimated of a run without observations, or without contact."""
        if self.passed:
            return PASSED
        if self.builder is None:
            doubt = UNDECIDED if self.undecided and not self.contact >= CERTAIN else ""
            return f"{doubt} {self.detail or NO_ONSET}".strip()
        return f"{self.detail} {NOT_FOLLOWED}".strip()


class RunTracker:
    """Follows a clip's runs of contact.

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
        rest = self._light if len(self._light) else None
        what = self._clip, self._seconds, rest, self._observations
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


class RunSession:
    """The common part of all estimators' sessions: the clip's runs of contact, and the record of each at its end.

    Args:
        clip: the clip.
        mechanics: constants of the estimator's simulator.
        horizon: how much of a whole contact counts.
        observations: names of those that are recorded of it.
    """

    follows_all: ClassVar = False
    """Whether the motion around the instrument is recorded of every run, not only where depth may tell nothing."""

    def __init__(
        self, clip: ClipInfo, mechanics: Mechanics, horizon: Horizon = None, observations: Sequence[str] = RECORDED
    ) -> None:
        self.clip, self.horizon = clip, horizon
        self.mechanics = mechanics.matched(1 / clip.fps)
        """The simulator, its steps matched to the clip's frame rate."""
        self.lit_mechanics = MECHANICS.matched(1 / clip.fps)
        """Mechanics of estimates by light."""
        self.by_light = False
        """Whether a press is estimated by the light of the tissue, where it is known."""
        self.needs_light = False
        """Whether that light is looked at although depth is measured."""
        self.seconds: dict[str, float] = defaultdict(float)
        """Time spent so far by stage [s]."""
        self.fitter: Executor | None = None
        """Executor of the fits by shading, for live sources; None = later frames wait for them."""
        self._fits: deque[Future[InteractionEstimate]] = deque()
        self._runs = RunTracker(clip, self.mechanics.seconds, observations)
        self._grip: GripRecorder | None = None

    @contextlib.contextmanager
    def timed(self, stage: str) -> Generator[None, None, None]:
        """Add the time that is spent within to that of a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - start

    def finish(self) -> Iterator[FrameEstimate | InteractionEstimate]:
        """Yield the record of the run that the clip's end has cut off, after those that are still being fitted."""
        yield from self._ended(self._runs.finish())
        yield from (fit.result() for fit in self._fits)

    def _pushed(self, frame: PreparedFrame) -> Run | None:
        """Pass the next frame to the clip's runs; returns the one that has ended before it, or None."""
        if self.needs_light and frame.visible and frame.make_light is None:
            shown = frame.shown.picture, frame.shown.labels
            # The frame itself stays as it is: others may look at it.
            frame = dataclasses.replace(frame, make_light=cache(partial(log_light, *shown, frame.depth.shape)))
        return self._runs.push(frame)

    def _follow(self, frame: PreparedFrame) -> None:
        """Record the motion around the instrument, too; sessions that estimate grips call this after every frame."""
        run = self._runs.current
        with self.timed("follow"):
            # A run without an onset has no other observation.
            if run is None or not (self.follows_all or run.builder is None or (self.by_light and run.lit)):
                self._grip = None
            elif run.index == frame.frame.index:
                self._grip = GripRecorder(frame) if frame.visible else None
            elif self._grip is not None and frame.frame.index - run.last <= self.clip.bridge_frames:
                self._grip.add(frame)

    def _ended(self, run: Run | None) -> Iterator[InteractionEstimate]:
        """Yield the record of a run that has ended, once it is fitted."""
        if run is not None:
            recorder, self._grip = self._grip, None
            if self.fitter is not None and self.by_light and run.lit:
                self._fits.append(self.fitter.submit(self._recorded, run, recorder))
            else:
                yield self._recorded(run, recorder)
        while self._fits and self._fits[0].done():
            yield self._fits.popleft().result()

    def _recorded(self, run: Run, recorder: GripRecorder | None) -> InteractionEstimate:
        """Return the record of a run: of the press, and of the grip where the press is undetermined."""
        if run.passed:
            return run.estimate(detail=run.unobserved)
        record = self._pressed(run)
        if recorder is not None and record.verdict in ("", "undetermined"):
            record = self._gripped(record, recorder, run.builder is None)
        return record

    def _pressed(self, run: Run) -> InteractionEstimate:
        contact = None if run.builder is None else run.builder.build(self.mechanics, self.horizon)
        if contact is None or not (len(contact.observation) or contact.shows_light):
            return run.estimate(detail=run.unobserved)
        mechanics = self.mechanics
        try:
            if self.by_light and contact.shows_light:
                mechanics = self.lit_mechanics
                with self.timed("fit"):
                    contact, found, simulated = fit_shading(contact, 1 / self.clip.fps)
                doubts = found.refuted
            else:
                found, simulated, doubts = self._whole(contact)
        except NoEstimate as reason:
            return run.estimate(interaction=contact, detail=f"{run.detail} {reason}".strip())
        detail = f"{run.detail} {doubts}".strip()
        results = {"interaction": contact, "estimate": found, "mechanics": mechanics, "simulated": simulated}
        return run.estimate(**results, detail=detail)

    def _gripped(self, record: InteractionEstimate, recorder: GripRecorder, only: bool) -> InteractionEstimate:
        """The record of a run with the estimate of its grip; failures are reported if that is the `only` estimate."""
        found, sentence = None, ""
        try:
            with self.timed("grip"):
                found = recorder.estimate()
        except NoEstimate as reason:
            sentence = str(reason) if only else ""
        if found is not None and not found.explained:
            elsewhere = f", gripped elsewhere {found.rival:.2f}" if math.isfinite(found.rival) else ""
            why = f"skill {found.skill:.2f}{elsewhere}"
            sentence = f"A sheet gripped by the instrument doesn't explain the motion ({why})."
        elif found is not None and not found.determined:
            sentence = "A gripped sheet explains the motion, but the force over time is too uncertain."
        return dataclasses.replace(record, grip=found, detail=f"{record.detail} {sentence}".strip())

    def _whole(self, contact: Interaction) -> tuple[PressResult, tuple[np.ndarray, np.ndarray], str]:
        """The estimate of a whole contact, the simulated motion as an `InteractionEstimate` has it, and doubts.

        Raises:
            NoEstimate: the contact can't be estimated.
        """
        raise NotImplementedError


def frame_estimate(
    prepared: PreparedFrame,
    clip: ClipInfo,
    estimate: PressResult | None = None,
    *,
    verdict: str = "",
    lengths: tuple[float | None, float | None] = (None, None),
    doubts: str = "",
    whole: bool = False,
    arrow: np.ndarray | None = None,
) -> FrameEstimate:
    """The record of a frame; without an estimate it holds the status and the contact only.

    Args:
        prepared: the frame.
        clip: its clip.
        estimate: the frame's estimate.
        verdict: verdict of a frame without an estimate.
        lengths: lengths of the simulated and the observed displacement [scene units].
        doubts: sentences on why the estimate may be wrong, put after the frame's own.
        whole: whether the doubts already say why no displacement is shown.
        arrow: tail and tip of the drawn force, shape [2, 2] [px].
    """
    frame, contact, outlines, u, v = prepared.frame, prepared.geometry, "", None, None
    if contact is not None and prepared.track_start < 0 and prepared.contact_probability < CERTAIN:
        outlines = UNDECIDED if prepared.undecided else OUTLINES_ALONE
    unseen = "No displacement: the onset of contact was not observed, or lies beyond the model's horizon."
    missing = unseen if contact is not None and lengths[0] is None and not whole else ""
    if contact is not None:
        u, v = grid_to_picture(np.array(contact.pixel), prepared.depth.shape, clip.size).tolist()
    judged = finite(prepared.contact_probability), finite(prepared.distance)
    return FrameEstimate(
        frame.number,
        frame.time_s,
        status=prepared.status,
        detail=" ".join(filter(None, (prepared.detail or missing, outlines, doubts))),
        estimate=estimate,
        verdict=verdict if estimate is None else estimate.verdict,
        contact=True if contact is not None else False if prepared.status in OUT_OF_CONTACT else None,
        touch=Touch(*judged, u, v, prepared.instrument, *lengths, arrow),
    )


def finite(number: float) -> float | None:
    """A number; None where it is not finite."""
    return float(number) if math.isfinite(number) else None


def force_arrow(
    theta: np.ndarray, contact: FrameGeometry, clip: ClipInfo, bounds: Bounds, direction: np.ndarray
) -> np.ndarray | None:
    """Tail and tip (u, v), shape [2, 2] [px], of the drawn force: it ends at the contact, its length grows with |F|."""
    largest, camera = max(abs(value) for value in bounds.force), clip.camera
    tip = contact.tissue_point.astype(np.float64)
    # Length of the drawn arrow of the largest admissible force, as a share of the contact point's depth.
    tail = tip - direction * (0.3 * tip[2] * float(theta[2]) / largest)
    if theta[2] == 0 or tail[2] <= 0:
        return None
    ends = np.stack([tail, tip])
    # The inverse of Bini 2026, equation 3.
    return ends[:, :2] / ends[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
