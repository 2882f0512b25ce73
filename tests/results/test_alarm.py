"""The alarm of a limit of force: its states, its memory, and what it counts."""

import dataclasses
import math

import numpy as np
import pytest

from benchmarks.recovery.suites import EVERY, GRID_SIZE, suite_clip_seed
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.estimators.contract import ClipInfo
from palpate.estimators.open import open_estimator
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of
from palpate.physics.identifiability import NINETY
from palpate.results.alarm import ForceAlarm, known_force
from tests.estimators.estimates import ESTIMATE


def alarm(limit: float = 1.0, seconds: float = math.inf) -> ForceAlarm:
    return ForceAlarm(limit, "N", seconds)


def told(found: ForceAlarm, *chances: float | None, contact: bool | None = True) -> list[str]:
    """States of frames of 0.04 s, with these probabilities."""
    start = found.frames.total()
    return [found.push(0.04 * (start + i), contact, chance) for i, chance in enumerate(chances)]


def test_an_alarm_begins_at_one_threshold_and_ends_under_the_other() -> None:
    found = alarm()
    states = told(found, 0.49, 0.89, 0.9, 0.6, 0.5, 0.49, 0.5, 0.91)
    assert states == ["below", "unknown", "above", "above", "above", "below", "unknown", "above"]
    assert found.alarms == 2


def test_an_unknown_force_is_neither_safe_nor_unsafe_and_ends_no_alarm() -> None:
    found = alarm()
    assert told(found, None, 0.95, None, 0.6) == ["unknown", "above", "unknown", "above"]
    assert told(found, None, 0.4, contact=None) == ["unknown", "unknown"]
    assert told(found, None, None, contact=False) == ["", ""]
    assert found.alarms == 1


def test_an_alarm_ends_with_its_run_of_contact() -> None:
    found = alarm()
    told(found, 0.95)
    told(found, None, contact=False)
    assert told(found, 0.6) == ["above"]  # a gap that is bridged
    found.end_run()
    assert told(found, 0.4, 1.0) == ["below", "above"]
    assert found.alarms == 2


def test_a_force_is_unknown_once_the_estimate_is_of_an_earlier_one() -> None:
    found = alarm(seconds=0.08)
    told(found, None, contact=False)
    assert told(found, None, 0.4, 0.4, 0.4, 0.95) == ["unknown", "below", "below", "unknown", "unknown"]
    found.end_run()
    assert told(found, 0.4) == ["below"]
    assert found.alarms == 0


def test_frames_are_counted_by_state() -> None:
    found = alarm()
    frames = ((0.0, False, None), (0.1, True, None), (0.15, True, 0.95), (0.4, None, None), (0.5, True, 0.1))
    for frame in frames:
        found.push(*frame)
    record = found.record()
    assert record["frames"] == {"no_contact": 1, "below": 1, "above": 1, "unknown": 2}
    assert (record["limit"], record["unit"], record["alarms"]) == (1.0, "N", 1)
    assert "in 2 of 5 frames;" in found.sentence()
    assert "not a medical device" in found.sentence()
    assert sum(alarm().record()["frames"].values()) == 0


def test_the_probability_is_that_of_a_determined_force_alone() -> None:
    force = known_force(ESTIMATE)
    assert (force.value, force.log_sd) == pytest.approx((0.1, 0.05))
    at_upper_end = alarm(0.1 * math.exp(NINETY * 0.05))
    assert at_upper_end.probability(force) == pytest.approx(0.05, abs=1e-4)
    assert known_force(dataclasses.replace(ESTIMATE, covariance=np.eye(3))) is None
    assert known_force(dataclasses.replace(ESTIMATE, misfit=2.0)) is None
    assert at_upper_end.probability(None) is None


@pytest.mark.acceptance
def test_a_crossing_by_a_factor_is_never_below_and_no_false_alarm_on_synthetic_clips() -> None:
    """Judged: every press of known force, by the shipped network, with limits far on both sides of it."""
    estimator, seen = open_estimator("network", threads=1), 0
    for index in range(4):
        settings, seed = EVERY["clean"].settings(index, GRID_SIZE), suite_clip_seed("validation", 39, index)
        scene, motion = draw_truth(settings, seed)
        clip = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
        output = list(estimates_of(estimator.start(ClipInfo.of(clip)), clip))
        force = abs(motion.theta[2])
        for factor in (0.5, 3.0):
            found, known = alarm(factor * force), 0
            for item in output:
                if isinstance(item, InteractionEstimate):
                    found.end_run()
                    continue
                assert isinstance(item, FrameEstimate)
                known += item.estimate is not None and known_force(item.estimate) is not None
                assert found.watch(item).alarm != ("above" if factor > 1 else "below")
            seen += known
            frames = found.record()["frames"]
            assert frames["unknown"] >= motion.release_frame - motion.onset_frame - known
            assert sum(frames.values()) == settings.frames
    assert seen > 20
