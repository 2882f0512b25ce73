"""One synthetic clip against its truth: made in memory, observed as each suite says, estimated, compared.

One task is one clip in all wanted suites, because the true motion costs most and is the same in most of them.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from data.contact.geometry import GeometrySettings
from data.contact.interaction import Horizon, Interaction
from data.depth.normalise import DepthSettings
from data.prepared import PreparedFrame
from data.settings import PrepareSettings
from data.synthetic.clip import draw_press, synthetic_clip
from data.synthetic.scene import Scene, SceneError
from data.synthetic.settings import SceneSettings
from data.synthetic.source import open_synthetic
from data.synthetic.truth import PressedMotion
from estimators.contract import ClipInfo
from estimators.estimate import Estimate, InteractionEstimate
from estimators.oblique import is_oblique
from estimators.open import EstimatorOptions
from estimators.runs import RunTracker
from evaluation.recovery.bounds import MECHANICS, contact_information, field_information
from evaluation.recovery.estimators import Candidate, opened
from evaluation.recovery.suites import GRID_SIZE, SUITES
from physics.doors import interruptible

PREPARE = PrepareSettings(
    depth=DepthSettings(source="stored"), geometry=GeometrySettings(smoothing=4, rigid_motion="subtract")
)
"""How all clips are prepared."""
MOTION = "motion"
"""How contacts are found where no tool is in view: by their dents."""
OK = "ok"


@dataclass(frozen=True)
class Recovery:
    """Truth and estimate of one clip in one suite by one estimator."""

    suite: str
    index: int
    estimator: str
    seed: int
    regime: str
    status: str = OK
    """`ok`, or why there is no estimate: its draw failed (`no scene`), no run of contact was found (`no contact`), one
    was found but in another frame (`other onset`), the estimator declined (`no estimate`), or something broke
    (`error`)."""
    reason: str = ""
    """Why there is no estimate, in words."""
    theta: np.ndarray | None = None
    """True [k_s, k_d, F], shape [3]; None where no clip could be drawn."""
    information: np.ndarray | None = None
    """Fisher information of log θ and both delays from the contact's motion for σ = 1 (`bounds`), shape [5, 5]."""
    field_information: np.ndarray | None = None
    """The same from the film of its dent with the film's noise; None without a film."""
    onset_off: float = math.nan
    """Frames from the true onset to the one that was found."""
    release_off: float = math.nan
    """The same of the release; not a number where none was found."""
    place_off: float = math.nan
    """How far the contact was found from the true one [grid px]."""
    tracking: np.ndarray | None = None
    """Tracked minus true displacement along the true direction, shape [M] [scene units]."""
    estimate: np.ndarray | None = None
    """Estimated [k_s, k_d, F], shape [3]."""
    covariance: np.ndarray | None = None
    """Estimated covariance of log θ, shape [3, 3]."""
    verdict: str = ""
    """Estimated verdict."""
    noise: float = math.nan
    """σ that the estimator believed in [scene units]."""
    misfit: float = math.nan
    at_bound: np.ndarray = field(default_factory=lambda: np.zeros(3, bool))
    """Whether an estimate lies at its range's end, shape [3]."""
    warned: bool | None = None
    """Whether it says that the model doesn't explain the motion, or that a dent may hide its bottom; None = it never
    says so."""
    seconds: float = math.nan
    """Time that the estimate took [s]."""

    @property
    def key(self) -> tuple[str, int, str]:
        """What tells it from other results of a run."""
        return self.suite, self.index, self.estimator


@dataclass(frozen=True)
class ClipTask:
    """What one worker does in one go."""

    index: int
    seed: int
    """Seed of the clip."""
    wanted: Mapping[str, Mapping[str, Candidate]]
    """Suites, each with the estimators that are to be tried, by name; those without any are left out."""
    seen: Horizon = None
    """Frames after the onset that estimators and bound see; none = one second."""
    size: tuple[int, int] = GRID_SIZE
    """Width and height of the pictures [px]."""
    contact: Literal["touching", "motion"] = "touching"
    """How contacts are found; with motion clips are drawn without the tool, and an onset that is a frame off counts."""


@functools.lru_cache(maxsize=1)
def _truth(settings: SceneSettings, seed: int) -> tuple[Scene, PressedMotion]:
    """Drawn once for all suites that only observe otherwise; these follow each other."""
    return draw_press(settings, seed)


def evaluate_clip(task: ClipTask) -> list[Recovery]:
    """Results of one clip for every wanted suite and estimator; what goes wrong becomes a result that says so."""
    wanted = [(suite, candidates) for suite, candidates in task.wanted.items() if candidates]
    return [row for suite, candidates in wanted for row in _evaluate_suite(task, suite, candidates)]


def _evaluate_suite(task: ClipTask, suite: str, candidates: Mapping[str, Candidate]) -> list[Recovery]:
    settings = SUITES[suite].settings(task.index, task.size)
    known: dict[str, Any] = {"suite": suite, "index": task.index, "seed": task.seed, "regime": settings.regime}

    def failed(status: str, reason: str) -> list[Recovery]:
        return [Recovery(**known, estimator=name, status=status, reason=reason) for name in candidates]

    try:
        scene, motion = _truth(SUITES[suite].truth_settings(task.index, task.size), task.seed)
    except SceneError as error:
        return failed("no scene", str(error))
    unseen = task.contact == MOTION
    scene = dataclasses.replace(scene, settings=dataclasses.replace(settings, tool_in_view=not unseen))
    known["theta"] = motion.theta
    try:
        geometry = dataclasses.replace(PREPARE.geometry, contact=task.contact)
        prepare = dataclasses.replace(PREPARE, geometry=geometry)
        with interruptible():
            clip = open_synthetic(synthetic_clip(scene, motion, task.seed), prepare)
            frames, info = list(clip), ClipInfo.of(clip)
            contacts = observed_contacts(frames, info, task.seen)
    except Exception as error:  # a clip that breaks the preparation is a result, and the others go on
        return failed("error", f"{type(error).__name__}: {error}")
    if not contacts:
        return failed("no contact", "no onset of contact was found.")
    onset = min(contacts, key=lambda found: abs(found - motion.onset_frame))
    if abs(onset - motion.onset_frame) > unseen:
        found = ", ".join(map(str, contacts))
        return failed("other onset", f"contact began in frame {found} instead of {motion.onset_frame}.")
    contact = contacts[onset]
    known |= _off(contact, frames[onset], scene, motion)
    motion = as_stamped(motion, onset)
    known["tracking"] = tracking_errors(contact, scene, motion)
    known["information"] = contact_information(contact, scene, motion)
    known["field_information"] = field_information(contact, scene, motion)
    return [
        Recovery(**known, estimator=name, **estimated(candidate, frames, info, onset))
        for name, candidate in candidates.items()
    ]


def _off(contact: Interaction, onset: PreparedFrame, scene: Scene, motion: PressedMotion) -> dict[str, float]:
    """Fields of a `Recovery`: how far a contact was found from the true one."""
    seconds = (motion.release_frame - onset.frame.index) / scene.settings.fps
    released = contact.load_seconds - seconds if contact.released else math.nan
    place = contact.mesh.pixels[contact.vertex] - scene.mesh.pixels[scene.vertex]
    return {
        "onset_off": float(onset.frame.index - motion.onset_frame),
        "release_off": round(released * scene.settings.fps, 2),
        "place_off": float(np.linalg.norm(place)),
    }


def as_stamped(motion: PressedMotion, onset: int) -> PressedMotion:
    """The same motion with its delay counted from another frame that is taken for the onset."""
    interval = motion.times[1] - motion.times[0]
    delay = motion.delay - (onset - motion.onset_frame) * interval
    return dataclasses.replace(motion, onset_frame=onset, delay=delay)


def observed_contacts(frames: Sequence[PreparedFrame], clip: ClipInfo, seen: Horizon = None) -> dict[int, Interaction]:
    """Every run of contact whose onset was seen and whose tissue was followed, by the frame of its onset.

    Args:
        frames: of the whole clip.
        seen: how much of each counts.
    """
    runs = RunTracker(clip, MECHANICS.seconds)
    ended = [*(runs.push(frame) for frame in frames), runs.finish()]
    found = {
        run.index: run.builder.build(MECHANICS, seen) for run in ended if run is not None and run.builder is not None
    }
    return {onset: contact for onset, contact in found.items() if len(contact.observation)}


def tracking_errors(contact: Interaction, scene: Scene, motion: PressedMotion) -> np.ndarray:
    """Errors of a tracked contact along the true direction, shape [M] [scene units].

    Args:
        contact: as observed; it must begin in the true onset's frame.
    """
    frames = motion.onset_frame + np.rint(contact.observation.times * scene.settings.fps).astype(int)
    return (contact.moved - motion.contact[frames]) @ scene.direction


def interactions(
    candidate: EstimatorOptions, frames: Sequence[PreparedFrame], clip: ClipInfo
) -> list[InteractionEstimate]:
    """What the session that users run says of every run of contact."""
    session = opened(candidate).start(clip)
    said = [item for frame in frames for item in session.push(frame)] + list(session.finish())
    return [item for item in said if isinstance(item, InteractionEstimate)]


def estimated(candidate: Candidate, frames: Sequence[PreparedFrame], clip: ClipInfo, onset: int) -> dict[str, Any]:
    """Fields of a `Recovery`: what is estimated of the run of contact that begins in a frame, or why nothing is."""
    start = time.perf_counter()
    if isinstance(candidate, Estimate):
        found = candidate
    else:
        try:
            with interruptible():
                said = interactions(candidate, frames, clip)
        except Exception as error:  # an estimator that breaks on a clip is a result, and the others go on
            return {"status": "error", "reason": f"{type(error).__name__}: {error}"}
        run = next((item for item in said if item.onset == onset), None)
        if run is None or run.estimate is None:
            return {"status": "no estimate", "reason": "it doesn't see this contact." if run is None else run.detail}
        found = run.estimate
    if not np.isfinite(found.theta).all():
        return {"status": "no estimate", "reason": "its θ is not finite."}
    return {
        "estimate": np.asarray(found.theta, np.float64),
        "covariance": found.covariance,
        "verdict": "" if found.told_verdict else found.verdict,
        "noise": found.noise,
        "misfit": found.misfit,
        "at_bound": found.at_bound,
        "warned": None if found.told_verdict else not found.explained or is_oblique(found),
        "seconds": time.perf_counter() - start,
    }
