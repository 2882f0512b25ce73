"""Fisher information and what is read from it, against closed forms, finite differences and repeated fits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.physics import Mechanics
from palpate.physics import identifiability as fisher
from palpate.physics.msd.simulation import simulate, simulate_sensitivities
from tests.physics.sheets import pressed, sheet

MECHANICS = Mechanics(time_step=0.0025, scheme="dkd")
THETA = np.array([0.5, 0.06, -0.1])
MESH = sheet(9, 9)
PRESS = pressed(MESH, 40, 60, 120)

matrices = st.lists(st.floats(-10, 10), min_size=12, max_size=12).map(lambda values: np.reshape(values, (4, 3)))


def with_eigenvalues(values: tuple[float, float, float], vectors: np.ndarray | None = None) -> np.ndarray:
    vectors = np.eye(3) if vectors is None else vectors
    return vectors @ np.diag(values) @ vectors.T


def test_information_of_a_jacobian_by_hand() -> None:
    jacobian = np.array([[[1.0, 0.0, 2.0], [0.0, 3.0, 0.0]], [[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]])
    by_hand = np.array([[2.0, 1.0, 2.0], [1.0, 10.0, 0.0], [2.0, 0.0, 5.0]])
    np.testing.assert_allclose(fisher.fisher_information(jacobian, 1.0), by_hand, rtol=1e-14)
    np.testing.assert_allclose(fisher.fisher_information(jacobian, 0.1), 100 * by_hand, rtol=1e-14)
    np.testing.assert_allclose(fisher.bounds(100 * by_hand), 0.1 * fisher.bounds(by_hand), rtol=1e-12)


@pytest.mark.parametrize("noise", [0.0, -1.0, math.nan])
def test_noise_must_be_positive(noise: float) -> None:
    with pytest.raises(ValueError, match="give a positive standard deviation"):
        fisher.fisher_information(np.ones((1, 3)), noise)


def test_bounds_are_the_spread_of_least_squares() -> None:
    """y = Jφ + noise: the spread of 20,000 fits is I⁻¹, within its own sampling error of 1/√40,000 = 0.5 %."""
    generator = np.random.default_rng(0)
    jacobian, noise = generator.normal(size=(12, 3)), 0.3
    data = noise * generator.normal(size=(12, 20_000))
    fits = np.linalg.lstsq(jacobian, data, rcond=None)[0]
    information = fisher.fisher_information(jacobian, noise)
    np.testing.assert_allclose(fits.std(axis=1), fisher.bounds(information), rtol=0.02)
    np.testing.assert_allclose((fisher.RATIOS @ fits).std(axis=1), fisher.ratio_bounds(information), rtol=0.02)
    np.testing.assert_allclose(
        np.cov(fits), fisher.covariance(information), atol=0.03 * np.abs(fisher.covariance(information)).max()
    )


def test_a_box_counts_as_the_normal_distribution_of_its_variance() -> None:
    """Variance of 200,000 uniform draws, within their sampling error of √(0.8/200,000) = 0.2 %, and width²/12."""
    box = np.array([[-3.0, -5.0, -4.0], [0.0, -0.5, -3.0]])
    spread = np.linalg.inv(fisher.box_information(box))
    np.testing.assert_allclose(spread, np.diag([9.0, 20.25, 1.0]) / 12, rtol=1e-12, atol=1e-15)
    draws = np.random.default_rng(0).uniform(*box, size=(200_000, 3))
    np.testing.assert_allclose(draws.var(axis=0), np.diag(spread), rtol=0.01)
    np.testing.assert_allclose(fisher.bounds(fisher.box_information(box)), (box[1] - box[0]) / math.sqrt(12), rtol=1e-9)


def test_log_jacobian_is_the_derivative_by_the_logarithms() -> None:
    """Central differences of float64 rollouts; their error is (1e-4)²/6 times the third derivative."""
    path, slopes = simulate_sensitivities(THETA, MESH, PRESS, MECHANICS, dtype=np.float64)
    exact = fisher.log_jacobian(slopes, THETA)

    def at(logs: np.ndarray) -> np.ndarray:
        theta = np.sign(THETA) * np.exp(logs)
        return simulate(theta, MESH, PRESS, MECHANICS, dtype=np.float64)

    start = np.log(np.abs(THETA))
    differences = [(at(start + step) - at(start - step)) / 2e-4 for step in 1e-4 * np.eye(3)]
    np.testing.assert_allclose(exact, np.stack(differences, -1), atol=1e-7 * np.abs(path).max() * 10)
    # The force scales a nearly linear response: its column is the displacement itself.
    assert np.abs(exact[..., 2] - path).max() < 0.5 * np.abs(path).max()


def test_what_is_unknown_has_no_finite_bound() -> None:
    """Only k_s/k_d and F/k_d seen: the common scale has no bound, the two ratios have theirs."""
    information = fisher.RATIOS.T @ np.diag([100.0, 400.0]) @ fisher.RATIOS
    assert (fisher.bounds(information) > 1e4).all()
    np.testing.assert_allclose(fisher.ratio_bounds(information), [0.1, 0.05], rtol=1e-9)
    np.testing.assert_allclose(fisher.ratio_bounds(1e8 * information), [1e-5, 5e-6], rtol=1e-3)
    assert fisher.verdict(information) == "ratios"


def test_verdicts_change_at_the_limit() -> None:
    below, above = 1 / (0.99 * fisher.LIMIT) ** 2, 1 / (1.01 * fisher.LIMIT) ** 2
    assert fisher.verdict(below * np.eye(3)) == "determined"
    assert fisher.verdict(with_eigenvalues((below, below, above))) == "undetermined"  # F/k_d is no better known than F
    assert fisher.verdict(above * np.eye(3)) == "undetermined"
    assert fisher.verdict(np.zeros((3, 3))) == "undetermined"
    assert fisher.verdict(1.02**2 * above * np.eye(3)) == "determined"
    # Of two independent parameters the ratio is √2 times as uncertain, so this limit keeps both ratios out.
    assert fisher.verdict(0.98**2 * with_eigenvalues((2.1 * below, 2.1 * below, below))) == "undetermined"


@given(matrices)
def test_covariance_is_symmetric_and_not_below_the_diagonal(rows: np.ndarray) -> None:
    information = fisher.fisher_information(rows, 1.0)
    found = fisher.covariance(information)
    np.testing.assert_allclose(found, found.T, rtol=1e-9, atol=1e-12 * np.abs(found).max())
    assert np.linalg.eigvalsh(found).min() > 0 or np.linalg.cond(information) > 1e12
    known = np.diag(information) > 1e-6
    # A parameter is known best where the others are given: sd² ≥ 1/I_ii.
    assert (fisher.bounds(information)[known] >= (1 - 1e-6) / np.sqrt(np.diag(information)[known])).all()


@given(matrices, matrices)
def test_more_data_never_loosen_a_bound(first: np.ndarray, second: np.ndarray) -> None:
    alone, both = fisher.fisher_information(first, 1.0), fisher.fisher_information(np.concatenate([first, second]), 1.0)
    assert (fisher.bounds(both) <= fisher.bounds(alone) * (1 + 1e-6) + 1e-9).all() or np.linalg.cond(alone) > 1e10
