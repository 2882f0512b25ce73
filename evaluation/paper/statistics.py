"""Means, intervals and paired tests of the evaluation's errors (Bini 2026, section 4.1 and table 2).

Frames of one clip are autocorrelated, and the paper's tests take frames as independent, so every mean and every
difference also gets a bootstrap over whole clips.

Then whether the estimates follow the frames, or have collapsed to a constant. The paper reports k_s = 0.508 ± 0.003 on
a range of [0, 1] whose middle is where an untrained sigmoid sits: a spread of 0.3 % of the range. A constant predictor
has a spread of 0 and, if well chosen, a good error too. So that check has two questions: how far the estimates spread,
and whether they explain the observed motion better than constants do.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
import yaml
from numpy.typing import ArrayLike
from scipy import stats

from palpate.physics.mechanics import PARAMETERS, Bounds

SENTENCES: dict[str, str] = yaml.safe_load(Path(__file__).with_name("sentences.yaml").read_text(encoding="utf-8"))
"""What is said of numbers."""
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
MINIMUM_SPREAD = 0.02
"""Below this SD as a fraction of the admissible range a parameter counts as constant, unless SD/|mean| is large."""
MINIMUM_VARIATION = 0.2
"""SD/|mean| from which on a parameter counts as varying even on a range that is far too wide for the scene."""
AT_BOUND = 0.01
"""A value closer than this fraction of the range to an end counts as lying at the bound."""
MINIMUM_CONTACTS = 3
"""Fewest different motions for a verdict: fewer may well have the same θ."""


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
    return SENTENCES["comparison"].format(regime=regime, baseline=baseline, verdict=judge(comparison), **comparison)


def as_reported(theta: np.ndarray, bounds: Bounds) -> np.ndarray:
    """θ [..., 3] with the force as a magnitude, unless its range crosses 0."""
    return np.abs(theta) if bounds.force[1] <= 0 else theta


def spread_of(frames: pd.DataFrame, bounds: Bounds, contacts: int) -> pd.DataFrame:
    """Spread of the parameters, as reported, over the test frames in the admissible box.

    Args:
        frames: one row a test frame with its parameters.
        bounds: the box.
        contacts: number of different observed motions behind the frames.

    Returns:
        One row a parameter. `sd` is the sample SD over all frames, of which a constant predictor has 0; `low` and
        `high` are the admissible range, `sd_of_range` and `sd_of_mean` the SD as a fraction of it and of |mean|,
        `at_bound` the fraction of frames at an end of the range.
    """
    low, high = np.sort(as_reported(np.array([bounds.lower, bounds.upper]), bounds), axis=0)
    values, width = frames[list(PARAMETERS)], high - low
    spread = values.agg(["mean", "std", "min", "max"]).T.set_axis(["mean", "sd", "minimum", "maximum"], axis="columns")
    spread = spread.assign(
        low=low,
        high=high,
        sd_of_range=spread["sd"] / width,
        sd_of_mean=spread["sd"] / spread["mean"].abs(),
        at_bound=((values - low < AT_BOUND * width) | (high - values < AT_BOUND * width)).mean(),
    )
    constant = (spread["sd_of_range"] < MINIMUM_SPREAD) & ~(spread["sd_of_mean"] >= MINIMUM_VARIATION)
    few = contacts < MINIMUM_CONTACTS
    return spread.assign(verdict="n too small" if few else np.where(constant, "constant", "varies"))


def describe_spread(spread: pd.DataFrame) -> str:
    """The verdict on the spread of all three parameters, in one sentence."""
    widths = ", ".join(f"{name} {format_number(100 * share)} %" for name, share in spread["sd_of_range"].items())
    grounds = SENTENCES["grounds"].format(widths=widths)
    if (spread["verdict"] == "n too small").any():
        return SENTENCES["small"].format(grounds=grounds)
    constant = spread.index[spread["verdict"] == "constant"]
    verdict = ("Varies", "Partly collapsed", "Partly collapsed", "Collapsed")[len(constant)]
    return SENTENCES["spread"].format(verdict=verdict, constant=" and ".join(constant) or "none", grounds=grounds)


def conclude(spread: pd.DataFrame, constant: Statistics, reference: Statistics) -> str:
    """The evaluation's conclusion, from the spread and from the comparisons with two baselines.

    Args:
        spread: from `spread_of`.
        constant, reference: comparisons with the constant θ and with the literature constants.
    """
    verdict, clips = judge(constant), int(constant["clips"].value)
    if not clips:
        said = "nothing"
    elif clips < MINIMUM_FOR_WILCOXON:
        said = "few_clips"
    elif verdict == "too few to judge":
        said = "few_frames"
    elif verdict == "better":
        said = "better" if constant["difference_clip_interval"].low > 0 else "unconfirmed"
    else:
        said = "not_success" if judge(reference) == "better" else "not_better"
    words = {"rival": "the constant θ fitted on the training contacts", "why": constant["wilcoxon_w"]}
    words |= {"clips": "One clip" if clips == 1 else f"{clips} clips"}
    lead = SENTENCES[said].format(fewest=MINIMUM_FOR_WILCOXON, significance=SIGNIFICANCE, **words)
    return f"{lead}. {describe_spread(spread)}"
