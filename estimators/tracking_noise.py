"""How the errors of a tracked contact belong together from frame to frame: what a posterior must know beside their σ.

Measured on 114 synthetic clips with known truth (validation split, seed 311, suites `clean` and `8bit`): errors lie
along the viewing ray (0.06 σ across it), and

- the rest position is off by 0.03 σ (`clean`, `noisy`) to 0.09 σ (`8bit`), in all frames alike (18 other clips);
- noise of `clean` is independent otherwise (correlations within 0.1 at any lag);
- rounding errors of `8bit` correlate as their theory says, whatever the time between: where the depths of two frames
  differ by u steps of rounding, 1 - 6u(1 - u) is the sawtooth's autocorrelation. Around u = 0.03, 0.1, 0.23, 0.4, 0.6
  and 0.85 that is 0.85, 0.46, -0.05, -0.44, -0.44 and 0.23; measured between consecutive frames: 0.82, 0.58, -0.01,
  -0.38, -0.48 and 0.23.

Whether depth was rounded isn't said by the contact, so both are held possible and the motion decides.
"""

from __future__ import annotations

import math

import numpy as np

REST = 0.1
"""Standard deviation of the rest position's error [σ]."""
TRACKING = 0.27
"""Standard deviation of the independent error that following the point and taking off the camera's motion add to the
depth's [σ]: within a clip errors of `clean` spread by 1.037 σ."""
STEP = math.sqrt(12)
"""Rounding step whose error has a standard deviation of σ [σ]."""
REACH = 0.7
"""Depths farther apart than this are taken to correlate less than the theory says: a simulated motion is not exact
enough to count several steps [steps]."""
INDEPENDENT = 0.35
"""Share of the variance that is independent nevertheless: sub-pixel tracking and the camera's drift."""
WIDENED = 1.25
"""Factor of the rounding errors' variance: they are not normal, and a normal likelihood reads more from their phase
than they tell. Without it the mean square of error over standard deviation was 1.28 on 208 validation clips of `8bit`.
"""
SIGMA_FREEDOM = 100.0
"""Degrees of freedom with which σ is known, to 7 %: it comes from the first frame in contact. Where a model can't
explain a motion, behind drifting fat say, the residuals then widen the posterior. With 20, chance narrows it.
"""


def log_likelihood(observed: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Log-likelihood of an observed motion under simulated ones, shape [n], up to a constant that they share.

    The average of the likelihoods of independent noise and of rounding, each with a rest position that is unknown by
    REST and a σ that is known with SIGMA_FREEDOM.

    Args:
        observed: displacement along the force, shape [M], in units of σ.
        simulated: the same of n simulations, shape [n, M].
    """
    apart = simulated - observed
    frames = len(observed)
    common = TRACKING**2 * np.eye(frames) + REST**2
    white = _log_density(apart, (np.eye(frames) + common)[None])
    return np.logaddexp(white, _log_density(apart, WIDENED * rounding_covariance(simulated) + common)) - math.log(2)


def rounding_covariance(simulated: np.ndarray) -> np.ndarray:
    """Covariance of rounding errors between frames, shape [n, M, M] [σ²].

    Args:
        simulated: displacement along the force, shape [n, M] [σ].
    """
    steps = (simulated[:, :, None] - simulated[:, None]) / STEP
    part = np.abs(steps) % 1
    # A product of positive definite functions of the depths is one too.
    kernel = (1 - 6 * part * (1 - part)) * np.exp(-0.5 * np.square(steps / REACH))
    return (1 - INDEPENDENT) * kernel + INDEPENDENT * np.eye(simulated.shape[1])


def _log_density(apart: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Log-density without its constant of vectors [n, M] that are normal with covariances [n or 1, M, M] times a scale.

    The scale's inverse has a gamma distribution of mean 1, so the density is Student's.
    """
    factors = np.linalg.cholesky(covariances)
    squares = np.square(np.linalg.solve(factors, apart[:, :, None])[:, :, 0]).sum(axis=1)
    volumes = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
    return -(SIGMA_FREEDOM + apart.shape[1]) / 2 * np.log1p(squares / SIGMA_FREEDOM) - volumes


def variance_scale(squares: float, frames: int) -> float:
    """Factor of σ² that residuals with a sum of squares (in σ²) over a number of frames suggest: 1 for good ones."""
    return (SIGMA_FREEDOM + squares) / (SIGMA_FREEDOM + frames)
