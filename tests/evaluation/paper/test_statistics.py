"""Statistics against hand computation, against scipy's own functions, and where n is too small."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from palpate.evaluation.paper import statistics

REGIME = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
BASELINE = REGIME + np.array([1.0, 2.0, -0.5, 3.0, 4.0, -1.5, 5.0, 6.0])
CLIPS = np.array(list("aabbccdd"))


@pytest.mark.parametrize(
    ("value", "text"),
    [(math.nan, "–"), (3, "3"), (12345, "12345"), (0.00428123, "0.004281"), (2.5e-8, "2.5e−8"), (-8.4, "−8.4"),
     (1e12, "1e+12"), (math.inf, "inf"), ("n too small", "n too small")],
)  # fmt: skip
def test_numbers(value, text):
    assert statistics.format_number(value) == text


def test_statistics_read_as_number_interval_or_why_there_is_none():
    assert str(statistics.Statistic(0.5)) == "0.5"
    assert str(statistics.Statistic(low=-1.0, high=2.0)) == "[−1, 2]"
    assert str(statistics.Statistic(note="n too small")) == "n too small"


def test_summary_by_hand():
    summary = statistics.summarise(REGIME, CLIPS)
    assert (summary["n"].value, summary["clips"].value) == (8, 4)
    assert summary["mean"].value == 4.5
    assert summary["sd"].value == pytest.approx(math.sqrt(42 / 7))  # Σ(x−4.5)² = 42


def test_bca_interval_is_scipys_on_ten_thousand_resamples():
    values = np.random.default_rng(1).exponential(size=40)
    expected = stats.bootstrap(
        (values,), np.mean, n_resamples=10_000, method="BCa", batch=500, random_state=np.random.default_rng(0)
    ).confidence_interval
    interval = statistics.summarise(values, np.zeros(40))["interval"]
    assert (interval.low, interval.high) == pytest.approx(tuple(expected))
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
    assert (found["n"].value, found["wilcoxon_w"].value) == (176, 3658)
    assert found["wilcoxon_p"].value == pytest.approx(1.05e-9, rel=0.005)
    spread = np.random.default_rng(0).normal(size=176)
    spread = (spread - spread.mean()) / spread.std(ddof=1) + 5.16 / math.sqrt(176)
    found = statistics.compare(np.zeros(176), spread, np.zeros(176))
    assert found["t"].value == pytest.approx(5.16)
    assert found["t_p"].value == pytest.approx(6.65e-7, rel=0.005)
    assert found["cohens_d"].value == pytest.approx(0.389, abs=5e-4)


def test_clip_interval_is_wider_when_clips_differ():
    values = np.repeat([0.0, 1.0, 2.0, 3.0], 25) + np.random.default_rng(0).normal(0, 0.01, 100)
    summary = statistics.summarise(values, np.repeat(list("abcd"), 25))
    frames, whole = summary["interval"], summary["clip_interval"]
    assert whole.high - whole.low > 2 * (frames.high - frames.low)
    # Resampling 4 clips of means 0..3: every resampled mean lies within 0 and 3 and the extremes are rare.
    assert -0.05 < whole.low < 1
    assert 2 < whole.high < 3.05


def test_clip_interval_weighs_clips_by_their_frames():
    # All clips have the same mean, so no resample of clips can move it, however unequal their sizes.
    values = np.tile([1.0, 3.0], 6)
    clips = np.array(list("aabbbbcccccc"))
    assert statistics.summarise(values, clips)["clip_interval"] == statistics.Statistic(
        pytest.approx(math.nan, nan_ok=True), 2.0, 2.0
    )


def test_paired_tests_by_hand():
    result = statistics.compare(REGIME, BASELINE, CLIPS)
    difference = BASELINE - REGIME
    assert result["mean_difference"].value == pytest.approx(19 / 8)
    assert result["relative_change_percent"].value == pytest.approx(100 * (4.5 - 6.875) / 6.875)
    # Ranks of |d| = .5 1 1.5 2 3 4 5 6: the negative ones (−0.5, −1.5) have ranks 1 and 3.
    assert result["wilcoxon_w"].value == 4.0
    assert result["wilcoxon_p"].value == pytest.approx(stats.wilcoxon(BASELINE, REGIME).pvalue)
    sd = math.sqrt(sum((d - 19 / 8) ** 2 for d in difference) / 7)
    assert result["cohens_d"].value == pytest.approx(19 / 8 / sd)
    assert result["t"].value == pytest.approx(result["cohens_d"].value * math.sqrt(8))
    assert result["t_p"].value == pytest.approx(stats.ttest_rel(BASELINE, REGIME).pvalue)
    assert result["left_out"].value == 0


def test_pairs_that_are_not_finite_are_counted_and_left_out():
    baseline = BASELINE.copy()
    baseline[[0, 3]] = np.nan, np.inf
    result = statistics.compare(REGIME, baseline, CLIPS)
    kept = np.array([1, 2, 4, 5, 6, 7])
    assert (result["n"].value, result["left_out"].value) == (6, 2)
    assert result["mean_difference"].value == pytest.approx((BASELINE - REGIME)[kept].mean())


@pytest.mark.parametrize("n", [0, 1, 2, 4])
def test_too_small_samples_say_so(n):
    result = statistics.compare(REGIME[:n], BASELINE[:n], CLIPS[:n])
    assert math.isnan(result["wilcoxon_w"].value)
    assert result["wilcoxon_w"].note.startswith("n too small")
    assert result["difference_interval"].note.startswith("n too small")
    assert result["difference_clip_interval"].note.startswith("n too small")
    assert math.isnan(result["cohens_d"].value) == (n < 2)
    assert statistics.judge(result) == "too few to judge"
    summary = statistics.summarise(REGIME[:n], CLIPS[:n])
    assert math.isnan(summary["sd"].value) == (n < 2)
    assert math.isnan(summary["mean"].value) == (n < 1)
    assert summary["interval"].note.startswith("n too small")


def test_equal_errors_give_no_statistic_and_no_warning():
    result = statistics.compare(REGIME, REGIME, CLIPS)
    assert math.isnan(result["t"].value)
    assert result["t"].note == "all differences are equal"
    assert result["difference_interval"].note == "all values are equal"
    assert result["wilcoxon_w"].note.startswith("n too small (non-zero differences: 0")
    assert result["relative_change_percent"].value == 0


def test_one_sentence_tells_the_verdict_and_its_grounds():
    noise = np.random.default_rng(0).normal(0, 0.1, 100)
    text = statistics.describe(statistics.compare(np.ones(100), 1.25 + noise, np.arange(100) % 6), "A", "B")
    assert text.startswith("A against B: better. Change of the mean error [%]: −2")
    assert "Wilcoxon p: " in text
    assert "frames: 100 of clips: 6; mean difference over resampled clips: [0.2" in text
    few = statistics.describe(statistics.compare(np.ones(2), np.zeros(2) + 3, np.zeros(2)), "A", "B")
    assert few.startswith("A against B: too few to judge.")
    assert "Wilcoxon p: n too small (non-zero differences: 2, 6 needed)" in few
    assert "nan" not in statistics.describe(statistics.compare(np.array([np.nan]), np.array([1.0]), ["a"]), "A", "B")


@pytest.mark.parametrize(("shift", "expected"), [(+1.0, "better"), (-1.0, "worse"), (0.0, "no different")])
def test_judge(shift, expected):
    noise = np.random.default_rng(3).normal(0, 0.5, 60)
    noise -= np.median(noise)
    regime = np.full(60, 10.0)
    baseline = regime + shift + noise
    assert statistics.judge(statistics.compare(regime, baseline, np.arange(60) // 10)) == expected  # 6 clips
    for clips in (1, 5):
        assert statistics.judge(statistics.compare(regime, baseline, np.arange(60) % clips)) == "too few to judge"


def test_fewer_than_six_can_not_reach_the_level_of_a_signed_rank_test():
    """2/2ⁿ is the smallest two-sided p, of differences that all have one sign."""
    assert statistics.MINIMUM_FOR_WILCOXON == 6
    for n in range(2, 12):
        smallest = stats.wilcoxon(np.arange(1.0, n + 1), method="exact").pvalue
        assert smallest == pytest.approx(2 / 2**n)
        assert (smallest < statistics.SIGNIFICANCE) == (n >= statistics.MINIMUM_FOR_WILCOXON)


finite = st.floats(0.01, 100, allow_nan=False)


@settings(max_examples=10, deadline=None)
@given(arrays(float, 6, elements=finite), arrays(float, 6, elements=finite))
def test_swapping_the_regimes_swaps_the_signs(first, second):
    clips = np.array(list("aabbcc"))
    one, other = statistics.compare(first, second, clips), statistics.compare(second, first, clips)
    assert one["mean_difference"].value == -other["mean_difference"].value
    for name in ("wilcoxon_w", "wilcoxon_p", "t_p"):
        assert one[name].value == pytest.approx(other[name].value, nan_ok=True)
    assert one["t"].value == pytest.approx(-other["t"].value, nan_ok=True)
    for statistic in (*one.values(), *other.values()):
        assert statistic.note or not math.isnan(statistic.value) or statistic.low <= statistic.high
