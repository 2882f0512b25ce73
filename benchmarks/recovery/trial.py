"""One synthetic clip against its truth: made in memory, observed as each suite says, estimated as users estimate.

A trial is one clip in all wanted suites, because the true motion costs most and is the same in most of them. Its result
is a row a suite and estimator; missing values are left out. θ = [k_s, k_d, F], lengths in scene units:

suite, index, estimator, seed   the clip and the estimator
action, regime                  `press` or `grip`; of a press, how it is damped
status, reason                  `ok`, or why there is no estimate: its draw failed (`no scene`), no run of contact was
                                found (`no contact`), one was found but in another frame (`other onset`), the estimator
                                declined (`no estimate`), or something broke (`error`)
seconds                         time that the estimate took
verdict, warned                 as estimated; true if the estimate warns that its model doesn't explain the motion, or
                                that a dent may hide its bottom

of a press:

theta, estimate, covariance     true and estimated θ, shape [3], and the estimated covariance of log θ, shape [3, 3]
field_information               Fisher information of log θ and both delays from the sequence of its dent with the
                                sequence's noise (`benchmarks.recovery.bounds`), shape [5, 5]
noise, misfit                   σ that the estimator believed in; its misfit

of a grip:

contact_right                   share of the frames in which something moves whose contact is the true one
skill                           as estimated
curve                           force over that of the last frame: true, estimated, its standard deviation, shape [3, T]
"""

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.harness import OK, Row, attempted
from benchmarks.recovery.bounds import field_information
from benchmarks.recovery.grips import gripped
from benchmarks.recovery.suites import EVERY, GRID_SIZE
from palpate.common.doors import interruptible
from palpate.data.contact.interaction import Horizon, Interaction
from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.clip import Truth, draw_truth, synthetic_clip
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.scene import Scene, SceneError
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.contract import ClipInfo, Estimator
from palpate.estimators.direct.estimator import FITTED
from palpate.estimators.oblique import is_oblique
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.run_tracker import RunTracker
from palpate.estimators.session import estimates_of

opened: Callable[[Any], Estimator] = functools.cache(lambda settings: settings.build())
"""Every estimator is opened once a process."""
Compare = Callable[[Any], Row]
"""Function from a session's results on a clip to a row."""


@dataclass(frozen=True)
class Trial:
    """Work of one worker in one go."""

    index: int
    seed: int
    """Seed of the clip."""
    wanted: Mapping[str, Mapping[str, Any]]
    """Settings of wanted estimators by name, by suite."""
    horizon: Horizon = None
    """Frames after the onset that estimators and bound observe; None = one second."""
    size: tuple[int, int] = GRID_SIZE
    """Width and height of pictures of presses [px]."""


@dataclass(frozen=True, eq=False)
class TrueClip:
    """A clip as estimators observe it, and its truth."""

    scene: Scene
    motion: Truth
    frames: list[PreparedFrame]
    info: ClipInfo


def run_trial(trial: Trial) -> list[Row]:
    """Rows of one clip for every wanted suite and estimator; an error becomes a row."""
    wanted = [(suite, candidates) for suite, candidates in trial.wanted.items() if candidates]
    return [row for suite, candidates in wanted for row in _suite_rows(trial, suite, candidates)]


@functools.lru_cache(maxsize=1)
def _truth(settings: SceneSettings, seed: int) -> tuple[Scene, Truth]:
    """The truth, drawn once for suites with the same settings, which follow each other."""
    return draw_truth(settings, seed)


def _suite_rows(trial: Trial, suite: str, candidates: Mapping[str, Any]) -> list[Row]:
    settings = EVERY[suite].settings(trial.index, trial.size)
    known: Row = {"suite": suite, "index": trial.index, "seed": trial.seed, "action": settings.action}
    if EVERY[suite].of == "press":
        known["regime"] = settings.regime

    def failed(status: str, reason: str) -> list[Row]:
        return [known | {"estimator": name, "status": status, "reason": reason} for name in candidates]

    try:
        scene, motion = _truth(EVERY[suite].truth_settings(trial.index, trial.size), trial.seed)
    except SceneError as error:
        return failed("no scene", str(error))
    scene = replace(scene, settings=settings)
    if isinstance(motion, PressedMotion):
        known["theta"] = motion.theta
    try:
        with interruptible():
            prepared = open_synthetic(synthetic_clip(scene, motion, trial.seed), PREPARE)
            clip = TrueClip(scene, motion, list(prepared), ClipInfo.of(prepared))
            found, compare = _judged(trial, clip)
    except Exception as error:  # a clip that breaks the preparation is a result, and the others go on
        return failed("error", f"{type(error).__name__}: {error}")
    known |= found
    if compare is None:
        return failed(known["status"], known["reason"])
    return [known | {"estimator": name} | estimated(one, clip, compare) for name, one in candidates.items()]


def _judged(trial: Trial, clip: TrueClip) -> tuple[Row, Compare | None]:
    """Facts that hold for all estimators, and the function from results to a row; None if nothing can be compared."""
    motion = clip.motion
    if isinstance(motion, GrippedMotion):
        return {}, functools.partial(gripped, clip.scene, motion)
    contacts = observed_contacts(clip.frames, clip.info, trial.horizon)
    if not contacts:
        return {"status": "no contact", "reason": "no onset of contact was found."}, None
    onset = min(contacts, key=lambda found: abs(found - motion.onset_frame))
    if onset != motion.onset_frame:
        begun = ", ".join(map(str, contacts))
        reason = f"contact began in frame {begun} instead of {motion.onset_frame}."
        return {"status": "other onset", "reason": reason}, None
    known = {"field_information": field_information(contacts[onset], clip.scene, motion)}
    return known, functools.partial(_pressed, onset)


def estimated(candidate: Any, clip: TrueClip, compare: Compare) -> Row:
    """Row of an estimator's results, or the reason for none."""
    start = time.perf_counter()

    def answered() -> Row:
        answer = list(estimates_of(opened(candidate).start(clip.info), clip.frames))
        seconds = time.perf_counter() - start
        return {"status": OK, "seconds": seconds, **compare(answer)}

    return attempted(answered)  # an estimator that breaks on a clip is a result, and the others go on


def _pressed(onset: int, answer: list) -> Row:
    """Estimate of the press whose contact begins in a frame."""
    runs = [item for item in answer if isinstance(item, InteractionEstimate)]
    run = next((item for item in runs if item.onset == onset), None)
    if run is None or run.estimate is None:
        return {"status": "no estimate", "reason": "it doesn't see this contact." if run is None else run.detail}
    found = run.estimate
    if not np.isfinite(found.theta).all():
        return {"status": "no estimate", "reason": "its θ is not finite."}
    return {
        "estimate": np.asarray(found.theta, np.float64),
        "covariance": found.covariance,
        "verdict": "" if found.given_verdict else found.verdict,
        "noise": found.noise,
        "misfit": found.misfit,
        "warned": None if found.given_verdict else not found.explained or is_oblique(found),
    }


def observed_contacts(frames: list[PreparedFrame], clip: ClipInfo, horizon: Horizon = None) -> dict[int, Interaction]:
    """Runs of contact whose onset was observed and whose tissue was tracked, by the frame of the onset.

    Args:
        frames: all frames of the clip.
        horizon: observed part of each run.
    """
    runs = RunTracker(clip, FITTED.seconds)
    ended = [*(runs.push(frame) for frame in frames), runs.finish()]
    known = [(run.index, run.builder) for run in ended if run is not None]
    found = {index: builder.build(FITTED, horizon) for index, builder in known if builder is not None}
    return {onset: contact for onset, contact in found.items() if len(contact.observation)}
