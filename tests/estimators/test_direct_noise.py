"""The likelihood of a tracked motion knows the rest position's error and rounding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2

from estimators import tracking_noise
from estimators.tracking_noise import REST, STEP, TRACKING, log_likelihood, rounding_covariance

FRAMES = np.arange(20)
MOTION = 8 * np.exp(-FRAMES / 3.0)
"""A tissue that creeps back to rest [σ]."""


def independent_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make both kinds of noise the independent one."""
    monkeypatch.setattr(tracking_noise, "INDEPENDENT", 1.0)
    monkeypatch.setattr(tracking_noise, "WIDENED", 1.0)


def test_the_rest_positions_error_is_marginalised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the integral over it, with independent noise alone."""
    independent_alone(monkeypatch)
    monkeypatch.setattr(tracking_noise, "SIGMA_FREEDOM", 1e9)  # and σ is known
    generator = np.random.default_rng(0)
    observed = MOTION + 0.4 + generator.normal(size=20)
    simulated = np.stack([MOTION, 1.1 * MOTION, MOTION + 0.5])

    def marginal(motion: np.ndarray) -> float:
        def density(offset: float) -> float:
            return np.exp(
                -0.5 * np.square(observed - motion - offset).sum() / (1 + TRACKING**2) - 0.5 * (offset / REST) ** 2
            )

        return np.log(quad(density, -3, 3, epsabs=0)[0])

    expected = np.array([marginal(motion) for motion in simulated])
    found = log_likelihood(observed, simulated)
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-6)


def test_the_scale_of_the_noise_is_marginalised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the integral over it: 20/scale has a chi-square distribution of 20 degrees of freedom."""
    independent_alone(monkeypatch)
    monkeypatch.setattr(tracking_noise, "SIGMA_FREEDOM", 20.0)
    observed = MOTION + np.random.default_rng(4).normal(0, 3, 20)
    simulated = np.stack([MOTION, 1.2 * MOTION, np.zeros(20)])
    precision = np.linalg.inv((1 + TRACKING**2) * np.eye(20) + REST**2)

    def marginal(motion: np.ndarray) -> float:
        squares = (observed - motion) @ precision @ (observed - motion)

        def density(inverse: float) -> float:
            return chi2.pdf(20 * inverse, 20) * np.exp(-0.5 * squares * inverse) * inverse**10

        return np.log(quad(density, 0, 10, epsabs=0, limit=200)[0])

    expected = np.array([marginal(motion) for motion in simulated])
    found = log_likelihood(observed, simulated)
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-6)


def test_the_scale_that_residuals_suggest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking_noise, "SIGMA_FREEDOM", 20.0)
    assert tracking_noise.variance_scale(30.0, 30) == 1
    assert tracking_noise.variance_scale(3000.0, 30) == pytest.approx(3020 / 50)


def test_rounding_errors_of_near_depths_correlate_as_measured() -> None:
    """Errors of many roundings, each from another place within the step."""
    places = np.random.default_rng(1).uniform(0, STEP, 20_000)[:, None]
    motion = STEP * np.array([0.0, 0.05, 0.1, 0.2])
    errors = np.rint((places + motion) / STEP) * STEP - places - motion
    measured = errors.T @ errors / len(errors)
    assert measured[0, 0] == pytest.approx(1, abs=0.02)
    shrink = 1 - tracking_noise.INDEPENDENT
    found = rounding_covariance(motion[None])[0]
    np.testing.assert_allclose(found, shrink * measured + (1 - shrink) * np.eye(4), atol=0.05)


def test_rounding_covariances_are_positive_definite() -> None:
    motions = np.random.default_rng(2).normal(0, 3, (50, 25))
    assert np.linalg.eigvalsh(rounding_covariance(motions)).min() >= tracking_noise.INDEPENDENT - 1e-9


def test_the_motion_decides_whether_it_was_rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounded motions are likelier than with independent errors alone, others at most half as likely."""
    generator = np.random.default_rng(3)
    places = generator.uniform(0, STEP, (200, 1))
    rounded = np.rint((MOTION + places) / STEP) * STEP - places
    noisy = MOTION + generator.normal(size=(200, 20))
    both = [[log_likelihood(observed, MOTION[None])[0] for observed in group] for group in (rounded, noisy)]
    independent_alone(monkeypatch)
    white = [[log_likelihood(observed, MOTION[None])[0] for observed in group] for group in (rounded, noisy)]
    gains = np.array(both) - np.array(white)
    assert np.median(gains[0]) > 2
    assert gains[1].min() >= -np.log(2) - 1e-9
    assert np.median(gains[1]) < 0
