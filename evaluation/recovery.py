"""One synthetic clip against its truth: made in memory, observed as each suite says, estimated, compared.

One task is one clip in all wanted suites, because the true motion costs most and is the same in most of them.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from data.clip import PrepareSettings
from data.collected import CollectedClip
from data.depth import DepthSettings
from data.geometry import GeometrySettings
from data.samples import ContactCase, Horizon, SampleSettings, contact_cases
from data.synthetic import draw_truth, synthetic_clip
from data.synthetic_scene import Scene, SceneError
from data.synthetic_settings import SceneSettings
from data.synthetic_source import prepare_synthetic
from data.synthetic_truth import Motion
from estimators.direct import DirectSettings
from estimators.estimate import NoEstimate
from evaluation.recovery_estimators import Answer, EstimatorSpec, open_estimator
from evaluation.suites import SUITES
from physics.identifiability import contact_information

PREPARE = PrepareSettings(
    depth=DepthSettings(source="stored"), geometry=GeometrySettings(smoothing=4, rigid_motion="subtract")
)
"""How all clips are prepared."""
MECHANICS = DirectSettings().mechanics
"""Simulator of the bound."""
SAMPLES = SampleSettings(observation="trajectory", mechanics=MECHANICS, geometry=PREPARE.geometry)
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
    """Whether the estimate says that it may not be trusted (see `recovery_estimators.Answer`)."""
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
        known = {name: value for name, value in fields.items() if value is not None}
        return Recovery(**{name: np.array(value) if name in _ARRAYS else value for name, value in known.items()})


@dataclass(frozen=True)
class ClipTask:
    """What one worker does in one go."""

    index: int
    seed: int
    """Seed of the clip."""
    wanted: tuple[tuple[str, tuple[EstimatorSpec, ...]], ...]
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
    return [row for suite, specs in task.wanted for row in _evaluate_suite(task, suite, specs, truths)]


def _evaluate_suite(task: ClipTask, suite: str, specs: tuple[EstimatorSpec, ...], truths: _Truths) -> list[Recovery]:
    settings = SUITES[suite].settings(task.index)
    blank = Recovery(suite, task.index, "", task.seed, settings.regime)
    try:
        scene, motion = truths.of(settings)
        known = dataclasses.replace(blank, theta=motion.theta, peak=motion.peak)
    except SceneError as error:
        return [_failed(blank, spec, "no scene", str(error)) for spec in specs]
    try:
        clip = prepare_synthetic(synthetic_clip(scene, motion, task.seed), PREPARE)
        cases = contact_cases(clip, dataclasses.replace(SAMPLES, horizon_frames=task.seen))
    except Exception as error:  # a clip that breaks the preparation is a result, and the others go on
        return [_failed(known, spec, "error", f"{type(error).__name__}: {error}") for spec in specs]
    onset = motion.onset_frame
    if not cases:
        return [_failed(known, spec, "no contact", "no onset of contact was found.") for spec in specs]
    if onset not in cases:
        reason = f"contact began in frame {', '.join(map(str, cases))} instead of {onset}."
        return [_failed(known, spec, "other onset", reason) for spec in specs]
    tracking, information = compare_tracking(cases[onset], scene, motion)
    known = dataclasses.replace(known, tracking=tracking, information=information)
    return [_estimate(known, spec, clip, onset) for spec in specs]


def compare_tracking(case: ContactCase, scene: Scene, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a tracked contact, shape [M], and the information for σ = 1 that a perfect one would have, [3, 3].

    The information is that of the true instants since the force's start, to the nearest step of the simulator (2.5 ms),
    as if that start were known.

    Args:
        case: the contact as observed; it must begin in the true onset's frame.
    """
    fps = scene.settings.fps
    frames = motion.onset_frame + np.rint((case.steps + 1) * MECHANICS.time_step * fps).astype(int)
    errors = (case.displacement - motion.contact[frames]) @ scene.direction
    load = round(motion.load_seconds / MECHANICS.time_step)
    steps = case.steps - round(motion.delay / MECHANICS.time_step)
    steps = steps[steps >= 0]  # before the force starts the tissue is at rest and tells nothing
    if not len(steps):
        return errors, np.zeros((3, 3))
    information = contact_information(
        motion.theta, scene.mesh, scene.vertex, scene.direction, MECHANICS, steps, 1.0, load_steps=load
    )
    return errors, information


def _estimate(known: Recovery, spec: EstimatorSpec, clip: CollectedClip, onset: int) -> Recovery:
    start = time.perf_counter()
    try:
        answer = open_estimator(spec)(clip).get(onset, NoEstimate("it doesn't see this contact."))
    except Exception as error:  # an estimator that breaks on a clip is a result, and the others go on
        return _failed(known, spec, "error", f"{type(error).__name__}: {error}")
    if isinstance(answer, Answer) and not np.isfinite(answer.theta).all():
        answer = NoEstimate("its θ is not finite.")
    if isinstance(answer, NoEstimate):
        return _failed(known, spec, "no estimate", str(answer))
    return dataclasses.replace(
        known,
        estimator=spec.name,
        estimate=answer.theta,
        covariance=answer.covariance,
        verdict=answer.verdict,
        noise=answer.noise,
        misfit=answer.misfit,
        at_bound=answer.at_bound,
        warned=answer.warned,
        seconds=time.perf_counter() - start,
    )


def _failed(known: Recovery, spec: EstimatorSpec, status: str, reason: str) -> Recovery:
    return dataclasses.replace(known, estimator=spec.name, status=status, reason=reason)


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
