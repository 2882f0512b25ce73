"""The evidence bound against torch's own divergence and a matrix's own root."""

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm
from torch.distributions import MultivariateNormal, kl_divergence

from palpate.models.evidence import MAX_MEAN_STEP, MEAN_WEIGHT, box_prior, covering, negative_evidence
from palpate.physics.likelihood import Linearised

LOWER, UPPER = (torch.log(torch.tensor(values)) for values in ([0.05, 0.005, 0.01], [1.0, 0.5, 0.3]))


def posterior(size: int = 4) -> tuple[torch.Tensor, torch.Tensor, list[Linearised]]:
    """Random means and factors in the box, and random misfits, double precision."""
    generator = np.random.default_rng(5)
    mean = (LOWER + (UPPER - LOWER) * torch.from_numpy(generator.uniform(0.2, 0.8, (size, 3)))).double()
    factor = torch.from_numpy(np.tril(generator.normal(0, 0.1, (size, 3, 3))) + 0.3 * np.eye(3))
    found = []
    for _ in range(size):
        jacobian, residual = generator.normal(0, 3, (12, 3)), generator.normal(0, 2, 12)
        found.append(Linearised(residual, jacobian))
    return mean, factor, found


def parabolas(found: list[Linearised]) -> list[torch.Tensor]:
    """Misfits, gradients and information."""
    return [
        torch.from_numpy(np.stack([getattr(item, name) for item in found]))
        for name in ("misfit", "gradient", "information")
    ]


def linear_bound(mean, factor, start, found: list[Linearised]) -> torch.Tensor:
    """-E_q[log p] + KL(q‖prior) of every sample for a likelihood linear around `start`, in closed form by torch."""
    low, high = LOWER.double(), UPPER.double()
    prior = MultivariateNormal(0.5 * (low + high), torch.diag((high - low) ** 2 / 12))
    divergence = kl_divergence(MultivariateNormal(mean, scale_tril=factor), prior)
    misfits, gradients, informations = parabolas(found)
    step = mean - start
    expected = misfits + (gradients * step).sum(1) + 0.5 * torch.einsum("bi,bij,bj->b", step, informations, step)
    return expected + 0.5 * torch.einsum("bij,bik,bkj->b", factor, informations, factor) + divergence


def test_value_is_the_linearised_bound():
    mean, factor, found = posterior()
    loss = negative_evidence(mean, factor, *parabolas(found), LOWER.double(), UPPER.double())
    assert loss.item() == pytest.approx(linear_bound(mean, factor, mean, found).mean().item(), rel=1e-9)


def test_gradient_by_the_covariance_is_the_bound_s_and_by_the_mean_its_preconditioned_one():
    start, factor, found = posterior()
    mean, factor = start.clone().requires_grad_(), factor.requires_grad_()
    negative_evidence(mean, factor, *parabolas(found), LOWER.double(), UPPER.double()).backward()
    by_mean, by_factor = mean.grad.clone(), factor.grad.clone()
    mean.grad = factor.grad = None
    linear_bound(mean, factor, start, found).mean().backward()
    torch.testing.assert_close(by_factor.tril(), factor.grad.tril())
    prior = np.diag(12 / (UPPER - LOWER).double().numpy() ** 2)
    for pulled, gradient, item in zip(by_mean.numpy(), mean.grad.numpy(), found, strict=True):
        hessian = item.information + prior
        longest = np.abs(np.linalg.solve(hessian, len(found) * gradient)).max()
        expected = MEAN_WEIGHT * min(1, MAX_MEAN_STEP / longest) * np.linalg.solve(sqrtm(hessian).real, gradient)
        np.testing.assert_allclose(pulled, expected, rtol=1e-6)


def test_a_badly_explained_contact_does_not_drown_the_others():
    mean, factor, found = posterior()
    worst = found[0]._replace(residual=1e3 * found[0].residual)
    mean = mean.requires_grad_()
    negative_evidence(mean, factor, *parabolas([worst, *found[1:]]), LOWER.double(), UPPER.double()).backward()
    sizes = mean.grad.norm(dim=1)
    assert sizes[0] < 5 * MAX_MEAN_STEP * sizes[1:].max()


def test_of_what_was_not_seen_the_prior_alone_is_left():
    mean, factor, _ = posterior(1)
    low, high = LOWER.double(), UPPER.double()
    prior = MultivariateNormal(0.5 * (low + high), torch.diag((high - low) ** 2 / 12))
    nothing = torch.zeros(1), torch.zeros(1, 3), torch.zeros(1, 3, 3)
    loss = negative_evidence(mean, factor, *nothing, low, high)
    assert loss.item() == pytest.approx(
        kl_divergence(MultivariateNormal(mean[0], scale_tril=factor[0]), prior).item(), rel=1e-9
    )


def test_covering_is_the_cross_entropy():
    mean, factor, found = posterior()
    whole = parabolas(found)[2] + box_prior(LOWER.double(), UPPER.double())[0]
    best = mean + 0.1
    own = MultivariateNormal(best, precision_matrix=whole)
    expected = kl_divergence(own, MultivariateNormal(mean, scale_tril=factor)) + own.entropy()
    constant = 1.5 * np.log(2 * np.pi)
    assert covering(mean, factor, best, whole).item() + constant == pytest.approx(expected.mean().item(), rel=1e-9)


def test_the_box_s_prior_has_the_moments_of_the_uniform_distribution():
    precision, middle = box_prior(torch.tensor([0.0, 1.0, -1.0]), torch.tensor([1.0, 3.0, 0.0]))
    torch.testing.assert_close(precision, torch.diag(torch.tensor([12.0, 3.0, 12.0])))
    torch.testing.assert_close(middle, torch.tensor([0.5, 2.0, -0.5]))
