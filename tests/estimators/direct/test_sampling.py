"""Importance sampling gives the mean and covariance of posteriors that are known otherwise."""

import numpy as np
import pytest
from scipy.stats import multivariate_t
from scipy.stats.qmc import Sobol

from palpate.estimators.direct.sampling import ENOUGH, FREEDOM, ROUND, ROUNDS, Draws, Mixture, sample_posterior

BOX = np.array([[-3.0, -2.0, -4.0], [3.0, 2.0, 4.0]])
KNOWN = BOX[0] + Sobol(3, rng=0).random(128) * (BOX[1] - BOX[0])
COVARIANCE = np.array([[0.09, 0.05, 0.0], [0.05, 0.04, 0.01], [0.0, 0.01, 0.16]])


def normal(mean: np.ndarray, covariance: np.ndarray):
    """Log of a normal density without its constant."""
    precision = np.linalg.inv(covariance)

    def log_likelihood(points: np.ndarray) -> np.ndarray:
        return -0.5 * np.einsum("ni,ij,nj->n", points - mean, precision, points - mean)

    return log_likelihood


def sampled(log_likelihood, means: list, scales: list) -> Draws:
    mixture = Mixture(np.full(len(means), 1 / len(means)), np.array(means, float), np.array(scales, float))

    def log_likelihoods(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = log_likelihood(points)[:, None]
        return values, values

    return sample_posterior(log_likelihoods, BOX, mixture, (KNOWN, log_likelihoods(KNOWN)))


@pytest.mark.parametrize("scale", [0.3, 1.0, 4.0])
def test_a_linear_gaussian_posterior_is_the_closed_form(scale: float) -> None:
    """Whether the first guess of its covariance is right or far off."""
    mean = np.array([0.3, -0.2, 1.0])
    draws = sampled(normal(mean, COVARIANCE), [mean + 0.1], [scale * COVARIANCE])
    assert draws.effective >= ENOUGH
    sd = np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose((draws.mean - mean) / sd, 0, atol=0.1)
    np.testing.assert_allclose(draws.covariance / np.outer(sd, sd), COVARIANCE / np.outer(sd, sd), atol=0.15)
    assert np.linalg.norm(draws.likeliest - mean) < 0.3


def test_the_box_cuts_the_posterior_off() -> None:
    """A normal distribution about the box's end: mean √(2/π) and variance 1 - 2/π inside, in standard deviations."""
    mean = np.array([3.0, 0.0, 0.0])
    draws = sampled(normal(mean, 0.04 * np.eye(3)), [mean], [0.04 * np.eye(3)])
    assert (draws.points <= BOX[1]).all()
    np.testing.assert_allclose((3 - draws.mean[0]) / 0.2, np.sqrt(2 / np.pi), atol=0.08)
    np.testing.assert_allclose(draws.covariance[0, 0] / 0.04, 1 - 2 / np.pi, atol=0.06)


def test_a_mode_that_nobody_knew_is_found_among_the_known_points() -> None:
    here, there = np.array([-1.5, 0.0, 2.0]), np.array([1.5, 0.5, -2.0])
    first, second = normal(here, 0.04 * np.eye(3)), normal(there, 0.16 * np.eye(3))
    draws = sampled(lambda points: np.logaddexp(first(points), second(points)), [here], [0.04 * np.eye(3)])
    share = draws.weights[draws.points[:, 0] > 0].sum()
    assert share == pytest.approx(8 / 9, abs=0.03)  # twice as wide in three directions
    np.testing.assert_allclose(draws.mean, here / 9 + 8 * there / 9, atol=0.12)


def test_hypotheses_weigh_as_their_evidences_say() -> None:
    """Two about where the mode is: shares 3 to 1 by the evidences, whatever constants the points' likelihoods carry."""
    here, there = np.array([-1.0, 0.0, 1.0]), np.array([1.0, 0.5, -1.0])
    first, second, spread = normal(here, 0.04 * np.eye(3)), normal(there, 0.04 * np.eye(3)), normal(here, np.eye(3))

    def log_likelihoods(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.stack([first(points) + 70, second(points) - 70], axis=1)
        return values, np.stack([spread(points) + np.log(3), spread(points)], axis=1)

    mixture = Mixture(np.array([0.5, 0.5]), np.stack([here, there]), np.stack([0.04 * np.eye(3)] * 2))
    draws = sample_posterior(log_likelihoods, BOX, mixture, (KNOWN, log_likelihoods(KNOWN)))
    np.testing.assert_allclose(draws.mean, 0.75 * here + 0.25 * there, atol=0.03)
    assert np.linalg.norm(draws.likeliest - here) < 0.3


def test_without_enough_effective_draws_all_rounds_are_made() -> None:
    """A needle that neither the mixture nor the known points come near."""
    needle = normal(np.array([2.9, 1.9, 3.9]), 1e-8 * np.eye(3))
    draws = sampled(needle, [np.zeros(3)], [1e-4 * np.eye(3)])
    assert draws.effective < 3
    assert len(draws.points) > len(KNOWN) + (ROUNDS[1] - 1) * ROUND * 0.9


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
    draws = Draws(points, np.full(101, 1 / 101), points[0])
    np.testing.assert_allclose(np.sort(draws.thinned(4)[:, 1]), [0.25, 0.75, 1.25, 1.75], atol=0.03)
    np.testing.assert_allclose(draws.mean, [0, 1, 0])
    assert draws.effective == pytest.approx(101)


@pytest.mark.parametrize("seed", range(4))
def test_pieces_of_a_posterior_are_found_from_one_of_them(seed: int) -> None:
    """Bounded errors leave thin slices of a posterior, in any direction; together they have its mean and covariance."""
    across, sd = np.random.default_rng(seed).normal(size=3), 0.3
    across /= np.linalg.norm(across)
    smooth = normal(np.zeros(3), sd**2 * np.eye(3))

    def sliced(points: np.ndarray) -> np.ndarray:
        return smooth(points) - 30 * (np.abs((points @ across / sd) % 1 - 0.5) > 0.15)

    middle = 0.5 * sd * across
    draws = sampled(sliced, [middle], [(0.1 * sd) ** 2 * np.eye(3)])
    np.testing.assert_allclose(draws.mean / sd, 0, atol=0.3)
    np.testing.assert_allclose(np.sqrt(np.diag(draws.covariance)) / sd, 1, atol=0.3)
