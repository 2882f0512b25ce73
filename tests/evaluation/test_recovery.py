"""One clip against its truth: the same clip as the generator's, and every failure told."""

import dataclasses

import numpy as np
import pytest

from data.samples import ContactCase
from data.synthetic import draw_truth, make_clip, synthetic_clip
from data.synthetic_scene import SceneError
from evaluation import recovery
from evaluation.recovery import ClipTask, Recovery, draw_log_theta, evaluate_clip
from evaluation.recovery_estimators import EstimatorSpec
from evaluation.suites import SUITES, suite_clip_seed
from physics.identifiability import contact_information

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


def test_suites_of_another_truth_draw_their_own():
    truths = recovery._Truths(SEED)
    motions = {}
    for name in ("clean", "mismatch", "oblique", "late-onset"):
        settings = SUITES[name].settings(2)
        scene, motions[name] = truths.of(settings)
        expected_scene, expected = draw_truth(settings, SEED)
        np.testing.assert_array_equal(motions[name].contact, expected.contact)
        np.testing.assert_array_equal(scene.mesh.vertices, expected_scene.mesh.vertices)
    assert len(truths.known) == 4
    changed = {
        field.name
        for field in dataclasses.fields(SUITES["clean"].settings(0))
        for suite in SUITES.values()
        for name in (*suite.truth, *suite.every_other_truth)
        if name == field.name
    }
    assert changed == set(recovery.TRUTH_FIELDS)


def test_a_late_force_is_compared_and_bounded_at_its_own_instants():
    """A delay of half a frame, eight steps of the simulator: a track without error, and the information it holds."""
    settings = dataclasses.replace(SUITES["late-onset"].settings(2), onset_delay=(0.5, 0.5), release_delay=(0.5, 0.5))
    scene, motion = draw_truth(settings, SEED)
    after = np.arange(1, 26)
    observed = motion.contact[motion.onset_frame + after] - 0.002 * scene.direction
    case = ContactCase(
        mesh=scene.mesh,
        vertex=scene.vertex,
        direction=scene.direction.astype(np.float32),
        load_steps=round(motion.load_seconds / 0.0025),
        steps=16 * after - 1,
        displacement=observed,
        weight=np.ones(25, np.float32),
    )
    errors, information = recovery.compare_tracking(case, scene, motion)
    np.testing.assert_allclose(errors, -0.002)
    contact = motion.theta, scene.mesh, scene.vertex, scene.direction, recovery.MECHANICS
    expected = contact_information(*contact, 16 * after - 9, 1.0, load_steps=case.load_steps)
    np.testing.assert_allclose(information, expected, rtol=1e-12)
    on_time = contact_information(*contact, 16 * after - 1, 1.0, load_steps=case.load_steps)
    assert not np.allclose(information, on_time, rtol=0.01)
    # Before the force starts nothing is told.
    late = dataclasses.replace(motion, delay=0.04)
    blind = dataclasses.replace(case, steps=case.steps[:1], displacement=observed[:1])
    np.testing.assert_array_equal(recovery.compare_tracking(blind, scene, late)[1], np.zeros((3, 3)))


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
