"""Widths that calibrate a posterior's intervals, from its errors on clips whose truth is known.

Errors are taken to have standard deviations scale · sd^power · σ^noise · (k_d/√k_s)^damping, times a factor that is
quadratic in log σ (`models.calibration.Widths`). Here sd and the damping ratio are the network's estimates, and σ is an
input of the network. The coefficients are the likeliest ones for normal errors. The scale is then set
so that 90 % intervals hold 90 % of the truths (conformal prediction, Vovk's quantile, with a normalised score). Both
come from the same results and several suites observe the same clips, so the guarantee is not exact.
"""

import math
from statistics import NormalDist

import numpy as np
from scipy.optimize import minimize

from palpate.models.calibration import LOG_DAMPING, Widths


def fit_widths(estimates: np.ndarray, truths: np.ndarray, deviations: np.ndarray, log_noise: np.ndarray) -> Widths:
    """Factors with which 90 % intervals hold 90 % of the truths, narrow ones as often as wide ones.

    Args:
        estimates, truths: log |θ|, shape [n, 3].
        deviations: the network's standard deviations of them, shape [n, 3].
        log_noise: log σ of the observations, as the network is given it, shape [n].

    Raises:
        ValueError: too few results.
    """
    if len(estimates) < 100:
        raise ValueError(f"{len(estimates)} validation estimates; calibration needs 100 or more.")
    lowest, highest = map(float, np.quantile(log_noise, (0.05, 0.95)))
    distance = np.clip(log_noise, lowest, highest) - (lowest + highest) / 2
    found = []
    for error, deviation in zip((estimates - truths).T, deviations.T, strict=True):
        known = np.stack([np.log(deviation), log_noise, estimates @ LOG_DAMPING, distance**2], axis=1)
        exponents = fit_exponents(error, known)
        found.append((conformal_scale(error, np.exp(known @ exponents)), *exponents))
    columns = (tuple(map(float, values)) for values in zip(*found, strict=True))
    return Widths(*columns, middle_range=(lowest, highest))  # ty: ignore[invalid-argument-type]  three each


def fit_exponents(errors: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Likeliest coefficients b of normal errors with standard deviations exp(a + known·b), shape [D]; a is free.

    Args:
        errors: shape [n].
        known: shape [n, D]; a column without spread gets a coefficient of 0.
    """
    spread = known.std(axis=0)
    used = spread > 0.1  # the noise of one suite has none
    columns = np.column_stack([np.ones(len(errors)), (known[:, used] - known[:, used].mean(axis=0)) / spread[used]])

    def loss(coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        logs = columns @ coefficients
        squares = np.square(errors) * np.exp(-2 * logs)
        return float((logs + squares / 2).mean()), columns.T @ (1 - squares) / len(errors)

    start = np.zeros(columns.shape[1])
    start[0] = np.log(np.sqrt(np.square(errors).mean()))
    found = np.zeros(known.shape[1])
    found[used] = minimize(loss, start, jac=True, method="BFGS").x[1:] / spread[used]
    return found


def conformal_scale(errors: np.ndarray, deviations: np.ndarray) -> float:
    """Factor of standard deviations [n] that makes the 90 % intervals hold 90 % of errors [n]."""
    count = len(errors)
    rank = min(math.ceil((count + 1) * 0.9), count)
    return float(np.sort(np.abs(errors) / deviations)[rank - 1] / NormalDist().inv_cdf(0.95))
