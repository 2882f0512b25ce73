"""Details of the benchmark against closed forms."""

import numpy as np
import pytest

from benchmarks.recovery.details import COLUMNS, detail_table, ranks, true_verdicts
from benchmarks.recovery.scores import score_all
from tests.benchmarks.recovery_cases import BY_CONTACT, off_by, recovery


def details(rows):
    frame = detail_table(score_all(rows, BY_CONTACT))
    assert tuple(frame.columns) == COLUMNS
    return {(row["regime"], row["parameter"], row["quantity"]): row for row in frame.to_dict("records")}


def test_a_constant_estimate_has_no_spread():
    found = details([recovery(i, theta=off_by([0.1 * i, 0, 0])) for i in range(5)])
    assert found["all", "stiffness", "collapse"]["value"] == pytest.approx(0)


def test_ranks_of_truths_are_even_where_posteriors_are_right():
    """A truth one standard deviation below the estimate has a sixth of the posterior below it."""
    np.testing.assert_allclose(ranks(np.array([0.2, 0.0, -0.2]), np.full(3, 0.2)), [0.158655, 0.5, 0.841345], atol=1e-6)
    generator = np.random.default_rng(3)
    errors = generator.normal(0, 0.1, (200, 3))

    def uniformity(shift: float, sd: float) -> float:
        known = {"covariance": sd**2 * np.eye(3)}
        rows = [recovery(i, estimate=off_by(error + shift), **known) for i, error in enumerate(errors)]
        return details(rows)["all", "stiffness", "rank_uniformity"]["value"]

    right, narrow, biased = uniformity(0.0, 0.1), uniformity(0.0, 0.04), uniformity(0.05, 0.1)
    assert right > 0.1
    assert max(narrow, biased) < 1e-4
    assert ("all", "stiffness", "rank_uniformity") not in details([recovery(i, covariance=None) for i in range(5)])


def test_warnings_are_counted():
    rows = [recovery(0, warned=True), recovery(1, warned=False), recovery(2, warned=False), recovery(3)]
    row = details(rows)["all", "all", "warned"]
    assert (row["n"], row["value"]) == (3, pytest.approx(1 / 3))
    assert ("all", "all", "warned") not in details([recovery(0)])


def test_how_far_off_presses_were_found_and_failures_are_counted():
    rows = [recovery(0, onset_off=1.0), recovery(1, onset_off=0.0), recovery(2, onset_off=1.0, release_off=-0.5)]
    found = details(rows)
    row = found["all", "all", "onset_off"]
    assert (row["n"], row["value"], row["note"]) == (3, pytest.approx(2 / 3), "1 by +0; 2 by +1")
    assert (found["all", "all", "release_off"]["n"], found["all", "all", "release_off"]["note"]) == (1, "1 by -0.5")
    assert ("all", "all", "place_off") not in found
    lost = {"estimate": None, "covariance": None, "information": None}
    rows = [recovery(0), recovery(1, status="no contact", **lost), recovery(2, status="other onset", **lost)]
    row = details(rows)["all", "all", "failed"]
    assert (row["n"], row["value"], row["note"]) == (3, 2, "no contact 1; other onset 1")


def test_verdicts_and_which_are_clear():
    bounds = np.array(
        [
            [0.1, 0.2, 0.3, 0.1, 0.1],  # determined, clearly
            [0.1, 0.4, 0.1, 0.1, 0.1],  # determined, 0.4 within a factor 1.5 of 0.5
            [2.0, 2.0, 2.0, 0.1, 0.1],  # ratios, clearly
            [2.0, 2.0, 2.0, 0.4, 0.1],  # ratios, but one ratio is near the limit
            [2.0, 2.0, 2.0, 0.9, 0.1],  # undetermined, clearly
        ]
    )
    verdicts, clear = true_verdicts(bounds)
    assert verdicts.tolist() == ["determined", "determined", "ratios", "ratios", "undetermined"]
    assert clear.tolist() == [True, False, True, False, True]


def test_verdict_accuracy_is_that_of_clear_clips():
    rows = [recovery(0), recovery(1, verdict="ratios")]
    row = details(rows)["all", "all", "verdict_accuracy_clear"]
    assert (row["n"], row["value"]) == (2, 0.5)
    assert ("all", "all", "verdict_accuracy_clear") not in details([recovery(verdict="")])
