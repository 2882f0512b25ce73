"""The part of a session that all estimators share: the record of every run of contact, and of every frame."""

import dataclasses
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache, partial
from typing import Any, ClassVar, TypeVar

import numpy as np

from palpate.common.heap import trim_heap
from palpate.common.stages import StageSeconds
from palpate.data.contact.evidence import CERTAIN, PRIOR
from palpate.data.contact.geometry import FrameGeometry
from palpate.data.contact.interaction import Horizon, Interaction
from palpate.data.contact.tissue_points import grid_to_picture
from palpate.data.prepared import OUT_OF_CONTACT, PreparedFrame
from palpate.data.shading.light import log_light
from palpate.estimators.contract import ClipInfo
from palpate.estimators.direct.shading_fit import MECHANICS, fit_shading
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.estimators.grip.recorder import GripRecorder
from palpate.estimators.records import FrameEstimate, InteractionEstimate, Touch
from palpate.estimators.run_tracker import RECORDED, UNDECIDED, Run, RunTracker
from palpate.physics.mechanics import Bounds, Mechanics

OUTLINES_ALONE = "Contact by outlines alone: nothing has moved yet that would show whether tissue moves with the tool."
Fitted = TypeVar("Fitted")
MOST_FITS = 4
"""Contacts of a live source that wait for their fits at most."""
TOO_MANY = f"Not fitted: contacts came faster than they can be fitted here, and {MOST_FITS} were waiting."
WHOLE = "Whole runs of contact are fitted, when they have ended: see interactions.csv."


class RunSession:
    """The common part of all estimators' sessions: the clip's runs of contact, and the record of each at its end.

    Args:
        clip: the clip.
        mechanics: constants of the estimator's simulator.
        horizon: how much of a whole contact counts.
        observations: names of those that are recorded of it.
    """

    follows_all: ClassVar = False
    """True if the motion around the instrument is recorded of every run, not only where depth may constrain nothing."""
    needs_point: ClassVar = True
    """True if a press can be estimated only where the very tissue that the instrument touches is followed."""

    def __init__(
        self, clip: ClipInfo, mechanics: Mechanics, horizon: Horizon = None, observations: Sequence[str] = RECORDED
    ) -> None:
        self.clip, self.horizon = clip, horizon
        self.mechanics = mechanics.matched(1 / clip.fps)
        """The simulator, its steps matched to the clip's frame rate."""
        self.lit_mechanics = MECHANICS.matched(1 / clip.fps)
        """Mechanics of estimates by light."""
        self.by_light = False
        """True if a press is estimated by the light of the tissue, where it is known."""
        self.needs_light = False
        """True if that light is looked at although depth is measured."""
        self.seconds = StageSeconds()
        self.fitter: Executor | None = None
        """Process that fits presses by shading, and pulls, for live sources; None = later frames wait for the fits."""
        self._fits: deque[Future[InteractionEstimate]] = deque()
        self._fit_thread = ThreadPoolExecutor(1, "fit")
        self._runs = RunTracker(clip, self.mechanics.seconds, observations)
        self._grip: GripRecorder | None = None

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
        with self.seconds.timed("follow"):
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
            if self.fitter is None or (recorder is None and not (self.by_light and run.lit)):
                yield self._recorded(run, recorder)
            elif len(self._fits) < MOST_FITS:
                self._fits.append(self._fit_thread.submit(self._recorded, run, recorder))
            else:
                yield run.estimate(detail=f"{run.detail} {TOO_MANY}".strip())
        while self._fits and self._fits[0].done():
            yield self._fits.popleft().result()

    def _recorded(self, run: Run, recorder: GripRecorder | None) -> InteractionEstimate:
        """Return the record of a run: of the press, and of the grip where the press is undetermined."""
        if run.passed:
            return run.estimate(detail=run.unobserved)
        record = self._pressed(run)
        if recorder is not None and record.verdict in ("", "undetermined"):
            record = self._gripped(record, recorder, run.builder is None)
        trim_heap()
        return record

    def _pressed(self, run: Run) -> InteractionEstimate:
        contact = None if run.builder is None else run.builder.build(self.mechanics, self.horizon)
        if contact is not None and not self.needs_point:
            contact = contact.unhidden()
        if contact is None or not (len(contact.observation) or contact.shows_light):
            return run.estimate(detail=run.unobserved)
        mechanics = self.mechanics
        try:
            if self.by_light and contact.shows_light:
                mechanics = self.lit_mechanics
                with self.seconds.timed("fit"):
                    contact, found, simulated = self._computed(fit_shading, contact, 1 / self.clip.fps)
                doubts = found.refuted
            else:
                found, simulated, doubts = self._whole(contact)
        except NoEstimate as reason:
            return run.estimate(interaction=contact, detail=f"{run.detail} {reason}".strip())
        detail = f"{run.detail} {doubts}".strip()
        return run.estimate(
            interaction=contact, estimate=found, mechanics=mechanics, simulated=simulated, detail=detail
        )

    def _computed(self, fit: Callable[..., Fitted], *arguments: Any) -> Fitted:
        """Return what a fit returns, by the process for fits where there is one."""
        if self.fitter is None:
            return fit(*arguments)
        try:
            return self.fitter.submit(fit, *arguments).result()
        except BrokenProcessPool as error:
            raise NoEstimate("The process that fits contacts was killed, maybe for want of memory.") from error

    def _gripped(self, record: InteractionEstimate, recorder: GripRecorder, only: bool) -> InteractionEstimate:
        """Return the record of a run with the estimate of its grip; failures are reported if that is the `only`
        estimate."""
        found, sentence = None, ""
        try:
            with self.seconds.timed("grip"):
                found = self._computed(recorder.motion().estimate)
        except NoEstimate as reason:
            sentence = str(reason) if only else ""
        if found is not None and not found.explained:
            elsewhere = f", gripped elsewhere {found.rival:.2f}" if math.isfinite(found.rival) else ""
            sentence = f"A gripped sheet doesn't explain the motion (skill {found.skill:.2f}{elsewhere})."
        elif found is not None and not found.determined:
            sentence = "A gripped sheet explains the motion, but the force over time is too uncertain."
        return dataclasses.replace(record, grip=found, detail=f"{record.detail} {sentence}".strip())

    def _whole(self, contact: Interaction) -> tuple[PressResult, tuple[np.ndarray, np.ndarray], str]:
        """Return the estimate of a whole contact, the simulated motion as an `InteractionEstimate` has it, and doubts.

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
    """Return the record of a frame; without an estimate it holds the status and the contact only.

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
    # Outlines that touch are no evidence: a tool in front of tissue looks the same.
    unknown = bool(outlines) and math.isclose(prepared.contact_probability, PRIOR)
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
        contact=None if unknown else contact is not None if prepared.status in ("ok", *OUT_OF_CONTACT) else None,
        touch=Touch(*judged, u, v, prepared.instrument, *lengths, arrow),
    )


def finite(number: float) -> float | None:
    """Return a number; None where it is not finite."""
    return float(number) if math.isfinite(number) else None


def force_arrow(
    theta: np.ndarray, contact: FrameGeometry, clip: ClipInfo, bounds: Bounds, direction: np.ndarray
) -> np.ndarray | None:
    """Return the tail and tip (u, v), shape [2, 2] [px], of the drawn force: it ends at the contact, its length grows
    with |F|."""
    largest, camera = max(abs(value) for value in bounds.force), clip.camera
    tip = contact.tissue_point.astype(np.float64)
    # Length of the drawn arrow of the largest admissible force, as a share of the contact point's depth.
    tail = tip - direction * (0.3 * tip[2] * float(theta[2]) / largest)
    if theta[2] == 0 or tail[2] <= 0:
        return None
    ends = np.stack([tail, tip])
    # The inverse of Bini 2026, equation 3.
    return ends[:, :2] / ends[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
