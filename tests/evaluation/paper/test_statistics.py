"""Statistics against hand computation, against scipy's own functions, and where n is too small."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from evaluation.paper.statistics import Comparison, compare, judge, relative_size, summarise

REGIME = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
BASELINE = REGIME + np.array([1.0, 2.0, -0.5, 3.0, 4.0, -1.5, 5.0, 6.0])
CLIPS = np.array(list("aabbccdd"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (-69.34, "69.3 % below"),
        (12.0, "12 % above"),
        (150.0, "2.5 times"),
        (6.48e4, "649 times"),
        (-0.009, "within 0.1 % of"),
    ],
)
def test_large_changes_read_as_factors(change, words):
    assert relative_size(change) == words


def test_summary_by_hand():
    summary = summarise(REGIME, CLIPS)
    assert (summary.n, summary.clips) == (8, 4)
    assert summary.mean == 4.5
    assert summary.sd == pytest.approx(math.sqrt(42 / 7))  # Σ(x−4.5)² = 42


def test_bca_interval_is_scipys_on_ten_thousand_resamples():
    values = np.random.default_rng(1).exponential(size=40)
    expected = stats.bootstrap(
        (values,), np.mean, n_resamples=10_000, method="BCa", batch=500, random_state=np.random.default_rng(0)
    ).confidence_interval
    assert summarise(values, np.zeros(40)).interval == pytest.approx(tuple(expected))
    # An independent check: for a mean of 40 values the interval is close to ±1.96 standard errors.
    error = values.std(ddof=1) / math.sqrt(40)
    assert expected.high - expected.low == pytest.approx(2 * 1.96 * error, rel=0.15)


def test_clip_interval_is_wider_when_clips_differ():
    values = np.repeat([0.0, 1.0, 2.0, 3.0], 25) + np.random.default_rng(0).normal(0, 0.01, 100)
    summary = summarise(values, np.repeat(list("abcd"), 25))
    assert summary.clip_interval[1] - summary.clip_interval[0] > 2 * (summary.interval[1] - summary.interval[0])
    # Resampling 4 clips of means 0..3: every resampled mean lies within 0 and 3 and the extremes are rare.
    assert -0.05 < summary.clip_interval[0] < 1
    assert 2 < summary.clip_interval[1] < 3.05
    assert summary.notes["clip_interval"] == "coarse: 4 clips"


def test_clip_interval_weighs_clips_by_their_frames():
    # All clips have the same mean, so no resample of clips can move it, however unequal their sizes.
    values = np.tile([1.0, 3.0], 6)
    clips = np.array(list("aabbbbcccccc"))
    assert summarise(values, clips).clip_interval == (2.0, 2.0)


def test_paired_tests_by_hand():
    result = compare(REGIME, BASELINE, CLIPS)
    difference = BASELINE - REGIME
    assert result.mean_difference == pytest.approx(19 / 8)
    assert result.relative_change_percent == pytest.approx(100 * (4.5 - 6.875) / 6.875)
    # Ranks of |d| = .5 1 1.5 2 3 4 5 6: the negative ones (−0.5, −1.5) have ranks 1 and 3.
    assert result.wilcoxon_w == 4.0
    assert result.wilcoxon_p == pytest.approx(stats.wilcoxon(BASELINE, REGIME).pvalue)
    sd = math.sqrt(sum((d - 19 / 8) ** 2 for d in difference) / 7)
    assert result.cohens_d == pytest.approx(19 / 8 / sd)
    assert result.t == pytest.approx(result.cohens_d * math.sqrt(8))
    assert result.t_p == pytest.approx(stats.ttest_rel(BASELINE, REGIME).pvalue)
    assert result.left_out == 0


def test_cohens_d_is_the_papers_variant():
    # Bini 2026, section 4.1: t = 5.16 over 176 frames goes with d = 0.390, which is t/√n.
    assert 5.16 / math.sqrt(176) == pytest.approx(0.390, abs=0.002)


def test_pairs_that_are_not_finite_are_counted_and_left_out():
    baseline = BASELINE.copy()
    baseline[[0, 3]] = np.nan, np.inf
    result = compare(REGIME, baseline, CLIPS)
    kept = np.array([1, 2, 4, 5, 6, 7])
    assert (result.n, result.left_out) == (6, 2)
    assert result.mean_difference == pytest.approx((BASELINE - REGIME)[kept].mean())


@pytest.mark.parametrize("n", [0, 1, 2, 4])
def test_too_small_samples_say_so(n):
    result = compare(REGIME[:n], BASELINE[:n], CLIPS[:n])
    assert result.wilcoxon_w is None
    assert result.notes["wilcoxon_w"].startswith("n too small")
    assert result.notes["difference_interval"].startswith("n too small")
    assert result.notes["difference_clip_interval"].startswith("n too small")
    assert (result.cohens_d is None) == (n < 2)
    assert judge(result) == "untested"
    summary = summarise(REGIME[:n], CLIPS[:n])
    assert (summary.sd is None) == (n < 2)
    assert (summary.mean is None) == (n < 1)
    assert summary.notes["interval"].startswith("n too small")


def test_equal_errors_give_no_statistic_and_no_warning():
    result = compare(REGIME, REGIME, CLIPS)
    assert result.t is None
    assert result.notes["t"] == "all differences are equal"
    assert result.notes["difference_interval"] == "all values are equal"
    assert result.notes["wilcoxon_w"].startswith("n too small (0 non-zero")
    assert result.relative_change_percent == 0


def test_lengths_must_agree():
    with pytest.raises(ValueError, match="equal lengths, got 8 errors, 7 baseline errors"):
        compare(REGIME, BASELINE[:7], CLIPS)


@pytest.mark.parametrize(("shift", "expected"), [(+1.0, "better"), (-1.0, "worse"), (0.0, "no different")])
def test_judge(shift, expected):
    noise = np.random.default_rng(3).normal(0, 0.5, 60)
    noise -= np.median(noise)
    regime = np.full(60, 10.0)
    assert judge(compare(regime, regime + shift + noise, np.zeros(60))) == expected


finite = st.floats(0.01, 100, allow_nan=False)


@settings(max_examples=20, deadline=None)
@given(arrays(float, 6, elements=finite), arrays(float, 6, elements=finite))
def test_swapping_the_regimes_swaps_the_signs(first, second):
    clips = np.array(list("aabbcc"))
    one, other = compare(first, second, clips), compare(second, first, clips)
    assert one.mean_difference == -other.mean_difference
    for name in ("wilcoxon_w", "wilcoxon_p", "t_p"):
        assert getattr(one, name) == pytest.approx(getattr(other, name))
    if one.t is not None:
        assert one.t == pytest.approx(-other.t)
    for comparison in (one, other):
        _no_hidden_nan(comparison)


def _no_hidden_nan(comparison: Comparison) -> None:
    for value in vars(comparison).values():
        for number in value if isinstance(value, tuple) else (value,):
            assert not (isinstance(number, float) and math.isnan(number))
