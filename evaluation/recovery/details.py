"""Everything about a benchmark beyond its table, one quantity a row: `details.csv`.

quantity                      meaning
median_abs_error              of the logarithms
mean_error                    of the logarithms: the bias
error_over_bound_variance     mean square of error / Cramér–Rao bound: 1 is the best an unbiased estimate can do
error_over_sd_variance        mean square of error / the estimate's own standard deviation: 1 is calibrated
gap_closed                    share of the way from the best constant's error (for these clips) to the bound
ratio, coverage90             as in the table, with 95 % intervals from a bootstrap over clips
coverage90_narrow, _wide      coverage90 of the third of the clips with the narrowest, and with the widest, intervals
spread, true_spread           standard deviation of log θ over all estimated clips, estimated and true
collapse                      spread / true_spread: near 0 for an estimator that ignores its input
at_bound                      share of estimated clips where a parameter lies at the end of its range
clips, failed                 number of clips, and of those without an estimate, with the reasons
sigma, sigma_rms              measured tracking noise [scene units] (see `evaluation.recovery.scores.Noise`)
verdict_accuracy              share of clips where the estimated verdict is the true one
verdict_accuracy_clear        the same where no bound lies within a factor 1.5 of the limit
warned                        share of clips whose estimate says that its model doesn't explain the motion, or that the
                              contact is pressed aslant
misfit, seconds               median of the RMS residual along the force over σ, and of the time of an estimate [s]
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np

from evaluation.recovery.scores import PARAMETERS, QUANTITIES, Scores, constant_error, coverage, rms
from physics.identifiability import LIMIT

COLUMNS = ("estimator", "suite", "regime", "parameter", "quantity", "n", "value", "low", "high", "note")
RESAMPLES = 2000
CLEAR = 1.5
"""Verdicts are clear where deciding bounds lie outside the limit times or over this."""
LEAST_CLIPS = 5
"""Fewer clips give no interval."""
Statistic = Callable[[np.ndarray], float | None]


def detail_rows(scores: Scores) -> Iterator[dict[str, object]]:
    """Rows of `details.csv`; cells that don't exist are left out."""
    named = {"estimator": scores.estimator, "suite": scores.suite}
    for column, parameter in enumerate(QUANTITIES):
        for regime, used in scores.groups(column).items():
            clips = np.flatnonzero(used)
            if len(clips):
                for quantity in _errors(scores, column, clips):
                    yield {**named, "regime": regime, "parameter": parameter, "n": len(clips), **quantity}
        for quantity in _collapse(scores, column):
            yield {**named, "regime": "all", "parameter": parameter, "n": len(scores.rows), **quantity}
    for quantity in _whole(scores):
        yield {**named, "regime": "all", "parameter": "all", **quantity}


def _errors(scores: Scores, column: int, clips: np.ndarray) -> Iterator[dict[str, object]]:
    """Quantities of some clips' errors [n]."""
    errors, bounds, sd = (values[clips, column] for values in (scores.errors, scores.bounds, scores.sd))
    worst = constant_error(scores.truth[clips, column])
    gap = worst - rms(bounds)  # ty: ignore[unsupported-operator]  there are some
    yield {"quantity": "median_abs_error", "value": float(np.median(np.abs(errors)))}
    yield {"quantity": "mean_error", "value": float(errors.mean())}
    yield {"quantity": "error_over_bound_variance", "value": float(np.square(errors / bounds).mean())}
    known = np.isfinite(sd)
    if known.any():
        variance = float(np.square(errors[known] / sd[known]).mean())
        yield {"quantity": "error_over_sd_variance", "value": variance}
    if gap > 0:
        yield {"quantity": "gap_closed", "value": (worst - rms(errors)) / gap}  # ty: ignore[unsupported-operator]  there are some
    yield _with_interval("ratio", len(clips), lambda chosen: rms(errors[chosen]) / rms(bounds[chosen]))  # ty: ignore[unsupported-operator]  there are some
    if known.any():
        yield _with_interval("coverage90", len(clips), lambda chosen: coverage(errors[chosen], sd[chosen]))
        yield from _by_width(errors[known], sd[known])


def _by_width(errors: np.ndarray, sd: np.ndarray) -> Iterator[dict[str, object]]:
    """Coverage of the thirds of some clips [n] with the narrowest and with the widest intervals, if they differ."""
    if len(sd) < 3 * LEAST_CLIPS or np.ptp(sd) == 0:
        return
    narrow, _, wide = np.array_split(np.argsort(sd, kind="stable"), 3)
    for quantity, third in (("coverage90_narrow", narrow), ("coverage90_wide", wide)):
        part, width = errors[third], sd[third]
        told = _with_interval(
            quantity, len(third), lambda chosen, part=part, width=width: coverage(part[chosen], width[chosen])
        )
        yield {"n": len(third), **told}


def _with_interval(quantity: str, count: int, statistic: Statistic) -> dict[str, object]:
    """A statistic of clips (indices into them) and its 95 % interval: percentiles over resamples of clips."""
    found: dict[str, object] = {"quantity": quantity, "value": statistic(np.arange(count))}
    if count < LEAST_CLIPS:
        return {**found, "note": f"no interval from fewer than {LEAST_CLIPS} clips"}
    draws = np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
    values = [value for value in map(statistic, draws) if value is not None]
    low, high = np.percentile(values, (2.5, 97.5))
    return {**found, "low": float(low), "high": float(high)}


def _collapse(scores: Scores, column: int) -> Iterator[dict[str, object]]:
    """Spread of one quantity over all estimated clips."""
    if len(scores.rows) < 2:
        return
    spread, true_spread = (float(values[:, column].std(ddof=1)) for values in (scores.estimate, scores.truth))
    yield {"quantity": "spread", "value": spread}
    yield {"quantity": "true_spread", "value": true_spread}
    if true_spread > 0:
        yield {"quantity": "collapse", "value": spread / true_spread}
    if column < len(PARAMETERS):
        ends = [row.at_bound[column] for row in scores.rows if row.at_bound is not None]
        yield {"quantity": "at_bound", "value": float(np.mean(ends)) if ends else None}


def _whole(scores: Scores) -> Iterator[dict[str, object]]:
    """Quantities of the suite and the estimator."""
    reasons = Counter(row.status for row in scores.failed)
    note = "; ".join(f"{status} {count}" for status, count in reasons.most_common())
    total = len(scores.rows) + len(scores.failed)
    yield {"quantity": "clips", "n": total, "value": total}
    yield {"quantity": "failed", "n": total, "value": len(scores.failed), "note": note}
    yield {"quantity": "sigma", "n": total, "value": scores.noise.sigma}
    yield {"quantity": "sigma_rms", "n": total, "value": scores.noise.rms}
    true, clear = true_verdicts(scores.bounds)
    given = np.array([row.verdict for row in scores.rows])
    for name, used in (("verdict_accuracy", given != ""), ("verdict_accuracy_clear", (given != "") & clear)):
        if used.any():
            right = given[used] == true[used]
            yield {
                "quantity": name,
                "n": int(used.sum()),
                "value": float(right.mean()),
                "note": _mistakes(true, given, used),
            }
    told = [row.warned for row in scores.rows if row.warned is not None]
    if told:
        yield {"quantity": "warned", "n": len(told), "value": float(np.mean(told))}
    for name in ("misfit", "seconds"):
        values = np.array([getattr(row, name) for row in scores.rows])
        values = values[np.isfinite(values)]
        if len(values):
            yield {"quantity": name, "n": len(values), "value": float(np.median(values))}


def _mistakes(true: np.ndarray, given: np.ndarray, used: np.ndarray) -> str:
    pairs = Counter((a, b) for a, b in zip(true[used].tolist(), given[used].tolist(), strict=True) if a != b)
    return "; ".join(f"{count} {a} taken for {b}" for (a, b), count in pairs.most_common())


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
