"""Means, intervals and paired tests of the evaluation's errors (Bini 2026, section 4.1 and table 2).

Frames of one clip are autocorrelated, so beside the paper's tests, which take frames as independent, every mean and
every difference also gets a bootstrap over whole clips. A statistic that can't be computed is None; `notes` says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy import stats

RESAMPLES = 10_000
"""Bootstrap resamples (Bini 2026, section 4.1)."""
CONFIDENCE = 0.95
SIGNIFICANCE = 0.05
MINIMUM_FOR_BCA = 5
"""Fewest values for a BCa interval; below this the jackknife behind its acceleration means nothing."""
MINIMUM_FOR_WILCOXON = 6
"""Fewest non-zero differences: with 5, no two-sided p-value can fall below 0.05."""
MINIMUM_CLIPS = 3
"""Fewest clips for a bootstrap over clips."""
COARSE_CLIPS = 10
"""Below this many clips the bootstrap over clips is reported with the remark that it is coarse."""
LEAST_CHANGE = 0.1
"""Relative changes below this [%] are not told apart in words."""
RESAMPLES_AT_ONCE = 500
"""Resamples held in memory together."""

Interval = tuple[float, float]
Told = tuple[float | Interval | None, str]
"""A statistic, and why it is None or what to keep in mind."""


@dataclass(frozen=True)
class Summary:
    """One regime's errors in numbers; None where there were too few values, with the reason in `notes`."""

    n: int
    """Number of values (frames)."""
    clips: int
    """Number of clips that the frames come from."""
    mean: float | None
    sd: float | None
    """Sample standard deviation (n − 1)."""
    interval: Interval | None
    """BCa 95 % interval of the mean, frames taken as independent."""
    clip_interval: Interval | None
    """95 % interval of the mean from resampling whole clips (percentile method)."""
    notes: dict[str, str] = field(default_factory=dict)
    """Field name → why it is None, or what to keep in mind."""


@dataclass(frozen=True)
class Comparison:
    """Paired comparison of a regime with a baseline; differences are baseline − regime, so positive = regime better."""

    n: int
    """Number of pairs in which both errors are finite."""
    clips: int
    left_out: int
    """Pairs left out because one of the two errors isn't finite."""
    mean_difference: float | None
    relative_change_percent: float | None
    """100·(mean regime − mean baseline)/mean baseline; negative = the regime's error is lower."""
    difference_interval: Interval | None
    """BCa 95 % interval of the mean difference, frames taken as independent."""
    difference_clip_interval: Interval | None
    """95 % interval of the mean difference from resampling whole clips."""
    wilcoxon_w: float | None
    """Wilcoxon signed-rank statistic: the smaller of the two rank sums."""
    wilcoxon_p: float | None
    t: float | None
    t_p: float | None
    """Paired t-test, two-sided."""
    cohens_d: float | None
    """Paired Cohen's d_z = mean(difference)/SD(difference) = t/√n, the variant behind the paper's 0.390."""
    notes: dict[str, str] = field(default_factory=dict)


def _too_small(count: int, needed: int, unit: str) -> str:
    return f"n too small ({count} {unit if count != 1 else unit.removesuffix('s')}, {needed} needed)"


def bca_interval(values: np.ndarray, seed: int = 0) -> tuple[Interval | None, str]:
    """BCa bootstrap interval of the mean of values [n]; the second entry says why it is None."""
    if len(values) < MINIMUM_FOR_BCA:
        return None, _too_small(len(values), MINIMUM_FOR_BCA, "values")
    if np.ptp(values) == 0:
        return None, "all values are equal"
    result = stats.bootstrap(
        (values,), np.mean, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="BCa",
        batch=RESAMPLES_AT_ONCE, random_state=np.random.default_rng(seed),
    )  # fmt: skip
    low, high = map(float, result.confidence_interval)
    if not (np.isfinite(low) and np.isfinite(high)):
        return None, "the resamples are degenerate"
    return (low, high), ""


def clip_interval(values: np.ndarray, clips: np.ndarray, seed: int = 0) -> tuple[Interval | None, str]:
    """Interval of the mean of values [n] over resamples of whole clips, whose names [n] are `clips`.

    A percentile interval: with a handful of clips BCa's acceleration would itself be noise.
    """
    _, block = np.unique(clips, return_inverse=True)
    count = int(block.max()) + 1 if len(block) else 0
    if count < MINIMUM_CLIPS:
        return None, _too_small(count, MINIMUM_CLIPS, "clips")
    totals, sizes = np.bincount(block, weights=values), np.bincount(block).astype(float)
    result = stats.bootstrap(
        (totals, sizes), lambda total, size, axis=-1: total.sum(axis=axis) / size.sum(axis=axis), paired=True,
        n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="percentile", vectorized=True,
        batch=RESAMPLES_AT_ONCE, random_state=np.random.default_rng(seed),
    )  # fmt: skip
    low, high = map(float, result.confidence_interval)
    return (low, high), f"coarse: {count} clips" if count < COARSE_CLIPS else ""


def _named(found: Mapping[str, Told]) -> dict[str, Any]:
    """Statistics by name, and as `notes` what there is to say of them."""
    notes = {name: note for name, (_, note) in found.items() if note}
    return {name: value for name, (value, _) in found.items()} | {"notes": notes}


def summarise(values: np.ndarray, clips: np.ndarray) -> Summary:
    """Mean, SD and both intervals of finite values [n] from the clips [n]."""
    values, clips = np.asarray(values, dtype=float), np.asarray(clips)
    n = len(values)
    found: dict[str, Told] = {
        "mean": (float(values.mean()), "") if n else (None, _too_small(n, 1, "values")),
        "sd": (float(values.std(ddof=1)), "") if n > 1 else (None, _too_small(n, 2, "values")),
        "interval": bca_interval(values),
        "clip_interval": clip_interval(values, clips),
    }
    return Summary(n=n, clips=len(np.unique(clips)), **_named(found))


def _wilcoxon(difference: np.ndarray) -> dict[str, Told]:
    nonzero = int(np.count_nonzero(difference))
    if nonzero < MINIMUM_FOR_WILCOXON:
        note = _too_small(nonzero, MINIMUM_FOR_WILCOXON, "non-zero differences")
        return dict.fromkeys(("wilcoxon_w", "wilcoxon_p"), (None, note))
    result = stats.wilcoxon(difference)
    return {"wilcoxon_w": (float(result.statistic), ""), "wilcoxon_p": (float(result.pvalue), "")}


def _paired_t(difference: np.ndarray) -> dict[str, Told]:
    count, note = len(difference), ""
    sd = float(difference.std(ddof=1)) if count > 1 else 0.0
    if count < 2:
        note = _too_small(count, 2, "pairs")
    # Differences that agree to rounding have no spread to test against; t would be the rounding's.
    elif sd <= 1e-12 * float(np.abs(difference).max()):
        note = "all differences are equal"
    if note:
        return dict.fromkeys(("t", "t_p", "cohens_d"), (None, note))
    result = stats.ttest_1samp(difference, 0.0)
    values = {"t": result.statistic, "t_p": result.pvalue, "cohens_d": difference.mean() / sd}
    return {name: (float(value), "") for name, value in values.items()}


def _changes(regime: np.ndarray, baseline: np.ndarray) -> dict[str, Told]:
    if not len(regime):
        note = _too_small(0, 1, "pairs")
        return dict.fromkeys(("mean_difference", "relative_change_percent"), (None, note))
    after, before = float(regime.mean()), float(baseline.mean())
    percent = (100 * (after - before) / before, "") if before > 0 else (None, "the baseline's error is 0")
    return {"mean_difference": (float((baseline - regime).mean()), ""), "relative_change_percent": percent}


def compare(regime: np.ndarray, baseline: np.ndarray, clips: np.ndarray) -> Comparison:
    """Paired statistics of two regimes' errors on the same frames.

    Args:
        regime: errors with the parameters under test, shape [n]; not-finite entries are left out in pairs and counted.
        baseline: errors of the baseline on the same frames, shape [n].
        clips: clip of each frame, shape [n].

    Raises:
        ValueError: the three lengths differ.
    """
    regime, baseline, clips = np.asarray(regime, float), np.asarray(baseline, float), np.asarray(clips)
    if not len(regime) == len(baseline) == len(clips):
        raise ValueError(
            f"a paired comparison needs equal lengths, got {len(regime)} errors, {len(baseline)} baseline errors and "
            f"{len(clips)} clip names; give one of each per frame."
        )
    finite = np.isfinite(regime) & np.isfinite(baseline)
    regime, baseline, clips = regime[finite], baseline[finite], clips[finite]
    difference = baseline - regime
    found = _changes(regime, baseline) | {
        "difference_interval": bca_interval(difference),
        "difference_clip_interval": clip_interval(difference, clips),
    }
    return Comparison(
        n=len(difference),
        clips=len(np.unique(clips)),
        left_out=int(np.count_nonzero(~finite)),
        **_named(found | _wilcoxon(difference) | _paired_t(difference)),
    )


def relative_size(change_percent: float) -> str:
    """A relative change in words, before "that of …": percentages up to a doubling, factors above."""
    if abs(change_percent) < LEAST_CHANGE:
        return f"within {LEAST_CHANGE:g} % of"
    factor = 1 + change_percent / 100
    if factor >= 2:
        return f"{factor:.2g} times" if factor < 10 else f"{factor:,.0f} times"
    return f"{abs(change_percent):.3g} % {'below' if change_percent < 0 else 'above'}"


def judge(comparison: Comparison) -> Literal["better", "worse", "no different", "untested"]:
    """Whether the regime beats the baseline: a lower mean error, and Wilcoxon's p below 0.05.

    "untested" where n is too small for the test.
    """
    if comparison.wilcoxon_p is None or comparison.mean_difference is None:
        return "untested"
    if comparison.wilcoxon_p >= SIGNIFICANCE or comparison.mean_difference == 0:
        return "no different"
    return "better" if comparison.mean_difference > 0 else "worse"
