"""The likelihood of a tracked motion knows the rest position's error and rounding."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, norm

from palpate.estimators.direct import error_model
from palpate.estimators.direct.error_model import REST, STEP, TRACKING, log_likelihoods, rounding_covariance

FRAMES = np.arange(20)
MOTION = 8 * np.exp(-FRAMES / 3.0)
"""A tissue that creeps back to rest [σ]."""


def require_evidence(observed: np.ndarray, simulated: np.ndarray, marginal: Callable[[np.ndarray], float]) -> None:
    """Log likelihoods of motions, but for what is the same of all of them."""
    found, expected = log_likelihoods(observed, simulated)[0][:, 0], np.array([*map(marginal, simulated)])
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-6)


def test_the_rest_positions_error_is_marginalised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of noise, against the integral over it."""
    monkeypatch.setattr(error_model, "SIGMA_FREEDOM", 1e9)  # and σ is known
    observed = MOTION + 0.4 + np.random.default_rng(0).normal(size=20)

    def marginal(motion: np.ndarray) -> float:
        def density(offset: float) -> float:
            squares = np.square(observed - motion - offset).sum() / (1 + TRACKING**2)
            return np.exp(-0.5 * squares - 0.5 * (offset / REST) ** 2)

        return np.log(quad(density, -3, 3, epsabs=0)[0])

    require_evidence(observed, np.stack([MOTION, 1.1 * MOTION, MOTION + 0.5]), marginal)


def test_the_scale_of_the_noise_is_marginalised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the integral over it: 20/scale has a chi-square distribution of 20 degrees of freedom."""
    monkeypatch.setattr(error_model, "SIGMA_FREEDOM", 20.0)
    observed = MOTION + np.random.default_rng(4).normal(0, 3, 20)
    precision = np.linalg.inv((1 + TRACKING**2) * np.eye(20) + REST**2)

    def marginal(motion: np.ndarray) -> float:
        squares = (observed - motion) @ precision @ (observed - motion)

        def density(inverse: float) -> float:
            return chi2.pdf(20 * inverse, 20) * np.exp(-0.5 * squares * inverse) * inverse**10

        return np.log(quad(density, 0, 10, epsabs=0, limit=200)[0])

    require_evidence(observed, np.stack([MOTION, 1.2 * MOTION, np.zeros(20)]), marginal)


def test_the_scale_that_residuals_suggest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_model, "SIGMA_FREEDOM", 20.0)
    assert error_model.variance_scale(30.0, 30) == 1
    assert error_model.variance_scale(3000.0, 30) == pytest.approx(3020 / 50)


def test_rounding_errors_of_near_depths_correlate_as_measured() -> None:
    """Errors of many roundings, each from another place within the step."""
    places = np.random.default_rng(1).uniform(0, STEP, 20_000)[:, None]
    motion = STEP * np.array([0.0, 0.05, 0.1, 0.2])
    errors = np.rint((places + motion) / STEP) * STEP - places - motion
    measured = errors.T @ errors / len(errors)
    assert measured[0, 0] == pytest.approx(1, abs=0.02)
    shrink = 1 - error_model.INDEPENDENT
    found = rounding_covariance(motion[None])[0]
    np.testing.assert_allclose(found, shrink * measured + (1 - shrink) * np.eye(4), atol=0.05)


def test_rounding_covariances_are_positive_definite() -> None:
    motions = np.random.default_rng(2).normal(0, 3, (50, 25))
    assert np.linalg.eigvalsh(rounding_covariance(motions)).min() >= error_model.INDEPENDENT - 1e-9


def test_bounded_errors_are_even_over_a_step_and_refute_what_lies_outside() -> None:
    """Against the integral over the rest position's error."""
    apart = np.array([[0.0, 1.0, -1.0], [0.3, 1.75, 0.2], [0.0, 2.5, 0.0]])

    def marginal(errors: np.ndarray) -> float:
        def density(offset: float) -> float:
            places = errors + offset
            below, above = (norm.cdf((end - places) / error_model.BLUR) for end in (-STEP / 2, STEP / 2))
            astray = error_model.ASTRAY
            every = (1 - astray) * (above - below) / STEP + astray * norm.pdf(places, scale=error_model.WANDER)
            return norm.pdf(offset, scale=REST) * every.prod()

        return np.log(quad(density, -1, 1, epsabs=0, points=(0,))[0])

    found = error_model.bounded_log_density(apart)
    np.testing.assert_allclose(found, [marginal(errors) for errors in apart], atol=0.02)
    assert found[0] == pytest.approx(-3 * np.log(STEP), abs=0.05)
    assert found[2] < found[0] - 4
    assert np.isfinite(error_model.bounded_log_density(np.full((1, 25), 1e3)))  # refuted, but no log of nothing


def test_the_motion_decides_whether_it_was_rounded() -> None:
    """Evidence of rounding is large for most rounded motions and below the noise's for noisy ones."""
    generator = np.random.default_rng(3)
    places = generator.uniform(0, STEP, (200, 1))
    rounded = np.rint((MOTION + places) / STEP) * STEP - places
    noisy = MOTION + generator.normal(size=(200, 20))
    evidences = [[log_likelihoods(observed, MOTION[None])[1][0] for observed in group] for group in (rounded, noisy)]
    gains = np.diff(np.array(evidences), axis=2)[:, :, 0]
    assert np.median(gains[0]) > 2
    assert (gains[1] < 0).mean() > 0.95
