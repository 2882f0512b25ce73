"""Everything about a benchmark beyond its table, one quantity a row: `details.csv`.

quantity                      meaning
mean_error                    of the logarithms: the bias
error_over_sd_variance        mean square of error / the estimate's own standard deviation: 1 is calibrated
ratio, coverage90             as in the table, with 95 % intervals from a bootstrap over clips
rank_uniformity               p-value of the ranks of the truths in their posteriors being evenly spread (Kolmogorov and
                              Smirnov; simulation-based calibration, Talts 2018): small where posteriors are off
spread, true_spread           standard deviation of log θ over all estimated clips, estimated and true
collapse                      spread / true_spread: near 0 for an estimator that ignores its input
at_bound                      share of estimated clips where a parameter lies at the end of its range
clips, failed                 number of clips, and of those without an estimate, with the reasons
sigma, sigma_rms              measured tracking noise [scene units] (see `evaluation.recovery.scores.measure_noise`)
verdict_accuracy              share of clips where the estimated verdict is the true one
verdict_accuracy_clear        the same where no bound lies within a factor 1.5 of the limit
warned                        share of clips whose estimate says that its model doesn't explain the motion, or that the
                              contact is pressed aslant
onset_off, release_off        frames from the true onset and release to those found, of clips with an estimate: mean
place_off                     how far the contact was found from the true one, mean [grid px]
misfit, seconds               median of the RMS residual along the force over σ, and of the time of an estimate [s]
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd
from scipy.stats import bootstrap, kstest, norm

from palpate.estimators.estimate import NINETY
from palpate.evaluation.harness import Row
from palpate.evaluation.recovery.scores import QUANTITIES, Scores
from palpate.physics.identifiability import LIMIT
from palpate.physics.mechanics import PARAMETERS

COLUMNS = ("estimator", "suite", "regime", "parameter", "quantity", "n", "value", "low", "high", "note")
RESAMPLES = 2000
CLEAR = 1.5
"""Verdicts are clear where deciding bounds lie outside the limit times or over this."""
_AVERAGES = {
    **dict.fromkeys(("onset_off", "release_off", "place_off", "warned"), np.mean),
    **dict.fromkeys(("misfit", "seconds"), np.median),
}
"""Of numbers of results that are given for all clips together."""
LEAST_CLIPS = 5
"""Fewer clips give no interval."""


def detail_table(judged: Sequence[Scores]) -> pd.DataFrame:
    """`details.csv`."""
    return pd.DataFrame([row for scores in judged for row in _rows(scores)], columns=COLUMNS)


def _rows(scores: Scores) -> Iterator[Row]:
    named = {"estimator": scores.estimator, "suite": scores.suite}
    arrays = scores.errors, scores.bounds, scores.sd
    for column, parameter in enumerate(QUANTITIES):
        for regime, used in scores.groups(column).items():
            if used.any():
                for quantity in _errors(*(values[used, column] for values in arrays)):
                    if not math.isnan(quantity["value"]):
                        yield {**named, "regime": regime, "parameter": parameter, "n": int(used.sum()), **quantity}
        for name, value in _collapse(scores, column).items():
            cells = {"parameter": parameter, "n": len(scores.rows), "quantity": name, "value": value}
            yield {**named, "regime": "all", **cells}
    for quantity in _whole(scores):
        yield {**named, "regime": "all", "parameter": "all", **quantity}


def _errors(errors: np.ndarray, bounds: np.ndarray, sd: np.ndarray) -> Iterator[Row]:
    """Quantities of one parameter's errors in some clips, one at least, shape [n] each; not a number where none."""
    yield {"quantity": "mean_error", "value": float(errors.mean())}
    yield {"quantity": "error_over_sd_variance", "value": float(np.square(errors / sd).mean())}
    yield {"quantity": "ratio", **_with_interval(_ratio, errors, bounds)}
    if np.isfinite(sd).all():
        yield {"quantity": "coverage90", **_with_interval(_held, errors, sd)}
        yield {"quantity": "rank_uniformity", "value": float(kstest(ranks(errors, sd), "uniform").pvalue)}


def ranks(errors: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Share of each posterior that lies below its truth, any shape: even from 0 to 1 where the posteriors are right."""
    return norm.cdf(-errors / sd)


def _ratio(errors: np.ndarray, bounds: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.sqrt(np.square(errors).mean(axis)) / np.sqrt(np.square(bounds).mean(axis))


def _held(errors: np.ndarray, sd: np.ndarray, axis: int = -1) -> np.ndarray:
    return (np.abs(errors) <= NINETY * sd).mean(axis)


def _with_interval(statistic: Callable[..., np.ndarray], *values: np.ndarray) -> Row:
    """A statistic of clips' values [n] and its 95 % interval: percentiles over resamples of clips."""
    found: Row = {"value": float(statistic(*values))}
    if len(values[0]) < LEAST_CLIPS:
        return {**found, "note": f"no interval from fewer than {LEAST_CLIPS} clips"}
    resampled = bootstrap(
        values, statistic, n_resamples=RESAMPLES, paired=True, method="percentile", rng=np.random.default_rng(0)
    )
    low, high = resampled.confidence_interval
    return {**found, "low": float(low), "high": float(high)}


def _collapse(scores: Scores, column: int) -> dict[str, float]:
    """Spread of one quantity over all estimated clips; empty for fewer than two."""
    if len(scores.rows) < 2:
        return {}
    spread, true_spread = (float(values[:, column].std(ddof=1)) for values in (scores.estimate, scores.truth))
    found = {"spread": spread, "true_spread": true_spread}
    if true_spread > 0:
        found["collapse"] = spread / true_spread
    if column < len(PARAMETERS):
        found["at_bound"] = float(np.mean([row["at_bound"][column] for row in scores.rows]))
    return found


def _whole(scores: Scores) -> Iterator[Row]:
    """Quantities of the suite and the estimator."""
    total = len(scores.rows) + len(scores.failed)
    reasons = Counter(row["status"] for row in scores.failed)
    note = "; ".join(f"{status} {count}" for status, count in reasons.most_common())
    yield {"quantity": "clips", "n": total, "value": total}
    yield {"quantity": "failed", "n": total, "value": len(scores.failed), "note": note}
    for name, value in zip(("sigma", "sigma_rms"), scores.noise, strict=True):
        yield {"quantity": name, "n": total, "value": value}
    true, clear = true_verdicts(scores.bounds)
    given = np.array([row.get("verdict", "") for row in scores.rows])
    for name, used in (("verdict_accuracy", given != ""), ("verdict_accuracy_clear", (given != "") & clear)):
        if used.any():
            pairs = zip(true[used].tolist(), given[used].tolist(), strict=True)
            mistakes = Counter(f"{a} taken for {b}" for a, b in pairs if a != b)
            note = "; ".join(f"{count} {mistake}" for mistake, count in mistakes.most_common())
            value = float((given[used] == true[used]).mean())
            yield {"quantity": name, "n": int(used.sum()), "value": value, "note": note}
    for name, average in _AVERAGES.items():
        values = np.array([row[name] for row in scores.rows if name in row], float)
        if len(values):
            counts = Counter(values.tolist()) if name in ("onset_off", "release_off") else {}
            note = "; ".join(f"{count} by {off:+g}" for off, count in sorted(counts.items()))
            yield {"quantity": name, "n": len(values), "value": float(average(values)), "note": note}


def true_verdicts(bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Verdicts [n] by bounds [n, 5] as `physics.identifiability.verdict` gives them, and whether each is clear [n].

    Clear: the worst parameter's bound lies outside LIMIT/1.5 to 1.5·LIMIT, and where that is not below the limit, the
    worse ratio's too.
    """
    worst, worst_ratio = bounds[:, :3].max(axis=1, initial=0), bounds[:, 3:].max(axis=1, initial=0)
    determined = worst < LIMIT
    verdicts = np.where(determined, "determined", np.where(worst_ratio < LIMIT, "ratios", "undetermined"))
    outside, ratio_outside = (np.abs(np.log(value / LIMIT)) > np.log(CLEAR) for value in (worst, worst_ratio))
    return verdicts, outside & (determined | ratio_outside)
