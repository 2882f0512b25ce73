"""How the errors of a tracked contact belong together from frame to frame: what a posterior must know besides their σ.

A program removed since (`benchmarks/tracking_errors.py` of commit 00dabdb) measured it on 240 synthetic clips with
known truth (validation split): errors lie along the viewing ray (0.05 σ across it, 0.14 σ where depth was rounded to
8 bits), and

- the rest position is off by 0.04 σ (`clean`, `noisy`) to 0.09 σ (`8bit`), the same in all frames;
- noise is independent otherwise (correlations of 0.02 at most between frames up to four apart);
- rounding errors of `8bit` correlate as their theory says: where the depths of two frames differ by u steps of
  rounding, 1 - 6u(1 - u) is the sawtooth's autocorrelation. In consecutive frames, around u = 0.04, 0.1, 0.22, 0.38,
  0.57 and 0.83, that is 0.79, 0.48, -0.03, -0.43, -0.45 and 0.18; measured: 0.79, 0.50, 0.01, -0.45, -0.47 and 0.19.

Whether depth was rounded isn't said by the contact, so both are held possible. Rounding errors are bounded, which says
more about θ than their covariance does: where a simulated motion's depth lies in another step than the observed one,
it is refuted. But it is by their covariance that they differ from noise.

The numbers behind the constants, and where they come from, are entries of `estimators/model_errors.yaml`.
"""

import math

import numpy as np
from scipy.special import logsumexp, ndtr

from palpate.estimators.model_errors import MODEL_ERRORS

REST, TRACKING = MODEL_ERRORS.contact_rest, MODEL_ERRORS.contact_tracking
"""Standard deviations of the rest position's error, and of the independent error that following the point and taking
off the camera's motion add to the depth's [σ]."""
STEP = math.sqrt(12)
"""Rounding step whose error has a standard deviation of σ [σ]."""
BLUR = MODEL_ERRORS.step_blur
"""Standard deviation of what blurs a step's ends [σ]: following the point, the camera's motion, the mesh."""
ASTRAY, WANDER = MODEL_ERRORS.step_astray, MODEL_ERRORS.step_wander
"""Share of observations that lie outside their step for other reasons, and their standard deviation [σ]."""
REACH, INDEPENDENT = MODEL_ERRORS.step_reach, MODEL_ERRORS.step_independent
"""Depths farther apart than the first are taken to correlate less than the theory says [steps]; the second is the share
of the rounding errors' variance that is taken to be independent."""
SIGMA_FREEDOM = MODEL_ERRORS.noise_freedom
"""Degrees of freedom with which σ is taken to be known. Where a model can't explain a motion, behind drifting fat say,
the residuals then widen the posterior."""
_NODES, _SHARES = np.polynomial.hermite_e.hermegauss(7)
_SHARES = _SHARES / _SHARES.sum()


def log_likelihoods(observed: np.ndarray, simulated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log-likelihoods of an observed motion under simulated ones, if its depth was noisy and if it was rounded.

    Each with a rest position that is unknown by REST.

    Args:
        observed: displacement along the force, shape [M], in units of σ.
        simulated: the same of n simulations, shape [n, M].

    Returns:
        By which simulations are weighed against each other: of noise, whose σ is known with SIGMA_FREEDOM, and of
        bounded errors, shape [n, 2]. By which the two cases are: of noise, and of errors that are correlated as those
        of rounding are, with the odds before, shape [n, 2]. Columns of the first share no constant.
    """
    apart = simulated - observed
    frames = len(observed)
    common = TRACKING**2 * np.eye(frames) + REST**2
    noisy = _log_density(apart, (np.eye(frames) + common)[None])
    rounded = _log_density(apart, rounding_covariance(simulated) + common) + MODEL_ERRORS.step_log_odds
    return np.stack([noisy, bounded_log_density(apart)], axis=1), np.stack([noisy, rounded], axis=1)


def bounded_log_density(apart: np.ndarray) -> np.ndarray:
    """Log-density of rounding errors, shape [n, M] [σ]: even over one step, its ends blurred [σ], shape [n]."""
    sizes = np.abs(apart + REST * _NODES[:, None, None])
    even = (ndtr((STEP / 2 - sizes) / BLUR) - ndtr((-STEP / 2 - sizes) / BLUR)) / STEP
    astray = np.exp(-0.5 * np.square(sizes / WANDER)) / (WANDER * math.sqrt(2 * math.pi))
    frames = np.log((1 - ASTRAY) * even + np.maximum(ASTRAY * astray, np.finfo(float).tiny))
    return logsumexp(frames.sum(axis=2), axis=0, b=_SHARES[:, None])


def sawtooth(steps: np.ndarray) -> np.ndarray:
    """Correlation in theory of the rounding errors of depths that differ by so many steps, any shape."""
    part = np.abs(steps) % 1
    return 1 - 6 * part * (1 - part)


def rounding_covariance(simulated: np.ndarray) -> np.ndarray:
    """Covariance of rounding errors between frames, shape [n, M, M] [σ²].

    Args:
        simulated: displacement along the force, shape [n, M] [σ].
    """
    steps = (simulated[:, :, None] - simulated[:, None]) / STEP
    # A product of positive definite functions of the depths is one too.
    kernel = sawtooth(steps) * np.exp(-0.5 * np.square(steps / REACH))
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
