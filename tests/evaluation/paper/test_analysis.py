"""The evaluation's numbers, from records whose answer is known."""

import numpy as np
import pytest

from data.contact.interaction import Interaction
from evaluation.paper.analysis import CONSTANT, MEAN, NO_MOTION, PREDICTED, REFERENCE, analyse, analyse_next_depth
from evaluation.paper.baselines import ConstantThetaSettings, no_motion_error, simulate_contacts
from tests.evaluation.simple_contacts import BOUNDS, MECHANICS, contact, record

SETTINGS = ConstantThetaSettings(contacts=2, starts=2, refined=1, iterations=8)
SOFT, HARD = np.array([0.2, 0.02, -0.05]), np.array([1.5, 0.15, -0.2])


@pytest.fixture(scope="module")
def training():
    return [contact(SOFT), contact(HARD)]


@pytest.fixture(scope="module")
def followers():
    """Estimates equal to the truth, which differs between clips."""
    truths = {"soft 1": SOFT, "hard 1": HARD, "soft 2": SOFT * 1.1, "hard 2": HARD * 0.9}
    return [record(theta, theta, clip, frame) for clip, theta in truths.items() for frame in range(3)]


def test_an_estimator_that_follows_the_truth_succeeds(followers, training):
    result = analyse(followers[::-1], training, MECHANICS, BOUNDS, SETTINGS)
    assert result.clips.tolist() == sorted(result.clips.tolist())
    assert result.frames[:3].tolist() == [0, 1, 2]
    assert list(result.errors) == [REFERENCE, PREDICTED, CONSTANT, MEAN, NO_MOTION]
    assert result.check.verdict == "varies"
    assert result.conclusion.startswith("The estimates beat the constant θ fitted on the training contacts. Varies")
    assert result.comparisons[CONSTANT].wilcoxon_w == 0
    assert result.missing == ()


def test_frames_that_share_an_observation_are_counted_once(followers, training):
    shared = [record(SOFT, SOFT * 1.05, "one", 0) | {"frame": frame} for frame in range(8)]
    result = analyse(shared, training, MECHANICS, BOUNDS, SETTINGS)
    assert (len(result.frames), result.contacts) == (8, 1)
    assert any("8 test frames share 1 observed motion of a contact" in sentence for sentence in result.missing)
    assert not result.conclusion.startswith("The estimates beat")
    assert analyse(followers, training, MECHANICS, BOUNDS, SETTINGS).contacts == 12


def test_errors_of_the_baselines_are_simulated_on_the_test_frames(followers, training):
    result = analyse(followers, training, MECHANICS, BOUNDS, SETTINGS)
    ordered = sorted(followers, key=lambda one: (one["clip"], one["frame"]))
    first = Interaction(*(ordered[0][name] for name in ("mesh", "load", "observation")), MECHANICS.time_step)
    for name, theta in ((CONSTANT, np.array(result.constant.theta)), (MEAN, result.theta.mean(axis=0))):
        assert result.errors[name][0] == pytest.approx(simulate_contacts(theta, [first], MECHANICS)[1][0], rel=1e-4)
    assert result.errors[NO_MOTION][0] == pytest.approx(no_motion_error(first.observation))
    assert result.errors[PREDICTED][0] == ordered[0]["error_predicted"]


def test_a_constant_estimator_is_called_collapsed_and_no_success(training):
    truths = [SOFT, HARD] * 5
    records = [record(theta, (0.5, 0.09, -0.1), f"clip {i // 2}", i) for i, theta in enumerate(truths)]
    result = analyse(records, training, MECHANICS, BOUNDS, SETTINGS)
    assert result.check.verdict == "collapsed"
    assert result.conclusion.startswith("No success")
    np.testing.assert_allclose(result.errors[MEAN], result.errors[PREDICTED], rtol=1e-3)


def test_simulations_that_are_not_finite_or_leave_the_scene_are_counted(followers, training):
    records = [dict(one) for one in followers]
    records[0] |= {"reference_trajectory": np.full((40, 3), np.nan, np.float32), "error_reference": float("nan")}
    records[1] |= {"reference_trajectory": np.full((40, 3), 2.0, np.float32)}
    result = analyse(records, training, MECHANICS, BOUNDS, SETTINGS)
    reference = result.regularity[REFERENCE]
    assert (reference.frames, reference.not_finite, reference.leaves_scene) == (12, 1, 1)
    assert result.regularity[PREDICTED].not_finite == 0
    assert (result.summaries[REFERENCE].n, result.summaries[PREDICTED].n) == (11, 12)
    assert (result.comparisons[REFERENCE].n, result.comparisons[REFERENCE].left_out) == (11, 1)
    assert sum(one.state == "not finite" for one in result.settling[REFERENCE]) == 1


def test_without_training_contacts_there_is_no_constant():
    result = analyse([record(SOFT, SOFT)], [], MECHANICS, BOUNDS, SETTINGS)
    assert result.constant is None
    assert CONSTANT not in result.errors
    assert "there are no training contacts" in result.missing[0]


def test_no_records_are_an_error():
    with pytest.raises(ValueError, match="no test pair is in contact"):
        analyse([], [], MECHANICS, BOUNDS)


CLIPS = np.repeat(list("abcd"), 5)
COPY = 0.005 + 1e-4 * np.arange(20)


def test_next_depth_better_than_copying_and_conditioned():
    result = analyse_next_depth(0.8 * COPY, COPY, 0.5 * COPY, CLIPS)
    assert result.comparison.relative_change_percent == pytest.approx(-20)
    assert result.sensitivity_share == pytest.approx(0.5)
    assert result.sentences[0].endswith("The picture carries motion.")
    assert result.sentences[1].endswith("50 % of the change between frames: θ reaches the picture.")


def test_next_depth_that_copies_and_ignores_theta():
    result = analyse_next_depth(1.1 * COPY, COPY, 0.01 * COPY, CLIPS)
    assert "no motion that repeating the last frame would not" in result.sentences[0]
    assert "θ hardly reaches the picture. The decoder's own error is 110 times that." in result.sentences[1]


def test_next_depth_of_a_still_scene():
    result = analyse_next_depth(COPY, np.zeros(20), COPY, CLIPS)
    assert result.sensitivity_share is None
    assert "the scene does not change" in result.sentences[1]
