"""Identifiability of stiffness, damping and force from a contact's motion: Fisher information, bound, verdict.

Bini 2026 leaves the question open (section 5). For an observation d = Φ(θ) + noise of standard deviation σ in every
coordinate the Fisher information of φ = (log k_s, log k_d, log |F|) is I = Σ (∂Φ/∂φ)ᵀ(∂Φ/∂φ)/σ², and no unbiased
estimate of φ has a covariance below I⁻¹ (Cramér–Rao bound). A bound of 0.1 is a relative error of about 10 %.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

NINETY = 1.6448536269514722
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""
LIMIT = 0.5
"""Largest bound of an identifiable parameter: its one-sigma interval then spans less than a factor e."""
RATIOS = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])
"""Exponents of k_s/k_d and F/k_d, the ratios that an over-damped response still determines."""

Verdict = Literal["determined", "ratios", "undetermined"]


def log_jacobian(jacobian: np.ndarray, theta: ArrayLike) -> np.ndarray:
    """∂Φ/∂φ from ∂Φ/∂θ: φ = (log k_s, log k_d, log |F|) makes every column θ times as large, F's with its sign.

    Args:
        jacobian: shape [..., 3], the last axis θ's.
        theta: [k_s, k_d, F], shape [3].
    """
    return jacobian * np.asarray(theta, jacobian.dtype)


def fisher_information(jacobian: np.ndarray, noise: float) -> np.ndarray:
    """I = Σ (∂Φ/∂φ)ᵀ(∂Φ/∂φ)/σ², shape [3, 3], or [D, D] of any other parameters φ.

    Args:
        jacobian: ∂Φ/∂φ of everything that is observed, shape [..., D].
        noise: σ of every observed coordinate [scene units].

    Raises:
        ValueError: the noise is not positive.
    """
    if not noise > 0:
        raise ValueError(f"noise is {noise}; give a positive standard deviation.")
    rows = np.asarray(jacobian, np.float64).reshape(-1, jacobian.shape[-1])
    return rows.T @ rows / noise**2


def covariance(information: np.ndarray) -> np.ndarray:
    """I⁻¹, shape [..., 3, 3]; along directions without information the variance is 1e9, not infinite."""
    variances, vectors = _variances(information)
    return (vectors * variances[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def box_information(box: np.ndarray) -> np.ndarray:
    """Information of the uniform prior on a box of φ, as that of the normal distribution with its variance, [3, 3].

    Args:
        box: lower and upper φ, shape [2, 3].
    """
    return np.diag(12 / (box[1] - box[0]) ** 2)


def _variances(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variance along each principal direction [..., 3], and the directions as columns [..., 3, 3]."""
    values, vectors = np.linalg.eigh(information)
    return 1 / np.maximum(values, 1e-9), vectors  # information below is rounding: a bound of 30,000


def bounds(information: np.ndarray) -> np.ndarray:
    """Cramér–Rao bounds on the standard deviations of (log k_s, log k_d, log |F|), shape [..., 3]."""
    return np.sqrt(np.diagonal(covariance(information), axis1=-2, axis2=-1))


def combination_bounds(information: np.ndarray, powers: ArrayLike) -> np.ndarray:
    """Cramér–Rao bounds on the logarithms of products of powers of k_s, k_d and |F|, shape [..., C].

    Args:
        information: shape [..., 3, 3].
        powers: exponents of each product, shape [C, 3].
    """
    # By directions, not by differences of large covariances: the common scale's may be a billion times the ratios'.
    variances, vectors = _variances(information)
    return np.sqrt(((np.asarray(powers) @ vectors) ** 2 @ variances[..., None])[..., 0])


def ratio_bounds(information: np.ndarray) -> np.ndarray:
    """Cramér–Rao bounds on log(k_s/k_d) and log(F/k_d), shape [..., 2]."""
    return combination_bounds(information, RATIOS)


def verdict(information: np.ndarray) -> Verdict:
    """Verdict by the bounds: `determined` if every parameter's lies below LIMIT.

    Otherwise `ratios` if those of k_d/k_s, and of F/k_d or F/k_s, do.
    """
    if (bounds(information) < LIMIT).all():
        return "determined"
    by_stiffness = combination_bounds(information, [[-1, 1, 0], [-1, 0, 1]])
    known = (ratio_bounds(information) < LIMIT).all() or (by_stiffness < LIMIT).all()
    return "ratios" if known else "undetermined"
