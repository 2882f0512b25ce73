"""One synthetic clip against its truth: made in memory, observed as each suite says, estimated, compared.

One task is one clip in all wanted suites, because the true motion costs most and is the same in most of them.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from data.contact.geometry import GeometrySettings
from data.contact.interaction import Horizon, Interaction
from data.depth.normalise import DepthSettings
from data.prepared import PreparedFrame
from data.settings import PrepareSettings
from data.synthetic.clip import draw_truth, synthetic_clip
from data.synthetic.scene import Scene, SceneError
from data.synthetic.settings import SceneSettings
from data.synthetic.source import open_synthetic
from data.synthetic.truth import Motion
from estimators.contract import ClipInfo
from estimators.direct.estimator import FITTED
from estimators.estimate import InteractionEstimate
from estimators.oblique import is_oblique
from estimators.runs import RunTracker
from evaluation.recovery.estimators import Candidate, opened
from evaluation.recovery.suites import SUITES
from physics.likelihood import Likelihood
from physics.load import Press, held
from physics.observation import Observation

PREPARE = PrepareSettings(
    depth=DepthSettings(source="stored"), geometry=GeometrySettings(smoothing=4, rigid_motion="subtract")
)
"""How all clips are prepared."""
MECHANICS = FITTED
"""Simulator of the bound."""
OK = "ok"
STATUSES = (OK, "no scene", "no contact", "other onset", "no estimate", "error")
"""Whether a clip was estimated, or why not: its draw failed, no run of contact was found, one was found but in another
frame, the estimator declined, or something broke."""
Truth = tuple[Scene, Motion]
TRUTH_FIELDS = ("stiffness_variation", "nonlinearity", "max_tilt_deg", "onset_delay", "release_delay")
"""Fields of SceneSettings in which suites differ and that change the truth, not only how it is observed."""
_ARRAYS = ("theta", "information", "tracking", "estimate", "covariance", "at_bound")


@dataclass(frozen=True)
class Recovery:
    """Truth and estimate of one clip in one suite by one estimator."""

    suite: str
    index: int
    estimator: str
    seed: int
    regime: str
    status: str = OK
    """One of STATUSES."""
    reason: str = ""
    """Why there is no estimate, in words."""
    theta: np.ndarray | None = None
    """True [k_s, k_d, F], shape [3]; None where no clip could be drawn."""
    peak: float = math.nan
    """True largest displacement of the contact [scene units]."""
    information: np.ndarray | None = None
    """Fisher information of log θ at the truth, on the true mesh, for observations with σ = 1, shape [3, 3]."""
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
    at_bound: np.ndarray | None = None
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

    def to_json(self) -> dict[str, Any]:
        """As a JSON object; what isn't known is null."""
        fields = dataclasses.asdict(self)
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                fields[name] = value.tolist()
            elif isinstance(value, float) and not math.isfinite(value):
                fields[name] = None
        return fields

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> Recovery:
        """Back from `to_json`.

        Raises:
            KeyError, TypeError, ValueError: it isn't one.
        """
        known: dict[str, Any] = {name: value for name, value in fields.items() if value is not None}
        known |= {name: np.array(known[name]) for name in known.keys() & set(_ARRAYS)}
        return Recovery(**known)


@dataclass(frozen=True)
class ClipTask:
    """What one worker does in one go."""

    index: int
    seed: int
    """Seed of the clip."""
    wanted: tuple[tuple[str, tuple[Candidate, ...]], ...]
    """Suites, each with the estimators that are to be tried."""
    seen: Horizon = None
    """Frames after the onset that estimators and bound see; none = one second."""


@dataclass
class _Truths:
    """True motions of one clip; suites that only observe otherwise share one."""

    seed: int
    known: dict[tuple[object, ...], Truth] = field(default_factory=dict)

    def of(self, settings: SceneSettings) -> Truth:
        key = tuple(getattr(settings, name) for name in TRUTH_FIELDS)
        if key not in self.known:
            self.known[key] = draw_truth(settings, self.seed)
        scene, motion = self.known[key]
        return dataclasses.replace(scene, settings=settings), motion


def evaluate_clip(task: ClipTask) -> list[Recovery]:
    """Results of one clip for every wanted suite and estimator; what goes wrong becomes a result that says so."""
    truths = _Truths(task.seed)
    return [row for suite, some in task.wanted for row in _evaluate_suite(task, suite, some, truths)]


def _evaluate_suite(task: ClipTask, suite: str, candidates: tuple[Candidate, ...], truths: _Truths) -> list[Recovery]:
    settings = SUITES[suite].settings(task.index)
    blank = Recovery(suite, task.index, "", task.seed, settings.regime)
    try:
        scene, motion = truths.of(settings)
        known = dataclasses.replace(blank, theta=motion.theta, peak=motion.peak)
    except SceneError as error:
        return [_failed(blank, candidate, "no scene", str(error)) for candidate in candidates]
    try:
        clip = open_synthetic(synthetic_clip(scene, motion, task.seed), PREPARE)
        frames, info = list(clip), ClipInfo.of(clip)
        contacts = observed_contacts(frames, info, task.seen)
    except Exception as error:  # a clip that breaks the preparation is a result, and the others go on
        return [_failed(known, candidate, "error", f"{type(error).__name__}: {error}") for candidate in candidates]
    onset = motion.onset_frame
    if not contacts:
        return [_failed(known, candidate, "no contact", "no onset of contact was found.") for candidate in candidates]
    if onset not in contacts:
        reason = f"contact began in frame {', '.join(map(str, contacts))} instead of {onset}."
        return [_failed(known, candidate, "other onset", reason) for candidate in candidates]
    tracking, information = compare_tracking(contacts[onset], scene, motion)
    known = dataclasses.replace(known, tracking=tracking, information=information)
    return [_estimate(known, candidate, frames, info, onset) for candidate in candidates]


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


def compare_tracking(contact: Interaction, scene: Scene, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a tracked contact, shape [M], and the information for σ = 1 that a perfect one would have, [3, 3].

    The information is that of the true instants since the force's start, to the nearest step of the simulator (2.5 ms),
    as if that start were known.

    Args:
        contact: as observed; it must begin in the true onset's frame.
    """
    times = contact.observation.times
    frames = motion.onset_frame + np.rint(times * scene.settings.fps).astype(int)
    errors = (contact.moved - motion.contact[frames]) @ scene.direction
    steps = contact.observation.steps(MECHANICS.time_step) - round(motion.delay / MECHANICS.time_step)
    steps = steps[steps >= 0]  # before the force starts the tissue is at rest and tells nothing
    if not len(steps):
        return errors, np.zeros((3, 3))
    load = Press.at(
        scene.vertex, scene.direction, held(round(motion.load_seconds / MECHANICS.time_step), int(steps[-1]) + 1)
    )
    nothing = np.zeros((len(steps), 3))
    observed = Observation.of_point(scene.vertex, (steps + 1) * MECHANICS.time_step, nothing, 1.0)
    likelihood = Likelihood(scene.mesh, load, observed, MECHANICS)
    return errors, likelihood.information(np.log(np.abs(motion.theta)))


def _estimate(
    known: Recovery, candidate: Candidate, frames: Sequence[PreparedFrame], clip: ClipInfo, onset: int
) -> Recovery:
    start = time.perf_counter()
    try:
        session = opened(candidate).start(clip)
        said = [item for frame in frames for item in session.push(frame)] + list(session.finish())
    except Exception as error:  # an estimator that breaks on a clip is a result, and the others go on
        return _failed(known, candidate, "error", f"{type(error).__name__}: {error}")
    runs = {item.onset: item for item in said if isinstance(item, InteractionEstimate)}
    run = runs.get(onset)
    if run is None or run.estimate is None:
        return _failed(known, candidate, "no estimate", "it doesn't see this contact." if run is None else run.detail)
    found = run.estimate
    if not np.isfinite(found.theta).all():
        return _failed(known, candidate, "no estimate", "its θ is not finite.")
    warns = candidate.name in ("direct", "network")
    return dataclasses.replace(
        known,
        estimator=candidate.name,
        estimate=np.asarray(found.theta, np.float64),
        covariance=found.covariance,
        verdict="" if found.told_verdict else found.verdict,
        noise=found.noise,
        misfit=found.misfit,
        at_bound=found.at_bound,
        warned=not found.explained or is_oblique(found) if warns else None,
        seconds=time.perf_counter() - start,
    )


def _failed(known: Recovery, candidate: Candidate, status: str, reason: str) -> Recovery:
    return dataclasses.replace(known, estimator=candidate.name, status=status, reason=reason)


def draw_log_theta(task: tuple[int, int]) -> np.ndarray | None:
    """True log |θ| of a clip, shape [3], without its pictures; None where nothing can be drawn.

    Args:
        task: index and seed of the clip.
    """
    index, seed = task
    try:
        _, motion = draw_truth(SUITES["clean"].settings(index), seed)
    except SceneError:
        return None
    return np.log(np.abs(motion.theta))
