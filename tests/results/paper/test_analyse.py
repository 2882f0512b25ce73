"""The evaluation's numbers, from records whose answer is known."""

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.results.paper.report import CONSTANT, PREDICTED, REFERENCE, analyse
from palpate.results.paper.simulated import no_motion_errors, simulate_contacts
from tests.results.paper.simple_contacts import BOUNDS, MECHANICS, contact, record

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
    return analyse(followers[::-1], TRAINING, MECHANICS, BOUNDS)


def test_an_estimator_that_follows_the_truth_beats_the_constant(followed):
    compared = followed.tables["comparisons.csv"].loc[CONSTANT]
    assert compared["clip_low"] > 0
    assert compared["wilcoxon_w"] == 0
    assert followed.tables["spread.csv"]["verdict"].tolist() == ["varies"] * 3


def test_errors_of_the_baselines_are_simulated_on_the_test_frames(followers, followed):
    ordered = sorted(followers, key=lambda one: (one["clip"], one["frame"]))
    first = Interaction(
        ordered[0]["mesh"], ordered[0]["load"], {"point": ordered[0]["observation"]}, MECHANICS.time_step
    )
    row, mean = followed.tables["per_frame.csv"].iloc[0], np.mean([one["theta"] for one in followers], axis=0)
    for name, theta in (("error_constant", followed.constant), ("error_mean_theta", mean)):
        assert row[name] == pytest.approx(simulate_contacts(theta, [first], MECHANICS)[1][0], rel=1e-4)
    assert row["error_no_motion"] == pytest.approx(no_motion_errors([first], MECHANICS)[0])
    assert row["error_predicted"] == ordered[0]["error_predicted"]


def test_a_constant_estimator_has_collapsed_and_beats_no_constant():
    truths = [SOFT, HARD] * 5
    records = [record(theta, (0.5, 0.09, -0.1), f"clip {i}", i) for i, theta in enumerate(truths)]
    result = analyse(records, TRAINING, MECHANICS, BOUNDS)
    assert result.tables["spread.csv"]["verdict"].tolist() == ["constant"] * 3
    assert result.tables["comparisons.csv"].loc[CONSTANT, "mean_difference"] < 0
    frames = result.tables["per_frame.csv"]
    np.testing.assert_allclose(frames["error_mean_theta"], frames["error_predicted"], rtol=1e-3)


def test_simulations_that_are_not_finite_or_leave_the_scene_are_counted(followed):
    motion, errors = followed.tables["motion.csv"], followed.tables["table_2.csv"]
    assert motion.loc[REFERENCE, ["not finite", "peak over 1 scene unit"]].tolist() == [1, 1]
    assert motion.loc[PREDICTED, "not finite"] == 0
    assert errors.loc[[REFERENCE, PREDICTED], "frames"].tolist() == [11, 12]
    assert followed.tables["comparisons.csv"].loc[REFERENCE, ["frames", "left_out"]].tolist() == [11, 1]
