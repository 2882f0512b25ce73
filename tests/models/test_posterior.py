"""The contact posterior: its box, its covariance and its loss."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.models.posterior import ContactPosterior, evidence_loss

BOX = torch.tensor([[-3.0, -5.0, -4.0], [0.0, -0.7, -1.2]])


@settings(max_examples=30, deadline=None)
@given(scale=st.floats(0.1, 1e4), seed=st.integers(0, 1000))
def test_mean_in_the_box_and_covariance_positive(scale: float, seed: int) -> None:
    torch.manual_seed(seed)
    network = ContactPosterior(10, BOX, width=16, blocks=2)
    mean, factor = network(scale * torch.randn(8, 10))
    assert ((mean >= BOX[0]) & (mean <= BOX[1])).all()
    assert (torch.linalg.eigvalsh((factor @ factor.transpose(1, 2)).double()) > 0).all()


def test_inputs_are_standardised_by_their_spread_or_the_least_one() -> None:
    network = ContactPosterior(3, BOX, width=16, blocks=1)
    features = torch.tensor([[1.0, 5.0, 0.0], [3.0, 5.0, 0.2], [5.0, 5.0, 0.4]])  # of spread 2, 0 and 0.2
    network.standardise(features)
    torch.testing.assert_close(network.centre, torch.tensor([3.0, 5.0, 0.2]))
    torch.testing.assert_close(network.scale, torch.tensor([2.0, 0.01, 0.2]))
    network.standardise(features, least=0.3)
    torch.testing.assert_close(network.centre, torch.tensor([3.0, 5.0, 0.2]))
    torch.testing.assert_close(network.scale, torch.tensor([2.0, 0.3, 0.3]))
    # From an input on; those before it keep theirs.
    network.standardise(2 * features, first=1)
    torch.testing.assert_close(network.centre, torch.tensor([3.0, 10.0, 0.4]))
    torch.testing.assert_close(network.scale, torch.tensor([2.0, 0.01, 0.4]))


def test_loss_is_least_at_the_exact_posterior() -> None:
    """For a linear model the bound's optimum is N(H⁻¹(Jᵀd/σ² + Pm), H⁻¹) with H = JᵀJ/σ² + P."""
    generator = np.random.default_rng(1)
    jacobian, prior = generator.normal(size=(12, 3)), np.diag([1.0, 2.0, 3.0])
    observed, noise = generator.normal(size=12), 0.3
    curvature = torch.tensor(jacobian.T @ jacobian / noise**2 + prior)
    exact = torch.linalg.solve(curvature, torch.tensor(jacobian.T @ observed / noise**2))
    mean = exact[None].clone().requires_grad_()
    factor = torch.linalg.cholesky(torch.linalg.inv(curvature))[None].clone().requires_grad_()
    gradient = (curvature @ (mean.detach()[0] - exact))[None]
    evidence_loss(mean, factor, gradient, curvature[None], torch.ones(1)).backward()
    torch.testing.assert_close(mean.grad, torch.zeros_like(mean.grad))
    torch.testing.assert_close(torch.tril(factor.grad[0]), torch.zeros(3, 3, dtype=torch.float64), atol=1e-10, rtol=0)
    for change in (1.1, 0.9):  # and any other covariance is worse
        other = evidence_loss(mean, change * factor, gradient, curvature[None], torch.ones(1))
        assert other > evidence_loss(mean, factor, gradient, curvature[None], torch.ones(1))


def test_gradient_by_the_mean_is_the_misfits() -> None:
    mean = torch.zeros(2, 3, requires_grad=True)
    gradient = torch.tensor([[1.0, -2.0, 3.0], [0.5, 0.0, -1.0]])
    factor, curvature = torch.eye(3).expand(2, 3, 3), torch.eye(3).expand(2, 3, 3)
    evidence_loss(mean, factor, gradient, curvature, torch.tensor([1.0, 0.5])).backward()
    torch.testing.assert_close(mean.grad, gradient * torch.tensor([[0.5], [0.25]]))


def test_the_expected_bound_is_a_network_of_its_own() -> None:
    """The posterior's weights don't change it."""
    torch.manual_seed(0)
    posterior, contact = ContactPosterior(10, BOX, width=16, blocks=2), torch.randn(4, 10)
    before = posterior.expected_bound_factor(contact)
    for name, weights in posterior.named_parameters():
        if not name.startswith("expected_bound."):
            weights.data.add_(0.1)
    torch.testing.assert_close(posterior.expected_bound_factor(contact), before)
    posterior.standardise(3 * torch.randn(50, 10) + 1)
    assert not torch.allclose(
        posterior.expected_bound_factor(contact), before
    )  # but it sees standardised features, too
