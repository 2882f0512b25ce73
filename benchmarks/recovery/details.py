"""Everything about a benchmark beyond its table, one quantity a row: `details.csv`.

quantity                      meaning
rank_uniformity               p-value of the ranks of the truths in their posteriors being evenly spread (Kolmogorov and
                              Smirnov; simulation-based calibration, Talts 2018): small where posteriors are off
collapse                      standard deviation of log θ over all estimated clips over the truths': near 0 for an
                              estimator that ignores its input
clips, failed                 number of clips, and of those without an estimate, with the reasons
sigma, sigma_rms              measured tracking noise [scene units] (see `benchmarks.recovery.scores.measure_noise`)
verdict_accuracy_clear        share of clips where the estimated verdict is the true one, of those where no bound lies
                              within a factor 1.5 of the limit
warned                        share of clips whose estimate says that its model doesn't explain the motion, or that the
                              contact is pressed aslant
onset_off, release_off        frames from the true onset and release to those found, of clips with an estimate: mean
place_off                     how far the contact was found from the true one, mean [grid px]
misfit, seconds               median of the RMS residual along the force over σ, and of the time of an estimate [s]
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import kstest, norm

from benchmarks.harness import Row
from benchmarks.recovery.scores import QUANTITIES, Scores
from palpate.physics.identifiability import LIMIT

COLUMNS = ("estimator", "suite", "regime", "parameter", "quantity", "n", "value", "note")
CLEAR = 1.5
"""Verdicts are clear where deciding bounds lie outside the limit times or over this."""
_AVERAGES: dict[str, Any] = dict.fromkeys(("onset_off", "release_off", "place_off", "warned"), np.mean)
_AVERAGES |= dict.fromkeys(("misfit", "seconds"), np.median)
"""Of numbers of results that are given for all clips together."""


def detail_table(judged: Sequence[Scores]) -> pd.DataFrame:
    """`details.csv`."""
    return pd.DataFrame([row for scores in judged for row in _rows(scores)], columns=COLUMNS)


def _rows(scores: Scores) -> Iterator[Row]:
    named = {"estimator": scores.estimator, "suite": scores.suite}
    for column, parameter in enumerate(QUANTITIES):
        for regime, used in scores.groups(column).items():
            errors, sd = scores.errors[used, column], scores.sd[used, column]
            if used.any() and np.isfinite(sd).all():
                value = float(kstest(ranks(errors, sd), "uniform").pvalue)
                cells = {"parameter": parameter, "quantity": "rank_uniformity", "n": len(sd), "value": value}
                yield {**named, "regime": regime, **cells}
        true = float(scores.truth[:, column].std()) if scores.rows else 0.0
        if true > 0:
            value = float(scores.estimate[:, column].std()) / true
            cells = {"quantity": "collapse", "n": len(scores.rows), "value": value}
            yield {**named, "regime": "all", "parameter": parameter, **cells}
    for quantity in _whole(scores):
        yield {**named, "regime": "all", "parameter": "all", **quantity}


def ranks(errors: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Share of each posterior that lies below its truth, any shape: even from 0 to 1 where the posteriors are right."""
    return norm.cdf(-errors / sd)


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
    used = (given != "") & clear
    if used.any():
        value = float((given[used] == true[used]).mean())
        yield {"quantity": "verdict_accuracy_clear", "n": int(used.sum()), "value": value}
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
