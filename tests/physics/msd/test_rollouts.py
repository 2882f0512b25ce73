"""The differentiable rollout: equal to numpy, right gradients, finite on the whole admissible box."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.physics import Bounds, Mechanics, Press, contact_normal, ramped
from palpate.physics.msd import reference, rollout, rollout_sensitivities, simulate_sensitivities
from tests.physics.batches import batch_of
from tests.physics.sheets import hand_mesh, loose, pressed, sheet

LOADS = {
    "vertex": lambda meshes: [
        pressed(mesh, at, hold, 200) for mesh, at, hold in zip(meshes, (44, 5), (50, 20), strict=False)
    ],
    "patch": lambda meshes: [
        Press.on_patch(mesh, at, 2.5, contact_normal(mesh, at), ramped(10, hold, 20, 200))
        for mesh, at, hold in zip(meshes, (30, 5), (30, 10), strict=False)
    ],
}
"""A load for each of up to two meshes."""


@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd")], ids=["euler", "dkd"])
@pytest.mark.parametrize("kind", ["vertex", "patch"])
def test_rollouts_equal_numpy_over_a_mixed_batch(kind, mechanics):
    meshes = [sheet(9, 8), sheet(9, 8, keep=0.5)]
    theta = torch.tensor([[0.7, 0.05, -0.1], [0.2, 0.3, -0.4]], dtype=torch.float64)
    watch = torch.tensor([[31, 30, 3], [5, 6, 20]])
    loads = LOADS[kind](meshes)
    first = rollout(theta, meshes, loads, mechanics)
    seen = rollout(theta, meshes, loads, mechanics, watch)
    for index in range(2):
        acts = loads[index]
        plain = reference.steps(theta[index].numpy(), meshes[index], acts, mechanics)
        expected = np.stack([displacement for displacement, _ in plain])
        np.testing.assert_allclose(seen[index].numpy(), expected[:, watch[index]], atol=1e-12)
        np.testing.assert_allclose(first[index].numpy(), expected[:, acts.vertex], atol=1e-12)


@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd")], ids=["euler", "dkd"])
@pytest.mark.parametrize("kind", ["vertex", "patch"])
@pytest.mark.parametrize("keep", [1.0, 0.5], ids=["grids", "mixed"])
def test_sensitivities_are_those_of_numpy_and_gradients_their_products(kind, keep, mechanics):
    """Those of numpy are compared with finite differences where numpy's simulation is tested."""
    meshes = [sheet(9, 8), sheet(9, 8, keep=keep)]
    loads = LOADS[kind](meshes)
    theta = torch.tensor([[0.7, 0.05, -0.1], [0.2, 0.3, -0.4]], dtype=torch.float64, requires_grad=True)
    for watch in (None, torch.tensor([[31, 30, 3], [5, 6, 20]])):
        path, slopes = rollout_sensitivities(theta, meshes, loads, mechanics, watch)
        assert not path.requires_grad
        assert not slopes.requires_grad
        for index, sample in enumerate(zip(meshes, loads, strict=True)):
            seen = {"watch": None if watch is None else watch[index].numpy(), "dtype": np.float64}
            expected = simulate_sensitivities(theta[index].detach().numpy(), *sample, mechanics, **seen)
            for values, others in zip((path, slopes), expected, strict=True):
                np.testing.assert_allclose(values[index], others, atol=1e-7 * np.abs(others).max())
        weights = torch.randn(path.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
        moved = rollout(theta, meshes, loads, mechanics, watch)
        (gradient,) = torch.autograd.grad((weights * moved).sum(), theta)
        product = (weights[..., None] * slopes).flatten(1, -2).sum(dim=1)
        torch.testing.assert_close(gradient, product, rtol=1e-7, atol=1e-7 * float(product.abs().max()))


def test_gradient_in_single_precision_agrees_with_double():
    mesh, load = batch_of([sheet(10, 10)], [44])
    gradients = []
    for dtype in (torch.float32, torch.float64):
        theta = torch.tensor([[0.7, 0.05, -0.1]], dtype=dtype, requires_grad=True)
        rollout(theta, mesh, load, Mechanics())[:, :, 2].mean().backward()
        gradients.append(theta.grad.double())
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=0)


box = st.tuples(*(st.floats(low, high) for low, high in zip(Bounds().lower, Bounds().upper, strict=True)))


@settings(max_examples=25, deadline=None)
@given(theta=box, scheme=st.sampled_from(["euler", "dkd"]), mesh=st.sampled_from([sheet(7, 7), loose(sheet(7, 7))]))
def test_motion_is_finite_on_the_whole_box(theta, scheme, mesh):
    mesh, load = batch_of([mesh], [24])
    values = torch.tensor([theta], dtype=torch.float32, requires_grad=True)
    trajectory = rollout(values, mesh, load, Mechanics(scheme=scheme))
    assert trajectory.shape == (1, 200, 3)
    assert torch.isfinite(trajectory).all()


def test_gradient_is_finite_at_rest_without_stiffness_and_with_coincident_vertices():
    mesh = hand_mesh([[0, 0, 1], [0, 0, 1], [0.01, 0, 1]], [[0, 1], [0, 2], [1, 2]])
    meshes, load = batch_of([mesh], [0])
    for values in ([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.5, 0.1, -1.0]):
        theta = torch.tensor([values], requires_grad=True)
        rollout(theta, meshes, load, Mechanics()).square().sum().backward()
        assert torch.isfinite(theta.grad).all()


def test_half_precision_is_computed_in_single():
    mesh, load = batch_of([sheet(6, 6)], [14])
    theta = torch.tensor([[0.5, 0.1, -0.1]], dtype=torch.float16)
    assert rollout(theta, mesh, load, Mechanics()).dtype == torch.float32


def test_shapes_that_do_not_belong_together_are_named():
    mesh, load = batch_of([sheet(6, 6)], [14])
    with pytest.raises(ValueError, match=r"theta has shape \(2, 3\); give \(1, 3\) for 1 meshes"):
        rollout(torch.zeros(2, 3), mesh, load, Mechanics())
    with pytest.raises(ValueError, match="0 meshes have 0 loads; give a load for each mesh, one at least"):
        rollout(torch.zeros(0, 3), [], [], Mechanics())
    with pytest.raises(ValueError, match="1 meshes have 2 loads"):
        rollout(torch.zeros(1, 3), mesh, load * 2, Mechanics())
    with pytest.raises(ValueError, match="names vertex 14; the mesh has 0"):
        rollout(torch.zeros(1, 3), [hand_mesh([], [])], load, Mechanics())
    with pytest.raises(ValueError, match=r"loads have \[100, 200\] steps; give all the same number"):
        rollout(torch.zeros(2, 3), mesh * 2, [load[0], load[0].until(100)], Mechanics())
