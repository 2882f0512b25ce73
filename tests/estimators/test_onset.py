"""What not knowing when a press began adds to an estimate, against the least-squares fits that it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.onset import onset_covariance, onset_error, velocities


def test_covariance_is_that_of_fits_to_motions_that_began_otherwise() -> None:
    """Delays evenly spread over ±T, a linear model, and a fit with a prior about the true parameters."""
    generator = np.random.default_rng(0)
    jacobian, velocity = generator.normal(size=(40, 3)), generator.normal(size=40)
    prior, interval = np.diag([1.0, 20.0, 5.0]), 0.04
    delays = interval * np.linspace(-1, 1, 20001)
    errors = np.linalg.solve(jacobian.T @ jacobian + prior, np.outer(jacobian.T @ velocity, delays))
    np.testing.assert_allclose(
        onset_covariance(jacobian, velocity, prior, interval), errors @ errors.T / len(delays), rtol=1e-3
    )


def test_velocity_of_a_known_motion() -> None:
    """d = (t², -3t, 0): second-order differences are exact, also at the first step, before which it rests."""
    time_step, times = 0.01, 0.01 * np.arange(1, 101)
    path = np.stack([times**2, -3 * times, 0 * times], axis=1)
    steps = np.array([0, 10, 98])
    expected = np.stack([2 * times, np.full(100, -3.0), 0 * times], axis=1)[steps]
    np.testing.assert_allclose(velocities(path, steps, time_step), expected, atol=1e-12)


def test_a_frame_is_what_is_not_known() -> None:
    assert onset_error("between", 25.0) == pytest.approx(0.04)
    assert onset_error("stamp", 25.0) == 0.0
