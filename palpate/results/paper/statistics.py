"""Means, intervals and paired tests of the evaluation's errors (Bini 2026, section 4.1 and table 2).

Frames of one clip are autocorrelated, and the paper's tests take frames as independent. So every mean and every
difference also gets a bootstrap over whole clips. The spread of the estimates shows whether they have collapsed to a
constant. The paper reports k_s = 0.508 ± 0.003 on a range of [0, 1], in whose middle an untrained sigmoid sits. A
number that can't be computed is NaN.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from palpate.physics.mechanics import PARAMETERS, Bounds

Statistics = dict[str, float]
Interval = tuple[float, float]


def _bootstrap(samples: Sequence[np.ndarray], mean: Callable, method: Literal["BCa", "percentile"]) -> Interval:
    """Return the interval of a mean over paired resamples."""
    low, high = stats.bootstrap(
        samples, mean, paired=True, vectorized=True, n_resamples=10_000, confidence_level=0.95, method=method,
        batch=500, rng=np.random.default_rng(0),
    ).confidence_interval  # fmt: skip
    return float(low), float(high)


def bca_interval(values: pd.Series) -> Interval:
    """Return the BCa bootstrap interval of the mean of values [n], taken as independent."""
    if len(values) < 5 or values.nunique() == 1:
        return math.nan, math.nan
    return _bootstrap((values.to_numpy(),), np.mean, "BCa")


def clip_interval(values: pd.Series, clips: np.ndarray) -> Interval:
    """Return the percentile interval of the mean of values [n] over resamples of whole clips, whose names [n] are
    `clips`."""
    by_clip = values.groupby(clips)
    if by_clip.ngroups < 3:
        return math.nan, math.nan

    def mean(totals: np.ndarray, sizes: np.ndarray, axis: int = -1) -> np.ndarray:
        return totals.sum(axis=axis) / sizes.sum(axis=axis)

    return _bootstrap((by_clip.sum().to_numpy(), by_clip.size().to_numpy()), mean, "percentile")


def _intervals(values: pd.Series, clips: np.ndarray) -> Statistics:
    found = {"": bca_interval(values), "clip_": clip_interval(values, clips)}
    return {f"{name}{end}": at for name, ends in found.items() for end, at in zip(("low", "high"), ends, strict=True)}


def summarise(values: ArrayLike, clips: ArrayLike) -> Statistics:
    """Return mean, SD (n − 1) and both intervals of the finite among the values [n] from the clips [n]."""
    finite = np.isfinite(values)
    kept, names = pd.Series(np.asarray(values, dtype=float)[finite]), np.asarray(clips)[finite]
    counts = {"frames": len(kept), "clips": len(np.unique(names)), "left_out": int(np.count_nonzero(~finite))}
    return {"mean": kept.mean(), "sd": kept.std(), **_intervals(kept, names), **counts}


def compare(regime: ArrayLike, baseline: ArrayLike, clips: ArrayLike) -> Statistics:
    """Compare two regimes' errors on the same frames; pairs with an error that isn't finite are left out.

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
    w = w_p = t = t_p = math.nan
    # The smallest two-sided p of n is 2/2ⁿ, and must be able to fall below 0.05.
    if np.count_nonzero(difference) >= 6:
        w, w_p = stats.wilcoxon(difference)
    # Differences that agree to rounding have no spread to test against; t would only measure the rounding.
    if len(difference) > 1 and difference.std() > 1e-12 * difference.abs().max():
        t, t_p = stats.ttest_1samp(difference, 0.0)
    return {
        "mean_difference": difference.mean(),
        "change_percent": 100 * (after.mean() / (before.mean() or math.nan) - 1),
        **_intervals(difference, names),
        "wilcoxon_w": w,
        "wilcoxon_p": w_p,
        "t": t,
        "t_p": t_p,
        "cohens_d": t / np.sqrt(len(difference)) if len(difference) else math.nan,
        "frames": len(difference),
        "clips": len(np.unique(names)),
        "left_out": int(np.count_nonzero(~finite)),
    }


def as_reported(theta: np.ndarray, bounds: Bounds) -> np.ndarray:
    """Return θ [..., 3] with the force as a magnitude, unless its range crosses 0."""
    return np.abs(theta) if bounds.force[1] <= 0 else theta


def spread_of(frames: pd.DataFrame, bounds: Bounds, contacts: int) -> pd.DataFrame:
    """Return the spread of the parameters, as reported, over the test frames in the admissible box.

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
        # Within a hundredth of the range from an end of it.
        at_bound=((values - low < 0.01 * width) | (high - values < 0.01 * width)).mean(),
    )
    # SD over the admissible range, and over the mean where the range is far too wide for the scene.
    constant = (spread["sd_of_range"] < 0.02) & ~(spread["sd_of_mean"] >= 0.2)
    return spread.assign(verdict="n too small" if contacts < 3 else np.where(constant, "constant", "varies"))
