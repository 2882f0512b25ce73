"""Runs of contact, gathered frame by frame: the part of a session that all estimators share."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from data.contact.evidence import SURE
from data.contact.geometry import FrameGeometry
from data.contact.interaction import ContactFrame, Horizon, Interaction, InteractionBuilder
from data.contact.tissue_points import grid_to_picture
from data.prepared import OUT_OF_CONTACT, PreparedFrame
from estimators.contract import ClipInfo
from estimators.estimate import LARGEST_SLAB_ERROR, Estimate, FrameEstimate, InteractionEstimate, NoEstimate
from estimators.grip.recorder import GripRecorder
from physics.mechanics import Bounds, Mechanics

NO_ONSET = (
    "The onset of the contact was not seen, and without it the rest shape and the beginning of the load are unknown."
)
PASSED = "No contact: the instrument moves, and the tissue beside it does not move with it."
OUTLINES_ALONE = "Contact by outlines alone: nothing has moved yet that would tell whether tissue moves with the tool."
NOT_SHOWN = "No displacement: the onset of contact was not seen, or lies beyond the model's horizon."
NOT_FOLLOWED = "The tissue at the contact could not be followed after its onset."
FULL_ARROW = 0.3
"""Length of the drawn arrow of the largest admissible force, as a share of the contact point's depth."""


class Run:
    """One run of contact; its frames are dropped as they pass, what they tell of it is kept."""

    def __init__(self, first: PreparedFrame, clip: ClipInfo, seconds: float) -> None:
        frame = first.frame
        self.index, self.number, self.time_s, self.detail = frame.index, frame.number, frame.time_s, first.detail
        """Of its first frame: index in the clip, number, time stamp [s], and what is wrong with the contact."""
        self.last = frame.index
        """Index of the last frame in contact."""
        self.contact = math.nan
        """Largest probability of contact so far."""
        self.hovered = False
        """Whether the tool was found to hover within it or right after it."""
        self.builder: InteractionBuilder | None = None
        """What is seen of it; None where its onset was not."""
        self.note(first)
        contact = first.geometry
        if contact is not None and first.track_start == frame.index:
            found = contact.mesh, contact.vertex, contact.normal, contact.noise
            self.builder = InteractionBuilder(*found, contact_frame(first), clip.geometry, seconds, clip.size)

    def note(self, current: PreparedFrame) -> None:
        """What a frame within the run or right after it tells of whether there was contact."""
        self.contact = float(np.fmax(self.contact, current.contact_probability))
        self.hovered |= current.hovers

    @property
    def passed(self) -> bool:
        """Whether the tool only passed over the tissue: it hovered, and nothing ever spoke for contact."""
        return self.hovered and not self.contact >= SURE

    def add(self, current: PreparedFrame) -> None:
        """A frame of the run, in contact or followed after it."""
        if current.in_contact:
            self.last = current.frame.index
        if self.builder is not None:
            self.builder.add(contact_frame(current))

    def estimate(self, **told) -> InteractionEstimate:
        """The run's record, with what an estimator tells of it."""
        load = None if self.builder is None else self.builder.load_seconds
        return InteractionEstimate(self.index, self.number, self.time_s, load, **told)

    @property
    def unseen(self) -> str:
        """Why nothing can be estimated of a run that has no observation, or of none."""
        if self.passed:
            return PASSED
        if self.builder is None:
            return self.detail or NO_ONSET
        return f"{self.detail} {NOT_FOLLOWED}".strip()


class RunTracker:
    """Follows a clip's runs of contact.

    Args:
        clip: the clip.
        seconds: how long a run's motion counts [s].
    """

    def __init__(self, clip: ClipInfo, seconds: float) -> None:
        self._clip, self._seconds = clip, seconds
        self.current: Run | None = None
        """The run under way, after its release as well, as long as its tissue is followed."""

    def push(self, frame: PreparedFrame) -> Run | None:
        """The next frame; gives a run that has ended before it."""
        run = self.current
        if run is not None:
            if frame.frame.index - run.last <= self._clip.bridge_frames + 1:
                run.note(frame)
            if self._belongs(frame, run):
                run.add(frame)
                return None
            missing = frame.frame.index - run.last
            if run.builder is None and not frame.in_contact and missing <= self._clip.bridge_frames:
                return None  # it may be flicker
        self.current = Run(frame, self._clip, self._seconds) if frame.in_contact else None
        return run

    def _belongs(self, frame: PreparedFrame, run: Run) -> bool:
        if run.builder is not None:
            return frame.track_start == run.index
        missing = frame.frame.index - run.last - 1
        return frame.in_contact and frame.track_start < 0 and missing <= self._clip.bridge_frames

    def finish(self) -> Run | None:
        """The run that the clip's end has cut off."""
        run, self.current = self.current, None
        return run


class RunSession:
    """What the sessions of all estimators share: the clip's runs of contact, and what is said of each at its end.

    Args:
        clip: the clip.
        mechanics: of the estimator.
        horizon: how much of a whole contact is looked at.
        thickness: of the tissue, where a grip is to be explained by finite elements, too [scene units].
    """

    def __init__(
        self, clip: ClipInfo, mechanics: Mechanics, horizon: Horizon = None, thickness: float | None = None
    ) -> None:
        self.clip, self.horizon, self._thickness = clip, horizon, thickness
        self.mechanics = mechanics.matched(1 / clip.fps)
        """The simulator, its steps matched to the clip's frame rate."""
        self.seconds: dict[str, float] = defaultdict(float)
        """Time spent so far by stage [s]."""
        self._runs = RunTracker(clip, self.mechanics.seconds)
        self._grip: GripRecorder | None = None

    def finish(self) -> Iterator[FrameEstimate | InteractionEstimate]:
        """The run that the clip's end has cut off."""
        yield from self._ended(self._runs.finish())

    def _follow(self, frame: PreparedFrame) -> None:
        """Gather the motion around the instrument, too; for sessions that tell what a grip tells, after every frame."""
        run, start = self._runs.current, time.perf_counter()
        if run is None or self.clip.geometry.contact == "motion" or not self._follows(run):
            self._grip = None
        elif run.index == frame.frame.index:
            self._grip = GripRecorder(frame, self._thickness) if frame.visible else None
        elif self._grip is not None and frame.frame.index - run.last <= self.clip.bridge_frames:
            self._grip.add(frame)
        self.seconds["grip"] += time.perf_counter() - start

    def _follows(self, run: Run) -> bool:
        """Whether the motion around the instrument may be needed: nothing else tells of a run without an onset."""
        return run.builder is None

    def _ended(self, run: Run | None) -> Iterator[InteractionEstimate]:
        """What is said of a run, if one has ended: what the press tells, and the grip where that is nothing."""
        if run is None:
            return
        recorder, self._grip = self._grip, None
        if run.passed:
            yield run.estimate(detail=run.unseen)
            return
        said = self._pressed(run)
        if recorder is not None and said.verdict in ("", "undetermined"):
            said = self._gripped(said, recorder, run.builder is None)
        yield said

    def _pressed(self, run: Run) -> InteractionEstimate:
        contact = None if run.builder is None else run.builder.build(self.mechanics, self.horizon)
        if contact is None or len(contact.observation) == 0:
            return run.estimate(detail=run.unseen)
        try:
            found, simulated, doubts = self._whole(contact)
        except NoEstimate as reason:
            return run.estimate(interaction=contact, detail=f"{run.detail} {reason}".strip())
        detail = f"{run.detail} {doubts}".strip()
        return run.estimate(interaction=contact, estimate=found, simulated=simulated, detail=detail)

    def _gripped(self, said: InteractionEstimate, recorder: GripRecorder, only: bool) -> InteractionEstimate:
        """What is said of a run, with what a grip tells; why that is nothing counts only where nothing else could."""
        start = time.perf_counter()
        try:
            found, told = recorder.estimate(), ""
        except NoEstimate as reason:
            found, told = None, str(reason) if only else ""
        self.seconds["grip"] += time.perf_counter() - start
        if found is not None and not found.explained:
            elsewhere = f", gripped elsewhere {found.rival:.2f}" if math.isfinite(found.rival) else ""
            told = f"A sheet gripped by the instrument doesn't explain the motion (skill {found.skill:.2f}{elsewhere})."
        elif found is not None and found.slab_error > LARGEST_SLAB_ERROR:
            told = f"A slab of this thickness leaves {found.slab_error:.0%} of the motion; F/E isn't known."
        elif found is not None and not found.determined:
            told = "A gripped sheet explains the motion, but neither its foundation nor its force over time is known."
        return dataclasses.replace(said, grip=found, detail=f"{said.detail} {told}".strip())

    def _whole(self, contact: Interaction) -> tuple[Estimate, tuple[np.ndarray, np.ndarray], str]:
        """Of a whole contact: the estimate, the simulated motion as an `InteractionEstimate` has it, and doubts.

        Raises:
            NoEstimate: it can't be estimated.
        """
        raise NotImplementedError


def contact_frame(frame: PreparedFrame) -> ContactFrame:
    """What a prepared frame tells about its run of contact."""
    return ContactFrame(
        frame.frame.time_s,
        frame.in_contact,
        frame.out_of_contact,
        frame.consecutive,
        frame.track_position,
        frame.depth,
        frame.labels,
    )


def frame_estimate(
    prepared: PreparedFrame,
    clip: ClipInfo,
    estimate: Estimate | None = None,
    *,
    verdict: str = "",
    lengths: tuple[float | None, float | None] = (None, None),
    doubts: str = "",
    whole: bool = False,
    arrow: np.ndarray | None = None,
) -> FrameEstimate:
    """The record of a frame; without an estimate it holds the status and what is known of the contact.

    Args:
        verdict: of a frame without an estimate.
        lengths: of the simulated and the observed displacement [scene units].
        doubts: sentences about what can't be trusted, behind the frame's own.
        whole: whether they say already why no displacement is shown.
        arrow: the force as it is drawn.
    """
    frame, contact = prepared.frame, prepared.geometry
    untold = contact is not None and prepared.track_start < 0 and prepared.contact_probability < SURE
    missing = NOT_SHOWN if contact is not None and lengths[0] is None and not whole else ""
    u, v = None, None
    if contact is not None:
        u, v = grid_to_picture(np.array(contact.pixel), prepared.depth.shape, clip.size).tolist()
    return FrameEstimate(
        frame.number,
        frame.time_s,
        prepared.status,
        detail=" ".join(filter(None, (prepared.detail or missing, OUTLINES_ALONE if untold else "", doubts))),
        estimate=estimate,
        verdict=verdict if estimate is None else estimate.verdict,
        contact=True if contact is not None else False if prepared.status in OUT_OF_CONTACT else None,
        contact_probability=float(prepared.contact_probability)
        if math.isfinite(prepared.contact_probability)
        else None,
        contact_distance=float(prepared.distance) if math.isfinite(prepared.distance) else None,
        contact_u=u,
        contact_v=v,
        simulated_displacement=lengths[0],
        observed_displacement=lengths[1],
        arrow=arrow,
    )


def force_arrow(
    theta: np.ndarray, contact: FrameGeometry, clip: ClipInfo, bounds: Bounds, direction: np.ndarray
) -> np.ndarray | None:
    """The force as it acts: tail and tip (u, v) [px] of an arrow that ends at the contact, as long as |F| is large."""
    largest, camera = max(abs(value) for value in bounds.force), clip.camera
    tip = contact.tissue_point.astype(np.float64)
    tail = tip - direction * (FULL_ARROW * tip[2] * float(theta[2]) / largest)
    if theta[2] == 0 or tail[2] <= 0:
        return None
    ends = np.stack([tail, tip])
    # The inverse of Bini 2026, equation 3.
    return ends[:, :2] / ends[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
