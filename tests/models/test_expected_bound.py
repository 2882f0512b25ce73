"""The expected bound: its loss is least at the medians, and its size is counted up to where verdicts are clear."""

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from palpate.models.evidence import MAX_LOG_DISTANCE, bound_loss
from palpate.models.posterior import ExpectedBound
from palpate.physics.identifiability import LIMIT, bounds, covariance, ratio_bounds


def informations(count: int, seed: int) -> np.ndarray:
    """Random, of bounds on both sides of the limit, shape [count, 3, 3]."""
    generator = np.random.default_rng(seed)
    slopes = generator.normal(size=(count, 5, 3)) * np.exp(generator.uniform(0, 1.5, (count, 1, 1)))
    return np.swapaxes(slopes, 1, 2) @ slopes


def factor_of(information: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.linalg.cholesky(covariance(information)))


@settings(max_examples=30, deadline=None)
@given(factor=st.floats(0.3, 3.0), seed=st.integers(0, 1000))
@example(factor=1.0, seed=0)
def test_a_bound_off_by_a_factor_costs_its_logarithm(factor: float, seed: int) -> None:
    """Whatever the direction: all seven numbers are off by as much."""
    information = informations(20, seed)
    logs = np.log(np.concatenate([bounds(information), ratio_bounds(information)], axis=1) / LIMIT)
    information = information[np.abs(logs).max(axis=1) < MAX_LOG_DISTANCE]
    assume(len(information) > 0)
    found = float(bound_loss(factor * factor_of(information), information))
    assert found == pytest.approx(abs(np.log(factor)), abs=1e-6)


def test_the_median_is_the_best_constant() -> None:
    """Bounds of 0.1, 0.2 and 2 in every quantity: a mean would say that nothing is determined."""
    sizes = np.array([0.1, 0.2, 2.0])
    shared = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.5], [0.0, 0.5, 1.0]])  # ratios have the same variance, 1
    information = np.linalg.inv(shared * sizes[:, None, None] ** 2)
    tried = np.geomspace(0.05, 4, 200)
    root = torch.from_numpy(np.linalg.cholesky(shared))
    costs = [float(bound_loss((size * root).expand(3, 3, 3), information)) for size in tried]
    assert tried[np.argmin(costs)] == pytest.approx(0.2, rel=0.03)


def test_the_worst_parameter_counts_beside_each() -> None:
    """k_s and k_d take turns to be badly known: what decides is the worst, whose median neither of them shows."""
    sizes = np.array([[0.1, 1.0, 0.1], [1.0, 0.1, 0.1], [0.1, 1.0, 0.1], [1.0, 0.1, 0.1]])
    information = np.einsum("bi,ij->bij", sizes**-2, np.eye(3))
    costs = {}
    for message in (0.1, 1.0):
        factor = torch.diag(torch.tensor([message, message, 0.1], dtype=torch.float64)).expand(4, 3, 3)
        costs[message] = float(bound_loss(factor, information))
    # Either is right in half of both parameters; only the larger is right about the worst.
    assert costs[1.0] < costs[0.1] - 0.2


def test_what_is_not_known_at_all_counts_as_far_from_the_limit() -> None:
    """No information is a bound of 30,000; what is said of it need not be as much."""
    far = LIMIT * np.exp(MAX_LOG_DISTANCE)
    shared = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.5], [0.0, 0.5, 1.0]])
    root = torch.from_numpy(far * np.linalg.cholesky(shared))[None]
    assert float(bound_loss(root, np.zeros((1, 3, 3)))) == pytest.approx(0, abs=1e-6)


def test_an_untrained_one_is_near_the_limit() -> None:
    torch.manual_seed(0)
    factor = ExpectedBound(10)(torch.randn(50, 10))
    assert torch.isfinite(factor).all()
    sd = factor.norm(dim=2)
    assert ((sd > LIMIT / 2) & (sd < 2 * LIMIT)).all()
