"""One clip against its truth: the same clip as the generator's, and every failure told."""

import dataclasses

import numpy as np
import pytest

from data.synthetic import make_clip, synthetic_clip
from data.synthetic_scene import SceneError
from evaluation import recovery
from evaluation.recovery import ClipTask, Recovery, draw_log_theta, evaluate_clip
from evaluation.recovery_estimators import EstimatorSpec
from evaluation.suites import SUITES, suite_clip_seed

SPEC = EstimatorSpec("constant", constant=((-1.0, -3.0, -2.5), (1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)))
SEED = suite_clip_seed("test", 0, 2)  # over-damped: the cheapest motion


def test_sharing_truths_gives_the_generators_clips():
    truths = recovery._Truths(SEED)
    clips = []
    for name in ("clean", "focal-error", "8bit"):
        settings = SUITES[name].settings(2)
        clips.append(synthetic_clip(*truths.of(settings), SEED))
        made = make_clip(settings, SEED)
        assert clips[-1].camera == made.camera
        for field in ("images", "labels", "depth"):
            np.testing.assert_array_equal(getattr(clips[-1], field), getattr(made, field))
    assert len(truths.known) == 1
    np.testing.assert_array_equal(clips[0].motion.theta, clips[2].motion.theta)


def test_a_clip_in_two_suites():
    clean, mismatch = evaluate_clip(ClipTask(2, SEED, (("clean", (SPEC,)), ("mismatch", (SPEC,)))))
    assert (clean.status, mismatch.status) == ("ok", "ok")
    assert np.sqrt(np.mean(np.square(clean.tracking))) < 0.003
    np.testing.assert_allclose(clean.estimate, np.exp([-1, -3, -2.5]) * [1, 1, -1])
    assert np.linalg.eigvalsh(clean.information).min() >= 0
    assert mismatch.peak != clean.peak
    np.testing.assert_allclose(draw_log_theta((2, SEED)), np.log(np.abs(clean.theta)))


def run(monkeypatch, **replaced) -> Recovery:
    for name, value in replaced.items():
        monkeypatch.setattr(recovery, name, value)
    (row,) = evaluate_clip(ClipTask(2, SEED, (("clean", (SPEC,)),)))
    return row


def raising(error: Exception):
    def function(*_: object, **__: object) -> None:
        raise error

    return function


def test_failures_become_results(monkeypatch):
    row = run(monkeypatch, draw_truth=raising(SceneError("nothing to draw.")))
    assert (row.status, row.reason, row.theta) == ("no scene", "nothing to draw.", None)
    assert draw_log_theta((2, SEED)) is None


def test_a_broken_preparation_and_missing_contacts_become_results(monkeypatch):
    truth = make_clip(SUITES["clean"].settings(2), SEED)
    known = {"draw_truth": lambda *_: (truth.scene, truth.motion), "synthetic_clip": lambda *_: truth}
    row = run(monkeypatch, **known, prepare_synthetic=raising(RuntimeError("broken")))
    assert (row.status, row.reason) == ("error", "RuntimeError: broken")
    row = run(monkeypatch, prepare_synthetic=lambda *_: None, contact_cases=lambda *_: {})
    assert row.status == "no contact"
    row = run(monkeypatch, contact_cases=lambda *_: {truth.motion.onset_frame + 1: None})
    assert row.status == "other onset"
    assert f"instead of {truth.motion.onset_frame}" in row.reason


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (lambda _: {}, "no estimate"),
        (raising(ValueError("broken")), "error"),
    ],
)
def test_estimators_that_fail_become_results(monkeypatch, answer, status):
    monkeypatch.setattr(recovery, "open_estimator", lambda _: answer)
    row = recovery._estimate(Recovery("clean", 0, "", 0, "critical"), SPEC, None, 3)
    assert (row.status, row.estimator) == (status, "constant")
    assert dataclasses.replace(row, status="", reason="").estimate is None
