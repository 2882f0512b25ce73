"""From results to numbers: errors in logarithms against the Cramér–Rao bound, and `table.csv`.

Errors and bounds are of log θ, so 0.1 means about 10 %. The bound of a clip is that of its contact's true trajectory
under the suite's measured tracking noise, which is pooled over all its clips. `constant_rmse_log` is the error of the
best constant for exactly the clips of a row, their own mean: nothing that ignores its input can do better. The
estimator `constant` is fitted on another split and does worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.estimate import NINETY
from evaluation.recovery.evaluate import OK, Recovery
from evaluation.recovery.suites import REGIMES
from physics.identifiability import LIMIT, RATIOS, covariance

PARAMETERS = ("stiffness", "damping", "force")
QUANTITIES = (*PARAMETERS, "stiffness/damping", "force/damping")
COLUMNS = (
    "estimator", "suite", "regime", "parameter", "n",
    "rmse_log", "bound_log", "ratio", "constant_rmse_log", "coverage90",
)  # fmt: skip
NON_IDENTIFIABLE = "non-identifiable"
"""In the column of regimes: clips of any regime with a parameter whose bound is not below the limit."""
EVERY = "every clip"
"""In the column of regimes, of a parameter: identifiable or not. Intervals are calibrated to hold over these."""
CENTRAL = 0.6826894921370859
"""Probability within one standard deviation."""
ASTRAY = 4.0
"""Tracking errors of more than this many standard deviations count as lost tracks, not as noise."""
TO_QUANTITIES = np.vstack((np.eye(3), RATIOS))
"""From log θ to the logarithms of QUANTITIES, shape [5, 3]."""


@dataclass(frozen=True)
class Noise:
    """Measured error of the tracked contact displacement of a suite [scene units]."""

    sigma: float
    """Root mean square without the errors beyond ASTRAY times the width that holds the central 68 %: tracks that went
    astray would raise the bound and so excuse the estimators."""
    rms: float
    """Root mean square of all."""


@dataclass(frozen=True)
class Scores:
    """Estimated clips of one suite by one estimator, everything in logarithms; n clips, 5 QUANTITIES."""

    estimator: str
    suite: str
    rows: tuple[Recovery, ...]
    """Results with an estimate, shape [n]."""
    failed: tuple[Recovery, ...]
    """Results without one."""
    noise: Noise
    regimes: np.ndarray
    """Shape [n]."""
    truth: np.ndarray
    """Shape [n, 5]."""
    estimate: np.ndarray
    """Shape [n, 5]."""
    bounds: np.ndarray
    """Cramér–Rao bounds, shape [n, 5]."""
    sd: np.ndarray
    """Estimated standard deviations, shape [n, 5]; not a number where the estimator gives none."""

    @property
    def errors(self) -> np.ndarray:
        """Estimate minus truth, shape [n, 5]."""
        return self.estimate - self.truth

    @property
    def identifiable(self) -> np.ndarray:
        """Whether each parameter's bound lies below the limit, shape [n, 3]."""
        return self.bounds[:, :3] < LIMIT

    def groups(self, quantity: int) -> dict[str, np.ndarray]:
        """Clips [n] bool that a quantity's rows of the table are about, by the name in the column of regimes.

        Parameters: the clips whose own bound lies below the limit, and every clip. Ratios: all clips, and the
        non-identifiable ones.
        """
        used = self.identifiable[:, quantity] if quantity < 3 else np.ones(len(self.rows), bool)
        found: dict[str, np.ndarray] = {regime: used & (self.regimes == regime) for regime in REGIMES}
        found["all"] = used
        if quantity >= 3:
            found[NON_IDENTIFIABLE] = ~self.identifiable.all(axis=1)  # ty: ignore[invalid-assignment]  one a clip
        else:
            found[EVERY] = np.ones(len(self.rows), bool)
        return found


def measure_noise(rows: Sequence[Recovery]) -> Noise:
    """Tracking noise of a suite's results, every clip once; not a number without any."""
    tracks = {row.index: row.tracking for row in rows if row.tracking is not None}
    if not tracks:
        return Noise(math.nan, math.nan)
    sizes = np.abs(np.concatenate(list(tracks.values())))
    kept = sizes[sizes <= ASTRAY * np.quantile(sizes, CENTRAL)]
    return Noise(rms(kept), rms(sizes))  # ty: ignore[invalid-argument-type]  there are some


def score(rows: Sequence[Recovery], noise: Noise) -> Scores:
    """Scores of one suite and estimator.

    Args:
        rows: its results, one at least.
        noise: of the suite.
    """
    kept = tuple(sorted((row for row in rows if row.status == OK), key=lambda row: row.index))
    truth, estimate = (
        np.log(np.abs([getattr(row, name) for row in kept])).reshape(-1, 3) for name in ("theta", "estimate")
    )
    limits = [deviations(covariance(row.information / noise.sigma**2)) for row in kept]  # ty: ignore[unsupported-operator]  every OK row has one
    sds = [np.full(5, np.nan) if row.covariance is None else deviations(row.covariance) for row in kept]
    return Scores(
        estimator=rows[0].estimator,
        suite=rows[0].suite,
        rows=kept,
        failed=tuple(row for row in rows if row.status != OK),
        noise=noise,
        regimes=np.array([row.regime for row in kept]),
        truth=truth @ TO_QUANTITIES.T,
        estimate=estimate @ TO_QUANTITIES.T,
        bounds=np.array(limits).reshape(-1, 5),
        sd=np.array(sds).reshape(-1, 5),
    )


def deviations(covariances: np.ndarray) -> np.ndarray:
    """Standard deviations of all quantities, shape [..., 5], from covariances of log θ, shape [..., 3, 3]."""
    return np.sqrt(np.einsum("ij,...jk,ik->...i", TO_QUANTITIES, covariances, TO_QUANTITIES))


def score_all(rows: Sequence[Recovery]) -> list[Scores]:
    """Scores of every estimator and suite, in the order in which they first appear."""
    noises = {suite: measure_noise([row for row in rows if row.suite == suite]) for suite in {r.suite for r in rows}}
    groups: dict[tuple[str, str], list[Recovery]] = {}
    for row in rows:
        groups.setdefault((row.estimator, row.suite), []).append(row)
    return [score(group, noises[suite]) for (_, suite), group in groups.items()]


def rms(values: np.ndarray) -> float | None:
    """Root mean square; None of nothing."""
    return float(np.sqrt(np.square(values).mean())) if len(values) else None


def constant_error(truth: np.ndarray) -> float | None:
    """Error of the best constant for true values [n]: the root mean square about their own mean; None of nothing."""
    return float(np.std(truth)) if len(truth) else None


def coverage(errors: np.ndarray, sd: np.ndarray, width: float = NINETY) -> float | None:
    """Share of errors [n] within `width` standard deviations [n]; None where no deviations are given."""
    known = np.isfinite(sd)
    return float((np.abs(errors[known]) <= width * sd[known]).mean()) if known.any() else None


def table_rows(scores: Scores) -> list[dict[str, object]]:
    """Rows of `table.csv`; a cell that doesn't exist is None."""
    found = []
    for column, parameter in enumerate(QUANTITIES):
        for regime, used in scores.groups(column).items():
            error, bound = rms(scores.errors[used, column]), rms(scores.bounds[used, column])
            found.append(
                {
                    "estimator": scores.estimator,
                    "suite": scores.suite,
                    "regime": regime,
                    "parameter": parameter,
                    "n": int(used.sum()),
                    "rmse_log": error,
                    "bound_log": bound,
                    "ratio": None if error is None else error / bound,  # ty: ignore[unsupported-operator]  of the same clips
                    "constant_rmse_log": constant_error(scores.truth[used, column]),
                    "coverage90": coverage(scores.errors[used, column], scores.sd[used, column]),
                }
            )
    return found
