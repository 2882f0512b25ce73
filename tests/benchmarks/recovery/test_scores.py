"""The benchmark's table against values worked out by hand."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.recovery import scores as scoring
from palpate.physics.identifiability import NINETY
from tests.benchmarks.recovery_cases import off_by, recovery


def table(rows, onset="stamp"):
    frame = scoring.table(scoring.score_all(rows, onset))
    return {(row["regime"], row["parameter"]): row for row in frame.to_dict("records")}


def test_columns_are_those_that_were_agreed():
    assert ",".join(scoring.COLUMNS) == (
        "estimator,suite,regime,parameter,n,rmse_log,bound_log,ratio,constant_rmse_log,coverage90"
    )
    assert set(table([recovery()])["all", "stiffness"]) == set(scoring.COLUMNS)


def test_errors_bounds_and_coverage_by_hand():
    # Errors of log k_s 0.1 and −0.3: RMS √0.05. Bounds 0.1 each. ±1.645·0.1 holds the first and not the second.
    rows = [recovery(0, estimate=off_by([0.1, 0, 0])), recovery(1, estimate=off_by([-0.3, 0, 0]))]
    found = table(rows)
    row = found["all", "stiffness"]
    assert row["n"] == 2
    assert row["rmse_log"] == pytest.approx(math.sqrt(0.05))
    assert row["bound_log"] == pytest.approx(0.1)
    assert row["ratio"] == pytest.approx(math.sqrt(5))
    assert row["constant_rmse_log"] == pytest.approx(0, abs=1e-12)  # both clips have the same θ
    assert row["coverage90"] == 0.5
    # Regimes have rows of their own.
    assert found["under-damped", "stiffness"]["rmse_log"] == pytest.approx(0.1)
    assert found["critical", "stiffness"]["rmse_log"] == pytest.approx(0.3)
    assert found["over-damped", "stiffness"]["n"] == 0
    assert math.isnan(found["over-damped", "stiffness"]["rmse_log"])


def test_the_best_constant_is_that_of_the_row_s_own_clips():
    # Clips 0 and 3 are under-damped, 1 is critical; of clip 2, which is over-damped, k_s is not identifiable.
    vague = np.diag((1 / np.array([0.6, 0.1, 0.1])) ** 2)
    truths = [off_by([shift, 0, 0]) for shift in (0.0, 0.3, 1.2, 0.6)]
    rows = [recovery(index, theta=theta, estimate=theta) for index, theta in enumerate(truths)]
    rows[2] = recovery(2, theta=truths[2], estimate=truths[2], field_information=vague)
    found = table(rows)
    kept = np.array([0.0, 0.3, 0.6])
    assert found["all", "stiffness"]["constant_rmse_log"] == pytest.approx(np.sqrt(np.mean((kept - 0.3) ** 2)))
    least = min(np.sqrt(np.mean((kept - guess) ** 2)) for guess in np.linspace(-1, 2, 3001))
    assert found["all", "stiffness"]["constant_rmse_log"] == pytest.approx(least)
    assert found["under-damped", "stiffness"]["constant_rmse_log"] == pytest.approx(0.3)  # 0 and 0.6
    assert math.isnan(found["over-damped", "stiffness"]["constant_rmse_log"])
    assert found["all", "stiffness/damping"]["constant_rmse_log"] == pytest.approx(np.std([0, 0.3, 1.2, 0.6]))
    assert found["non-identifiable", "stiffness/damping"]["constant_rmse_log"] == pytest.approx(0, abs=1e-12)


def test_ratios_use_the_whole_covariance():
    # log k_s and log k_d share an error of 1 and differ by 0.1: the ratio's variance is 2·0.01·(1 − ρ) in closed form.
    common = np.ones((3, 3)) + 0.005 * np.eye(3)
    information = np.linalg.inv(common)
    found = table([recovery(2, field_information=information, covariance=common, estimate=off_by([1.0, 0.9, 1.0]))])
    assert found["all", "stiffness"]["n"] == 0  # a bound of 1 is beyond the limit
    for group in ("all", "over-damped", "non-identifiable"):
        row = found[group, "stiffness/damping"]
        assert row["rmse_log"] == pytest.approx(0.1)
        assert row["bound_log"] == pytest.approx(0.1)
        assert row["coverage90"] == 1.0
    assert table([recovery()])["non-identifiable", "force/damping"]["n"] == 0


def test_deviations_of_ratios_in_closed_form():
    # var(log a/b) = var(log a) + var(log b) − 2·cov(log a, log b).
    sds, correlations = np.array([0.1, 0.2, 0.4]), np.array([[1, 0.5, 0.3], [0.5, 1, -0.25], [0.3, -0.25, 1]])
    matrix = correlations * np.outer(sds, sds)
    expected = [0.1, 0.2, 0.4, math.sqrt(0.01 + 0.04 - 2 * 0.01), math.sqrt(0.16 + 0.04 + 2 * 0.02)]
    assert scoring.QUANTITIES[3:] == ("stiffness/damping", "force/damping")
    assert scoring.deviations(matrix) == pytest.approx(expected)
    # The same of many at once; where all errors are one, ratios have none.
    found = scoring.deviations(np.stack([matrix, 9 * matrix, 0.25 * np.ones((3, 3)), np.full((3, 3), np.nan)]))
    np.testing.assert_allclose(found[:2], [expected, 3 * np.array(expected)], rtol=1e-12)
    np.testing.assert_allclose(found[2], [0.5, 0.5, 0.5, 0, 0], atol=1e-12)
    assert np.isnan(found[3]).all()
    assert found.shape == (4, 5)


def test_identifiable_is_decided_for_each_parameter():
    information = np.diag((1 / np.array([0.1, 0.6, 0.1])) ** 2)
    found = table([recovery(0, field_information=information)])
    assert [found["all", name]["n"] for name in scoring.QUANTITIES] == [1, 0, 1, 1, 1]
    assert [found["every clip", name]["n"] for name in scoring.QUANTITIES[:3]] == [1, 1, 1]
    assert found["every clip", "damping"]["coverage90"] == 1.0
    assert found["every clip", "damping"]["bound_log"] == pytest.approx(0.6)
    assert found["non-identifiable", "force/damping"]["n"] == 1


def test_coverage_is_empty_without_standard_deviations():
    assert math.isnan(table([recovery(covariance=None)])["all", "stiffness"]["coverage90"])


def test_calibrated_and_efficient_estimates_score_1_and_90_percent():
    generator = np.random.default_rng(0)
    rows = [recovery(index, estimate=off_by(generator.normal(0, 0.1, 3))) for index in range(4000)]
    row = table(rows)["all", "damping"]
    assert row["ratio"] == pytest.approx(1, abs=0.03)  # relative error of an RMS of n: 1/√(2n) = 0.011
    assert row["coverage90"] == pytest.approx(0.9, abs=0.015)  # √(0.09/4000) = 0.005


def test_the_interval_is_the_normal_one():
    assert norm.cdf(NINETY) - norm.cdf(-NINETY) == pytest.approx(0.9)
    assert scoring.coverage(np.array([0.16, -0.17]), np.array([0.1, 0.1])) == 0.5


def test_without_a_sequence_the_sequence_bounds_nothing():
    rows = [recovery(0), recovery(1, field_information=None)]
    assert table(rows)["all", "stiffness"]["n"] == 1
    assert table(rows)["every clip", "stiffness"]["n"] == 2


def test_whoever_does_not_know_the_instants_pays_for_the_delays():
    # Of log k_s and the first delay [[100, 60], [60, 45]]; a delay from -1 to 1 is known to 1/√3 beforehand. What is
    # left of k_s is 100 − 60²/(45 + 3) = 25; of k_d, which no delay looks like, 100.
    information = np.diag([100.0, 100.0, 100.0, 45.0, 0.0])
    information[0, 3] = information[3, 0] = 60.0
    rows = [recovery(0, field_information=information)]
    stamp, between = (table(rows, onset) for onset in ("stamp", "between"))
    bounds = [[found["all", name]["bound_log"] for name in scoring.QUANTITIES[:2]] for found in (stamp, between)]
    assert bounds[0] == pytest.approx([0.1, 0.1])
    assert bounds[1] == pytest.approx([0.2, 0.1])


def test_clips_without_estimate_are_kept_apart():
    rows = [recovery(0), recovery(1, status="no contact", estimate=None, covariance=None, field_information=None)]
    scores = scoring.score(rows)
    assert [row["index"] for row in scores.rows] == [0]
    assert [row["index"] for row in scores.failed] == [1]
    failed = recovery(0, status="no contact", estimate=None, covariance=None, field_information=None)
    assert {row["n"] for row in table([failed]).values()} == {0}
