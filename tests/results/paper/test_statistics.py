"""Statistics against hand computation, against scipy's own functions, and where n is too small."""

import math

import numpy as np
import pytest
from scipy import stats

from palpate.results.paper import statistics

REGIME = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
BASELINE = REGIME + np.array([1.0, 2.0, -0.5, 3.0, 4.0, -1.5, 5.0, 6.0])
CLIPS = np.array(list("aabbccdd"))


def test_summary_by_hand():
    summary = statistics.summarise(REGIME, CLIPS)
    assert (summary["frames"], summary["clips"]) == (8, 4)
    assert summary["mean"] == 4.5
    assert summary["sd"] == pytest.approx(math.sqrt(42 / 7))  # Σ(x−4.5)² = 42


def test_bca_interval_is_scipys_on_ten_thousand_resamples():
    values = np.random.default_rng(1).exponential(size=40)
    expected = stats.bootstrap(
        (values,), np.mean, n_resamples=10_000, method="BCa", batch=500, random_state=np.random.default_rng(0)
    ).confidence_interval
    summary = statistics.summarise(values, np.zeros(40))
    assert (summary["low"], summary["high"]) == pytest.approx(tuple(expected))
    # An independent check: for a mean of 40 values the interval is close to ±1.96 standard errors.
    error = values.std(ddof=1) / math.sqrt(40)
    assert expected.high - expected.low == pytest.approx(2 * 1.96 * error, rel=0.15)


def test_the_paper_s_w_and_t_give_other_p_than_it_prints():
    """W = 3658 and t = 5.16 of 176 frames (section 4.1), of which it prints p = 2.49e-8 and 1.1e-6."""
    ranks, missing = np.arange(1.0, 177.0), 3658
    for rank in range(176, 0, -1):  # the negative ranks add up to W
        if rank <= missing:
            ranks[rank - 1], missing = -rank, missing - rank
    found = statistics.compare(np.zeros(176), ranks, np.zeros(176))
    assert (found["frames"], found["wilcoxon_w"]) == (176, 3658)
    assert found["wilcoxon_p"] == pytest.approx(1.05e-9, rel=0.005)
    spread = np.random.default_rng(0).normal(size=176)
    spread = (spread - spread.mean()) / spread.std(ddof=1) + 5.16 / math.sqrt(176)
    found = statistics.compare(np.zeros(176), spread, np.zeros(176))
    assert found["t"] == pytest.approx(5.16)
    assert found["t_p"] == pytest.approx(6.65e-7, rel=0.005)
    assert found["cohens_d"] == pytest.approx(0.389, abs=5e-4)


def test_clip_interval_is_wider_when_clips_differ():
    values = np.repeat([0.0, 1.0, 2.0, 3.0], 25) + np.random.default_rng(0).normal(0, 0.01, 100)
    summary = statistics.summarise(values, np.repeat(list("abcd"), 25))
    low, high = summary["clip_low"], summary["clip_high"]
    assert high - low > 2 * (summary["high"] - summary["low"])
    # Resampling 4 clips of means 0..3: every resampled mean lies within 0 and 3 and the extremes are rare.
    assert -0.05 < low < 1
    assert 2 < high < 3.05


def test_clip_interval_weighs_clips_by_their_frames():
    # All clips have the same mean, so no resample of clips can move it, however unequal their sizes.
    values = np.tile([1.0, 3.0], 6)
    clips = np.array(list("aabbbbcccccc"))
    summary = statistics.summarise(values, clips)
    assert (summary["clip_low"], summary["clip_high"]) == (2.0, 2.0)


def test_paired_tests_by_hand():
    result = statistics.compare(REGIME, BASELINE, CLIPS)
    difference = BASELINE - REGIME
    assert result["mean_difference"] == pytest.approx(19 / 8)
    assert result["change_percent"] == pytest.approx(100 * (4.5 - 6.875) / 6.875)
    # Ranks of |d| = .5 1 1.5 2 3 4 5 6: the negative ones (−0.5, −1.5) have ranks 1 and 3.
    assert result["wilcoxon_w"] == 4.0
    assert result["wilcoxon_p"] == pytest.approx(stats.wilcoxon(BASELINE, REGIME).pvalue)
    sd = math.sqrt(sum((d - 19 / 8) ** 2 for d in difference) / 7)
    assert result["cohens_d"] == pytest.approx(19 / 8 / sd)
    assert result["t"] == pytest.approx(result["cohens_d"] * math.sqrt(8))
    assert result["t_p"] == pytest.approx(stats.ttest_rel(BASELINE, REGIME).pvalue)
    assert result["left_out"] == 0


def test_pairs_that_are_not_finite_are_counted_and_left_out():
    baseline = BASELINE.copy()
    baseline[[0, 3]] = np.nan, np.inf
    result = statistics.compare(REGIME, baseline, CLIPS)
    kept = np.array([1, 2, 4, 5, 6, 7])
    assert (result["frames"], result["left_out"]) == (6, 2)
    assert result["mean_difference"] == pytest.approx((BASELINE - REGIME)[kept].mean())


@pytest.mark.parametrize("n", [0, 1, 2, 4])
def test_of_too_few_nothing_is_computed(n):
    result = statistics.compare(REGIME[:n], BASELINE[:n], CLIPS[:n])
    assert np.isnan([result[name] for name in ("wilcoxon_w", "low", "clip_low")]).all()
    assert math.isnan(result["cohens_d"]) == (n < 2)
    summary = statistics.summarise(REGIME[:n], CLIPS[:n])
    assert (math.isnan(summary["sd"]), math.isnan(summary["mean"])) == (n < 2, n < 1)


def test_equal_errors_give_no_statistic_and_no_warning():
    result = statistics.compare(REGIME, REGIME, CLIPS)
    assert np.isnan([result[name] for name in ("t", "low", "wilcoxon_w")]).all()
    assert result["change_percent"] == 0
