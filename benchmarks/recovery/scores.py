"""Scores of results: errors in logarithms against the Cramér–Rao bound, and `table.csv`.

Errors and bounds are of log θ, so 0.1 means about 10 %. The bound of a clip is that of the sequence of its dent with
the sequence's own noise. `constant_rmse_log` is the error of the best constant for exactly the clips of a row, their
own mean: nothing that ignores its input can do better. A missing value is NaN.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmarks.harness import OK, Row
from benchmarks.recovery.bounds import known
from palpate.data.synthetic.truth import REGIMES
from palpate.estimators.onset import STAMP
from palpate.physics.identifiability import LIMIT, NINETY, RATIOS, covariance
from palpate.physics.mechanics import PARAMETERS

QUANTITIES = (*PARAMETERS, "stiffness/damping", "force/damping")
COLUMNS = (
    "estimator", "suite", "regime", "parameter", "n",
    "rmse_log", "bound_log", "ratio", "constant_rmse_log", "coverage90",
)  # fmt: skip

TO_QUANTITIES = np.vstack((np.eye(3), RATIOS))
"""Matrix from log θ to the logarithms of QUANTITIES, shape [5, 3]."""


@dataclass(frozen=True)
class Scores:
    """Estimated clips of one suite by one estimator, everything in logarithms; n clips, 5 QUANTITIES."""

    estimator: str
    suite: str
    rows: list[Row]
    """Results with an estimate, shape [n]."""
    failed: list[Row]
    """Results without an estimate."""
    regimes: np.ndarray
    """Regimes of damping, shape [n]."""
    truth: np.ndarray
    """True quantities, shape [n, 5]."""
    estimate: np.ndarray
    """Estimated quantities, shape [n, 5]."""
    bounds: np.ndarray
    """Cramér–Rao bounds, shape [n, 5]."""
    sd: np.ndarray
    """Estimated standard deviations, shape [n, 5]; NaN where the estimator gives none."""

    @property
    def errors(self) -> np.ndarray:
        """Estimate minus truth, shape [n, 5]."""
        return self.estimate - self.truth

    @property
    def identifiable(self) -> np.ndarray:
        """Mask of parameters whose bound lies below the limit, shape [n, 3]."""
        return self.bounds[:, :3] < LIMIT

    def groups(self, quantity: int) -> dict[str, np.ndarray]:
        """Masks of clips [n] of a quantity's rows of the table, by the name in the column of regimes.

        Parameters: the clips whose own bound lies below the limit, and every clip, over which intervals are calibrated.
        Ratios: all clips, and the non-identifiable ones, those with a parameter whose bound is not below the limit.
        """
        every = np.ones(len(self.rows), bool)
        if quantity < len(PARAMETERS):
            used, extra, clips = self.identifiable[:, quantity], "every clip", every
        else:
            used, extra, clips = every, "non-identifiable", (~self.identifiable).any(axis=1)
        found: dict[str, np.ndarray] = {regime: used & (self.regimes == regime) for regime in REGIMES}
        return found | {"all": used, extra: np.asarray(clips)}


def score(rows: Sequence[Row], onset: str = STAMP) -> Scores:
    """Scores of one suite and estimator.

    Args:
        rows: their results, one at least.
        onset: instants that the bound knows (`estimators.onset.PressSettings`).
    """
    kept = [row for row in rows if row["status"] == OK]
    truth, estimate = (np.log(np.abs([row[name] for row in kept])).reshape(-1, 3) for name in ("theta", "estimate"))
    information = np.array([row.get("field_information", np.zeros((5, 5))) for row in kept]).reshape(-1, 5, 5)
    unknown = np.full((3, 3), np.nan)
    given = np.array([row.get("covariance", unknown) for row in kept]).reshape(-1, 3, 3)
    return Scores(
        estimator=rows[0]["estimator"],
        suite=rows[0]["suite"],
        rows=kept,
        failed=[row for row in rows if row["status"] != OK],
        regimes=np.array([row["regime"] for row in kept]),
        truth=truth @ TO_QUANTITIES.T,
        estimate=estimate @ TO_QUANTITIES.T,
        bounds=deviations(covariance(known(information, onset))),
        sd=deviations(given),
    )


def deviations(covariances: np.ndarray) -> np.ndarray:
    """Standard deviations of all quantities, shape [..., 5], from covariances of log θ, shape [..., 3, 3]."""
    return np.sqrt(np.einsum("ij,...jk,ik->...i", TO_QUANTITIES, covariances, TO_QUANTITIES))


def score_all(rows: Sequence[Row], onset: str = STAMP) -> list[Scores]:
    """Scores of every estimator and suite, in the order in which they first appear; arguments as in `score`."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["estimator"], row["suite"]), []).append(row)
    return [score(own, onset) for own in groups.values()]


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(values).mean())) if len(values) else math.nan


def coverage(errors: np.ndarray, sd: np.ndarray) -> float:
    """Share of errors [n] within the 90 % intervals of those standard deviations [n] that are given."""
    known = np.isfinite(sd)
    return float((np.abs(errors[known]) <= NINETY * sd[known]).mean()) if known.any() else math.nan


def table(judged: Sequence[Scores]) -> pd.DataFrame:
    """`table.csv`."""
    found = []
    for scores in judged:
        for column, parameter in enumerate(QUANTITIES):
            for regime, used in scores.groups(column).items():
                error, bound = rms(scores.errors[used, column]), rms(scores.bounds[used, column])
                constant = float(np.std(scores.truth[used, column])) if used.any() else math.nan
                held = coverage(scores.errors[used, column], scores.sd[used, column])
                named = scores.estimator, scores.suite, regime, parameter
                found.append((*named, int(used.sum()), error, bound, error / bound, constant, held))
    return pd.DataFrame(found, columns=COLUMNS)
