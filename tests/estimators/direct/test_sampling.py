"""Importance sampling gives the mean and covariance of posteriors that are known otherwise."""

import numpy as np
import pytest
from scipy.stats import multivariate_t
from scipy.stats.qmc import Sobol

from palpate.estimators.direct.sampling import ENOUGH, FREEDOM, ROUND, ROUNDS, Draws, Mixture, sample_posterior

BOX = np.array([[-3.0, -2.0, -4.0], [3.0, 2.0, 4.0]])
COVARIANCE = np.array([[0.09, 0.05, 0.0], [0.05, 0.04, 0.01], [0.0, 0.01, 0.16]])


def normal(mean: np.ndarray, covariance: np.ndarray):
    """Log of a normal density without its constant."""
    precision = np.linalg.inv(covariance)

    def log_likelihood(points: np.ndarray) -> np.ndarray:
        return -0.5 * np.einsum("ni,ij,nj->n", points - mean, precision, points - mean)

    return log_likelihood


def sampled(log_likelihood, means: list, scales: list) -> Draws:
    mixture = Mixture(np.full(len(means), 1 / len(means)), np.array(means, float), np.array(scales, float))
    return sample_posterior(log_likelihood, BOX, mixture)


@pytest.mark.parametrize("scale", [0.3, 1.0, 4.0])
def test_a_linear_gaussian_posterior_is_the_closed_form(scale: float) -> None:
    """Whether the first guess of its covariance is right or far off."""
    mean = np.array([0.3, -0.2, 1.0])
    draws = sampled(normal(mean, COVARIANCE), [mean + 0.1], [scale * COVARIANCE])
    assert draws.effective >= ENOUGH
    sd = np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose((draws.mean - mean) / sd, 0, atol=0.1)
    np.testing.assert_allclose(draws.covariance / np.outer(sd, sd), COVARIANCE / np.outer(sd, sd), atol=0.25)


def test_the_box_cuts_the_posterior_off() -> None:
    """A normal distribution about the box's end: mean √(2/π) and variance 1 - 2/π inside, in standard deviations."""
    mean = np.array([3.0, 0.0, 0.0])
    draws = sampled(normal(mean, 0.04 * np.eye(3)), [mean], [0.04 * np.eye(3)])
    assert (draws.points <= BOX[1]).all()
    np.testing.assert_allclose((3 - draws.mean[0]) / 0.2, np.sqrt(2 / np.pi), atol=0.08)
    np.testing.assert_allclose(draws.covariance[0, 0] / 0.04, 1 - 2 / np.pi, atol=0.06)


def test_without_enough_effective_draws_all_rounds_are_made() -> None:
    """A needle that the mixture does not come near."""
    needle = normal(np.array([2.9, 1.9, 3.9]), 1e-8 * np.eye(3))
    draws = sampled(needle, [np.zeros(3)], [1e-4 * np.eye(3)])
    assert draws.effective < 3
    assert len(draws.points) > (ROUNDS[1] - 1) * ROUND * 0.9


def test_it_is_deterministic() -> None:
    first, second = (sampled(normal(np.zeros(3), COVARIANCE), [np.zeros(3)], [COVARIANCE]) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    np.testing.assert_array_equal(first.weights, second.weights)


def test_a_component_is_a_student_distribution() -> None:
    scales = np.stack([COVARIANCE, 2 * COVARIANCE])
    mixture = Mixture(np.array([0.25, 0.75]), np.array([np.ones(3), -np.ones(3)]), scales)
    points = mixture.draw(np.clip(Sobol(5, rng=3).random(4096), 1e-9, 1 - 1e-9))
    parts = zip(mixture.means, mixture.scales, strict=True)
    expected = [multivariate_t.logpdf(points, mean, scale, FREEDOM) for mean, scale in parts]
    np.testing.assert_allclose(mixture.log_densities(points), np.stack(expected, 1) + np.log(mixture.shares), rtol=1e-9)
    first = points[points.sum(axis=1) > 0]
    assert len(first) / len(points) == pytest.approx(0.25, abs=0.01)
    assert (np.abs(first[:, 0] - 1) < 0.3).mean() == pytest.approx(0.63, abs=0.03)  # within one scale of t₅


def test_thinned_draws_are_evenly_spread() -> None:
    points = np.linspace(0, 1, 101)[:, None] * np.array([0.0, 2.0, 0.0])
    draws = Draws(points, np.full(101, 1 / 101))
    np.testing.assert_allclose(np.sort(draws.thinned(4)[:, 1]), [0.25, 0.75, 1.25, 1.75], atol=0.03)
    np.testing.assert_allclose(draws.mean, [0, 1, 0])
    assert draws.effective == pytest.approx(101)
