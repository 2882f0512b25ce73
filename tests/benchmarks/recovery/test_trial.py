"""One clip against its truth: the same clip as the generator's, and every failure told."""

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from benchmarks.harness import Row
from benchmarks.recovery import trial as recovery
from benchmarks.recovery.bounds import known
from benchmarks.recovery.suites import SUITES, suite_clip_seed
from benchmarks.recovery.trial import Trial, TrueClip, run_trial
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.scene import SceneError
from palpate.estimators.estimate import PressCourse, PressResult
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.estimators.open import settings_of
from palpate.estimators.records import InteractionEstimate
from palpate.physics.identifiability import bounds
from tests.estimators.sessions import clip_info

SEED = suite_clip_seed("test", 0, 2)  # over-damped: the cheapest motion
DIRECT = settings_of("direct")
FOUND = PressResult(np.array([0.4, 0.05, -0.1]), np.eye(3), given_verdict="undetermined")


class Telling:
    """An estimator that says the same at the end of every clip."""

    def __init__(self, *said: InteractionEstimate) -> None:
        self.said = said

    def start(self, clip: object) -> "Telling":
        return self

    def push(self, frame: object) -> tuple[InteractionEstimate, ...]:
        return ()

    def finish(self) -> tuple[InteractionEstimate, ...]:
        return self.said


@pytest.fixture(scope="module")
def truth():
    """Scene and motion of the clip in most suites."""
    return draw_truth(SUITES["clean"].truth_settings(2), SEED)


def test_suites_that_only_observe_otherwise_share_a_truth():
    for name in ("clean", "focal-error", "8bit"):
        assert SUITES[name].truth_settings(2) == SUITES["clean"].truth_settings(2)
    others = {SUITES[name].truth_settings(2) for name in ("clean", "mismatch", "oblique", "late-onset")}
    assert len(others) == 4


def test_a_clip_in_three_suites(monkeypatch, truth):
    drawn, onset = [], truth[1].onset_frame

    def draw(settings, seed):
        drawn.append(settings)
        return truth

    monkeypatch.setattr(recovery, "draw_truth", draw)
    monkeypatch.setattr(recovery, "opened", lambda _: Telling(InteractionEstimate(onset, onset, 0.0, estimate=FOUND)))
    recovery._truth.cache_clear()
    wanted = {"clean": {"direct": DIRECT}, "8bit": {"direct": DIRECT}, "mismatch": {"direct": DIRECT}}
    clean, rounded, mismatch = run_trial(Trial(2, SEED, wanted | {"noisy": {}}))
    assert drawn == [SUITES[name].truth_settings(2) for name in ("clean", "mismatch")]
    assert (clean["status"], rounded["status"], mismatch["status"]) == ("ok", "ok", "ok")
    assert (clean["estimator"], clean["suite"], rounded["suite"]) == ("direct", "clean", "8bit")
    np.testing.assert_allclose(clean["estimate"], [0.4, 0.05, -0.1])
    np.testing.assert_array_equal(clean["covariance"], np.eye(3))
    for row in (clean, rounded, mismatch):
        information = row["field_information"]
        assert information.shape == (5, 5)
        assert (bounds(known(information, STAMP)) < bounds(known(information, BETWEEN))).all()
    # Rounded depth has errors that stay, and other noise.
    assert not np.allclose(clean["field_information"], rounded["field_information"], rtol=0.01)


def run(monkeypatch, **replaced) -> Row:
    recovery._truth.cache_clear()
    for name, value in replaced.items():
        monkeypatch.setattr(recovery, name, value)
    (row,) = run_trial(Trial(2, SEED, {"clean": {"direct": DIRECT}}))
    return row


def raising(error: Exception):
    def function(*_: object, **__: object) -> None:
        raise error

    return function


def test_failures_become_results(monkeypatch):
    failing = raising(SceneError("nothing to draw."))
    row = run(monkeypatch, draw_truth=failing)
    assert (row["status"], row["reason"], "theta" in row) == ("no scene", "nothing to draw.", False)


def test_a_broken_preparation_and_missing_contacts_become_results(monkeypatch, truth):
    scene, motion = truth
    few = dataclasses.replace(SUITES["clean"].settings(2), frames=8)
    clip = synthetic_clip(dataclasses.replace(scene, settings=few), motion, SEED)
    known = {"draw_truth": lambda *_: truth, "synthetic_clip": lambda *_: clip}
    row = run(monkeypatch, **known, open_synthetic=raising(RuntimeError("broken")))
    assert (row["status"], row["reason"]) == ("error", "RuntimeError: broken")
    monkeypatch.undo()
    row = run(monkeypatch, **known, observed_contacts=lambda *_: {})
    assert row["status"] == "no contact"
    row = run(monkeypatch, observed_contacts=lambda *_: {motion.onset_frame + 1: None})
    assert row["status"] == "other onset"
    assert f"instead of {motion.onset_frame}" in row["reason"]
    np.testing.assert_array_equal(row["theta"], motion.theta)


def told(monkeypatch, truth, estimator) -> Row:
    """What becomes of an estimator's answer about a contact that began in frame 3."""
    monkeypatch.setattr(recovery, "opened", lambda _: estimator)
    clip = TrueClip(*truth, [], clip_info())
    return recovery.estimated(DIRECT, clip, functools.partial(recovery._pressed, 3))


NOT_FINITE = PressResult(np.array([np.nan, 0.1, -0.1]))


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ((), "it doesn't see this contact."),
        ((InteractionEstimate(2, 2, 0.08, estimate=NOT_FINITE),), "it doesn't see this contact."),
        ((InteractionEstimate(3, 3, 0.12, detail="Too short."),), "Too short."),
        ((InteractionEstimate(3, 3, 0.12, estimate=NOT_FINITE),), "its θ is not finite."),
    ],
)
def test_contacts_without_an_estimate_and_estimators_that_break_become_results(monkeypatch, truth, said, reason):
    row = told(monkeypatch, truth, Telling(*said))
    assert (row["status"], row["reason"], "estimate" in row) == ("no estimate", reason, False)
    broken = Telling()
    broken.finish = raising(ValueError("broken"))
    row = told(monkeypatch, truth, broken)
    assert (row["status"], row["reason"], "estimate" in row) == ("error", "broken", False)


@pytest.mark.parametrize(
    ("misfit", "angle", "warned"), [(1.4, 1.0, False), (1.6, 1.0, True), (1.4, 4.9, False), (1.4, 5.1, True)]
)
def test_motions_that_are_not_explained_or_seen_aslant_are_warned_of(monkeypatch, truth, misfit, angle, warned):
    theta, at_bound = np.array([0.3, 0.05, -0.1]), np.array([False, True, False])
    said: dict[str, Any] = {"noise": 0.001, "misfit": misfit, "largest_misfit": 1.5, "at_bound": at_bound}
    estimate = PressResult(theta, np.eye(3), information=np.eye(3), **said, course=PressCourse(view_angle=angle))
    row = told(monkeypatch, truth, Telling(InteractionEstimate(3, 3, 0.12, estimate=estimate)))
    assert (row["status"], row["warned"], row["verdict"]) == ("ok", warned, "undetermined")
    assert (row["noise"], row["misfit"]) == (0.001, misfit)
    for name, value in (("estimate", theta), ("covariance", np.eye(3))):
        np.testing.assert_array_equal(row[name], value)


def test_an_estimator_without_uncertainty_gives_no_verdict_and_no_warning(monkeypatch, truth):
    estimate = PressResult(np.array([0.3, 0.05, -0.1]), given_verdict="undetermined")
    row = told(monkeypatch, truth, Telling(InteractionEstimate(3, 3, 0.12, estimate=estimate)))
    assert (row["status"], row["verdict"], row["warned"], row["covariance"]) == ("ok", "", None, None)
