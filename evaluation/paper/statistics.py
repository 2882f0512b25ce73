"""Means, intervals and paired tests of the evaluation's errors (Bini 2026, section 4.1 and table 2).

Frames of one clip are autocorrelated, and the paper's tests take frames as independent, so every mean and every
difference also gets a bootstrap over whole clips.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

RESAMPLES = 10_000
"""Bootstrap resamples (Bini 2026, section 4.1)."""
CONFIDENCE = 0.95
SIGNIFICANCE = 0.05
MINIMUM_FOR_BCA = 5
"""Fewest values for a BCa interval; below this the jackknife behind its acceleration means nothing."""
MINIMUM_FOR_WILCOXON = math.floor(1 - math.log2(SIGNIFICANCE)) + 1
"""Fewest non-zero differences, 6: the smallest two-sided p of n is 2/2ⁿ (all of one sign), and it must be able to fall
below SIGNIFICANCE. A verdict takes as many clips, too, since frames of one clip are not independent."""
MINIMUM_CLIPS = 3
"""Fewest clips for a bootstrap over clips."""
RESAMPLES_AT_ONCE = 500
"""Resamples held in memory together."""


def format_number(value: float | str) -> str:
    """A cell for reading: four significant digits, a dash for what does not exist."""
    if isinstance(value, str | int):
        return str(value)
    if math.isnan(value):
        return "–"
    return f"{value:.4g}".replace("e-0", "e-").replace("e+0", "e+").replace("-", "−")


class Statistic(NamedTuple):
    """A number or an interval; both not a number where `note` says why it can't be computed."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    note: str = ""

    def __str__(self) -> str:
        """For reading."""
        if math.isnan(self.low):
            return self.note or format_number(self.value)
        return f"[{format_number(self.low)}, {format_number(self.high)}]"


Statistics = dict[str, Statistic]


def _too_small(count: int, needed: int, unit: str) -> str:
    """Why nothing is computed from so few; empty where there are enough."""
    return "" if count >= needed else f"n too small ({unit}: {count}, {needed} needed)"


def _bootstrap(samples: Sequence[np.ndarray], mean: Callable, method: Literal["BCa", "percentile"]) -> Statistic:
    """Interval of a mean over paired resamples."""
    result = stats.bootstrap(
        samples, mean, paired=True, vectorized=True, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method=method,
        batch=RESAMPLES_AT_ONCE, rng=np.random.default_rng(0),
    )  # fmt: skip
    low, high = map(float, result.confidence_interval)
    return Statistic(note="the resamples are degenerate") if math.isnan(low + high) else Statistic(low=low, high=high)


def bca_interval(values: pd.Series) -> Statistic:
    """BCa bootstrap interval of the mean of values [n], taken as independent."""
    note = _too_small(len(values), MINIMUM_FOR_BCA, "values")
    if values.nunique() == 1:
        note = note or "all values are equal"
    return Statistic(note=note) if note else _bootstrap((values.to_numpy(),), np.mean, "BCa")


def clip_interval(values: pd.Series, clips: np.ndarray) -> Statistic:
    """Interval of the mean of values [n] over resamples of whole clips, whose names [n] are `clips`.

    A percentile interval: with a handful of clips BCa's acceleration would itself be noise.
    """
    by_clip = values.groupby(clips)
    note = _too_small(by_clip.ngroups, MINIMUM_CLIPS, "clips")
    if note:
        return Statistic(note=note)

    def mean(totals: np.ndarray, sizes: np.ndarray, axis: int = -1) -> np.ndarray:
        return totals.sum(axis=axis) / sizes.sum(axis=axis)

    return _bootstrap((by_clip.sum().to_numpy(), by_clip.size().to_numpy()), mean, "percentile")


def summarise(values: ArrayLike, clips: ArrayLike) -> Statistics:
    """Mean, SD (n − 1) and both intervals of the finite among the values [n] from the clips [n]."""
    finite = np.isfinite(values)
    kept, names = pd.Series(np.asarray(values, dtype=float)[finite]), np.asarray(clips)[finite]
    return {
        "mean": Statistic(kept.mean(), note=_too_small(len(kept), 1, "values")),
        "sd": Statistic(kept.std(), note=_too_small(len(kept), 2, "values")),
        "interval": bca_interval(kept),
        "clip_interval": clip_interval(kept, names),
        "n": Statistic(len(kept)),
        "clips": Statistic(len(np.unique(names))),
        "left_out": Statistic(int(np.count_nonzero(~finite))),
    }


def compare(regime: ArrayLike, baseline: ArrayLike, clips: ArrayLike) -> Statistics:
    """Paired statistics of two regimes' errors on the same frames; pairs with an error that isn't finite are left out.

    Differences are baseline − regime, so positive means that the regime is better; tests are two-sided; Cohen's d is
    the paired d_z = mean(difference)/SD(difference) = t/√n, the variant behind the paper's 0.390.

    Args:
        regime: errors with the parameters under test, shape [n].
        baseline: errors of the baseline on the same frames, shape [n].
        clips: clip of each frame, shape [n].
    """
    finite = np.isfinite(regime) & np.isfinite(baseline)
    after, before = (pd.Series(np.asarray(errors, dtype=float)[finite]) for errors in (regime, baseline))
    names, difference = np.asarray(clips)[finite], before - after
    empty = _too_small(len(difference), 1, "pairs")
    few = _too_small(int(np.count_nonzero(difference)), MINIMUM_FOR_WILCOXON, "non-zero differences")
    no_spread = _too_small(len(difference), 2, "pairs")
    # Differences that agree to rounding have no spread to test against; t would only measure the rounding.
    if difference.std() <= 1e-12 * difference.abs().max():
        no_spread = "all differences are equal"
    unscaled = empty or ("" if before.mean() > 0 else "the baseline's error is 0")
    w, w_p = (math.nan, math.nan) if few else stats.wilcoxon(difference)
    t, t_p = (math.nan, math.nan) if no_spread else stats.ttest_1samp(difference, 0.0)
    return {
        "mean_difference": Statistic(difference.mean(), note=empty),
        "relative_change_percent": Statistic(100 * (after.mean() / (before.mean() or math.nan) - 1), note=unscaled),
        "difference_interval": bca_interval(difference),
        "difference_clip_interval": clip_interval(difference, names),
        "wilcoxon_w": Statistic(w, note=few),
        "wilcoxon_p": Statistic(w_p, note=few),
        "t": Statistic(t, note=no_spread),
        "t_p": Statistic(t_p, note=no_spread),
        "cohens_d": Statistic(t / np.sqrt(len(difference)), note=no_spread),
        "n": Statistic(len(difference)),
        "clips": Statistic(len(np.unique(names))),
        "left_out": Statistic(int(np.count_nonzero(~finite))),
    }


def judge(comparison: Statistics) -> Literal["better", "worse", "no different", "too few to judge"]:
    """Whether the regime beats the baseline: a lower mean error, and Wilcoxon's p below 0.05.

    "too few to judge" with fewer frames whose errors differ, or fewer clips, than MINIMUM_FOR_WILCOXON.
    """
    p, difference = comparison["wilcoxon_p"].value, comparison["mean_difference"].value
    if math.isnan(p) or comparison["clips"].value < MINIMUM_FOR_WILCOXON:
        return "too few to judge"
    if p >= SIGNIFICANCE or difference == 0:
        return "no different"
    return "better" if difference > 0 else "worse"


def describe(comparison: Statistics, regime: str, baseline: str) -> str:
    """One sentence on a paired comparison, the clip-level interval included."""
    return (
        "{regime} against {baseline}: {verdict}. Change of the mean error [%]: {relative_change_percent}; Wilcoxon p: "
        "{wilcoxon_p}; frames: {n} of clips: {clips}; mean difference over resampled clips: {difference_clip_interval}."
    ).format(regime=regime, baseline=baseline, verdict=judge(comparison), **comparison)
