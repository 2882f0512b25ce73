"""The evaluation's numbers, from records whose answer is known."""

import math

import numpy as np
import pandas as pd
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.evaluation.paper import analysis
from palpate.evaluation.paper.simulated import no_motion_errors, simulate_contacts
from tests.evaluation.simple_contacts import BOUNDS, MECHANICS, contact, record

SOFT, HARD = np.array([0.2, 0.02, -0.05]), np.array([1.5, 0.15, -0.2])
TRAINING = [contact(SOFT), contact(HARD)]


@pytest.fixture(scope="module")
def followers():
    """Estimates equal to the truth, which differs between clips; a reference fails, and one leaves the scene."""
    truths = {f"{name} {n}": theta * n for n in (0.9, 1.0, 1.1) for name, theta in (("soft", SOFT), ("hard", HARD))}
    made = [record(theta, theta, clip, frame) for clip, theta in truths.items() for frame in range(2)]
    made[0] |= {"reference_trajectory": np.full((40, 3), np.nan, np.float32), "error_reference": float("nan")}
    made[1] |= {"reference_trajectory": np.full((40, 3), 2.0, np.float32)}
    return made


@pytest.fixture(scope="module")
def followed(followers):
    return analysis.analyse(followers[::-1], TRAINING, MECHANICS, BOUNDS)


def test_an_estimator_that_follows_the_truth_succeeds(followed):
    frames = followed.frames
    assert frames["clip"].tolist() == sorted(frames["clip"])
    assert frames["frame"].tolist()[:4] == [0, 1, 0, 1]
    assert list(followed.summaries) == list(analysis.REGIMES)
    assert followed.spread["verdict"].tolist() == ["varies"] * 3
    assert followed.conclusion.startswith("The estimates beat the constant θ fitted on the training contacts. Varies")
    assert followed.comparisons[analysis.CONSTANT]["wilcoxon_w"].value == 0
    assert any("observed motions of a contact behind them: 12." in sentence for sentence in followed.sentences)


def test_frames_that_share_an_observation_are_counted_once():
    shared = [record(SOFT, SOFT * 1.05, "one", 0) | {"frame": frame} for frame in range(8)]
    result = analysis.analyse(shared, TRAINING, MECHANICS, BOUNDS)
    assert any("Test frames: 8; observed motions of a contact behind them: 1." in told for told in result.sentences)
    assert result.conclusion.startswith("One clip: too few to judge whether the estimates beat the constant θ")


def test_errors_of_the_baselines_are_simulated_on_the_test_frames(followers, followed):
    ordered = sorted(followers, key=lambda one: (one["clip"], one["frame"]))
    first = Interaction(*(ordered[0][name] for name in ("mesh", "load", "observation")), MECHANICS.time_step)
    row, mean = followed.frames.iloc[0], np.mean([one["theta"] for one in followers], axis=0)
    for name, theta in (("error_constant", followed.constant), ("error_mean_theta", mean)):
        assert row[name] == pytest.approx(simulate_contacts(theta, [first], MECHANICS)[1][0], rel=1e-4)
    assert row["error_no_motion"] == pytest.approx(no_motion_errors([first], MECHANICS)[0])
    assert row["error_predicted"] == ordered[0]["error_predicted"]


def test_a_constant_estimator_is_called_collapsed_and_no_success():
    truths = [SOFT, HARD] * 5
    records = [record(theta, (0.5, 0.09, -0.1), f"clip {i}", i) for i, theta in enumerate(truths)]
    result = analysis.analyse(records, TRAINING, MECHANICS, BOUNDS)
    assert result.conclusion.startswith("No success")
    assert "Collapsed" in result.conclusion
    np.testing.assert_allclose(result.frames["error_mean_theta"], result.frames["error_predicted"], rtol=1e-3)


def test_simulations_that_are_not_finite_or_leave_the_scene_are_counted(followed):
    reference = followed.motion.loc[analysis.REFERENCE]
    assert (reference["not finite"], reference["peak over 1 scene unit"]) == (1, 1)
    assert followed.motion.loc[analysis.PREDICTED, "not finite"] == 0
    numbers = [followed.summaries[name]["n"].value for name in (analysis.REFERENCE, analysis.PREDICTED)]
    compared = followed.comparisons[analysis.REFERENCE]
    assert (numbers, compared["n"].value, compared["left_out"].value) == ([11, 12], 11, 1)


def test_without_training_contacts_there_is_no_constant():
    result = analysis.analyse([record(SOFT, SOFT)], [], MECHANICS, BOUNDS)
    assert np.isnan(result.constant).all()
    assert result.summaries[analysis.CONSTANT]["n"].value == 0
    assert result.conclusion.startswith("No conclusion")


def test_no_records_are_an_error():
    with pytest.raises(analysis.EvaluationError, match="no test pair is in contact"):
        analysis.analyse([], [], MECHANICS, BOUNDS)


COPY = 0.005 + 1e-4 * np.arange(20)


@pytest.mark.parametrize(
    ("decoder", "copy", "sensitivity", "change", "share", "reach"),
    [
        (0.8 * COPY, COPY, 0.5 * COPY, -20, "50", "reaches"),
        (1.1 * COPY, COPY, 0.01 * COPY, 10, "1", "hardly reaches"),
        (COPY, 0 * COPY, COPY, math.nan, "–", "hardly reaches"),
    ],
    ids=["better than copying", "ignores theta", "still scene"],
)
def test_next_depth(decoder, copy, sensitivity, change, share, reach):
    columns = {"next_depth_error": decoder, "copy_error": copy, "theta_sensitivity": sensitivity}
    depth = analysis.analyse_depth(pd.DataFrame(columns).assign(clip=np.repeat(list("abcd"), 5)))
    assert depth["comparison"]["relative_change_percent"].value == pytest.approx(change, nan_ok=True)
    assert f" {share} % of the change between frames" in analysis.describe_depth(depth)
    assert analysis.describe_depth(depth).endswith(f": θ {reach} the picture.")
