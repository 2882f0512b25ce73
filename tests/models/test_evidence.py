"""The evidence bound against brute force: finite differences of the simulator, torch's own divergence, samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm
from torch.distributions import MultivariateNormal, kl_divergence

from models.evidence import LONGEST_MOVE, PULL, Linearised, Motion, linearise, linearise_batch, negative_evidence
from physics.mechanics import Mechanics
from physics.msd_autograd import split
from physics.msd_kernel import simulate
from physics.observation import ObservationBatch

MECHANICS = Mechanics(steps=24, load_steps=8, scheme="dkd")
LOGS = np.log([0.4, 0.05, 0.06])
NOISE = 1e-3
LOWER, UPPER = (torch.log(torch.tensor(values)) for values in ([0.05, 0.005, 0.01], [1.0, 0.5, 0.3]))


@pytest.fixture
def motion(make_batch) -> Motion:
    """A contact that was seen at five instants, with an error."""
    batch = make_batch()
    contact = batch["contact_a"]
    steps = np.array([3, 7, 11, 15, 19])
    place = split(batch["mesh_a"])[0], int(contact.vertex[0]), contact.direction[0].numpy()
    path = simulate(np.array([0.5, 0.04, -0.07]), *place, MECHANICS, load_steps=8, dtype=np.float64)
    error = np.random.default_rng(0).normal(0, NOISE, (5, 3))
    return Motion(*place, load_steps=8, steps=steps, displacement=path[steps] + error)


def misfit(motion: Motion, logs: np.ndarray) -> float:
    """-log p(d|φ) up to a constant, by the simulator alone."""
    theta = np.exp(logs) * (1.0, 1.0, -1.0)
    place = motion.mesh, motion.vertex, motion.direction
    path = simulate(theta, *place, MECHANICS, load_steps=motion.load_steps, dtype=np.float64)
    return 0.5 * np.square(path[motion.steps] - motion.displacement).sum() / NOISE**2


def test_gradient_of_the_misfit_is_the_simulator_s(motion: Motion):
    found = linearise(motion, LOGS, NOISE, MECHANICS)
    assert found.misfit == pytest.approx(misfit(motion, LOGS), rel=1e-3)
    offsets = 1e-4 * np.eye(3)
    slopes = [(misfit(motion, LOGS + offset) - misfit(motion, LOGS - offset)) / 2e-4 for offset in offsets]
    assert np.abs(slopes).min() > 0.1
    np.testing.assert_allclose(found.gradient, slopes, rtol=5e-3)


def test_information_is_the_misfit_s_curvature_where_it_is_explained(motion: Motion):
    path = simulate(
        np.exp(LOGS) * (1, 1, -1), motion.mesh, motion.vertex, motion.direction, MECHANICS, load_steps=8,
        dtype=np.float64,
    )  # fmt: skip
    exact = motion._replace(displacement=path[motion.steps])
    information = linearise(exact, LOGS, NOISE, MECHANICS).information
    for direction in np.eye(3):
        around = misfit(exact, LOGS + 1e-3 * direction) + misfit(exact, LOGS - 1e-3 * direction)
        assert direction @ information @ direction == pytest.approx(around / 1e-6, rel=1e-2)


def test_nothing_seen_gives_no_information(motion: Motion):
    unseen = motion._replace(steps=np.empty(0, np.int64), displacement=np.empty((0, 3)), load_steps=0)
    found = linearise(unseen, LOGS, NOISE, MECHANICS)
    assert (found.misfit, found.gradient.any(), found.information.any()) == (0.0, False, False)


def posterior(size: int = 4) -> tuple[torch.Tensor, torch.Tensor, list[Linearised]]:
    """Random means and factors in the box, and random misfits, double precision."""
    generator = np.random.default_rng(5)
    mean = (LOWER + (UPPER - LOWER) * torch.from_numpy(generator.uniform(0.2, 0.8, (size, 3)))).double()
    factor = torch.from_numpy(np.tril(generator.normal(0, 0.1, (size, 3, 3))) + 0.3 * np.eye(3))
    found = []
    for _ in range(size):
        jacobian, residual = generator.normal(0, 3, (12, 3)), generator.normal(0, 2, 12)
        found.append(Linearised(0.5 * residual @ residual, jacobian.T @ residual, jacobian.T @ jacobian))
    return mean, factor, found


def linear_bound(mean, factor, start, found: list[Linearised]) -> torch.Tensor:
    """-E_q[log p] + KL(q‖prior) of every sample for a likelihood linear around `start`, in closed form by torch."""
    low, high = LOWER.double(), UPPER.double()
    prior = MultivariateNormal(0.5 * (low + high), torch.diag((high - low) ** 2 / 12))
    divergence = kl_divergence(MultivariateNormal(mean, scale_tril=factor), prior)
    misfits, gradients, informations = (torch.from_numpy(np.stack(values)) for values in zip(*found, strict=True))
    step = mean - start
    expected = misfits + (gradients * step).sum(1) + 0.5 * torch.einsum("bi,bij,bj->b", step, informations, step)
    return expected + 0.5 * torch.einsum("bij,bik,bkj->b", factor, informations, factor) + divergence


def test_value_is_the_linearised_bound():
    mean, factor, found = posterior()
    loss = negative_evidence(mean, factor, found, LOWER.double(), UPPER.double())
    assert loss.item() == pytest.approx(linear_bound(mean, factor, mean, found).mean().item(), rel=1e-9)


def test_gradient_by_the_covariance_is_the_bound_s_and_by_the_mean_its_preconditioned_one():
    start, factor, found = posterior()
    mean, factor = start.clone().requires_grad_(), factor.requires_grad_()
    negative_evidence(mean, factor, found, LOWER.double(), UPPER.double()).backward()
    by_mean, by_factor = mean.grad.clone(), factor.grad.clone()
    mean.grad = factor.grad = None
    linear_bound(mean, factor, start, found).mean().backward()
    torch.testing.assert_close(by_factor.tril(), factor.grad.tril())
    prior = np.diag(12 / (UPPER - LOWER).double().numpy() ** 2)
    for pulled, gradient, item in zip(by_mean.numpy(), mean.grad.numpy(), found, strict=True):
        hessian = item.information + prior
        longest = np.abs(np.linalg.solve(hessian, len(found) * gradient)).max()
        expected = PULL * min(1, LONGEST_MOVE / longest) * np.linalg.solve(sqrtm(hessian).real, gradient)
        np.testing.assert_allclose(pulled, expected, rtol=1e-6)


def test_gradient_vanishes_at_the_bound_s_optimum():
    mean, _, found = posterior()
    low, high = LOWER.double(), UPPER.double()
    prior = 12 / (high - low) ** 2
    away = (mean - 0.5 * (low + high)) * prior
    hessians = torch.stack([torch.from_numpy(item.information) + torch.diag(prior) for item in found])
    best = [item._replace(gradient=-push.numpy()) for item, push in zip(found, away, strict=True)]
    factor = torch.linalg.cholesky(torch.linalg.inv(hessians)).requires_grad_()
    mean = mean.requires_grad_()
    negative_evidence(mean, factor, best, low, high).backward()
    assert mean.grad.abs().max() < 1e-12
    assert factor.grad.tril().abs().max() < 1e-9


def test_a_badly_explained_contact_does_not_drown_the_others():
    mean, factor, found = posterior()
    worst = found[0]._replace(misfit=1e6 * found[0].misfit, gradient=1e3 * found[0].gradient)
    mean = mean.requires_grad_()
    negative_evidence(mean, factor, [worst, *found[1:]], LOWER.double(), UPPER.double()).backward()
    sizes = mean.grad.norm(dim=1)
    assert sizes[0] < 5 * LONGEST_MOVE * sizes[1:].max()


def test_a_batch_is_its_samples_one_by_one_without_the_padding(make_batch, motion: Motion):
    batch = make_batch()
    steps = torch.tensor([[3, 7, 11, 15, 19], [5, 0, 0, 0, 0]])
    displacement = torch.zeros(2, 5, 3)
    displacement[0] = torch.from_numpy(motion.displacement)
    displacement[1, 0], displacement[1, 1:] = 0.01, torch.nan
    observation = ObservationBatch(steps, displacement, torch.tensor([[1.0] * 5, [1.0, 0, 0, 0, 0]]))
    contact = dataclasses.replace(batch["contact_a"], load_steps=torch.tensor([8, 6]))
    mean = torch.from_numpy(np.stack([LOGS, LOGS + 0.1])).float()
    noise = torch.tensor([NOISE, 2 * NOISE])
    first, second = linearise_batch(mean, noise, batch["mesh_a"], contact, observation, MECHANICS)
    np.testing.assert_allclose(first.gradient, linearise(motion, LOGS, NOISE, MECHANICS).gradient, rtol=1e-3)
    alone = Motion(
        split(batch["mesh_a"])[1], int(contact.vertex[1]), contact.direction[1].numpy(), 6, np.array([5]),
        np.full((1, 3), 0.01, np.float32),
    )  # fmt: skip
    expected = linearise(alone, LOGS + 0.1, 2 * NOISE, MECHANICS)
    np.testing.assert_allclose(second.information, expected.information, rtol=1e-3)
    assert second.misfit == pytest.approx(expected.misfit, rel=1e-3)
