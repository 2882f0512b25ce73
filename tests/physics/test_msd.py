"""The differentiable rollout: equal to numpy, right gradients, finite on the whole admissible box."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from batches import batch_of
from hypothesis import given, settings
from hypothesis import strategies as st
from sheets import hand_mesh, sheet

from physics import jit, msd_numpy
from physics.mechanics import Bounds, Mechanics
from physics.msd import MeshBatch, rollout, rollout_field
from physics.msd_kernel import load_profile

BACKENDS = [
    pytest.param("numba", marks=pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")),
    "torch",
]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "mechanics",
    [
        Mechanics(),
        Mechanics(scheme="dkd"),
        Mechanics(boundary="free", anchor=0.5),
        Mechanics(damping="explicit", steps=120),
    ],
    ids=["default", "dkd", "anchored", "explicit"],
)
def test_backends_equal_numpy_over_a_mixed_batch(mechanics, backend):
    meshes, vertices, steps = [sheet(9, 8), sheet(9, 8, keep=0.5)], [30, 5], [50, 20]
    theta = torch.tensor([[0.7, 0.05, -0.1], [0.2, 0.3, -0.4]], dtype=torch.float64)
    mesh, contact = batch_of(meshes, vertices, steps)
    seen = rollout(theta, mesh, contact, mechanics, backend)
    field = rollout_field(theta, mesh, contact, mechanics, backend)
    for index in range(2):
        start, end = mesh.vertex_offsets[index : index + 2].tolist()
        direction = contact.direction[index].numpy()
        load = load_profile(mechanics, steps[index])
        plain = msd_numpy.steps(theta[index].numpy(), meshes[index], vertices[index], direction, mechanics, load)
        expected = np.stack(list(plain))
        np.testing.assert_allclose(field[:, start:end].numpy(), expected, atol=1e-12)
        np.testing.assert_allclose(seen[index].numpy(), expected[:, vertices[index]], atol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd")], ids=["euler", "dkd"])
@pytest.mark.parametrize("theta", [(0.7, 0.05, -0.1), (0.5, 0.5, -5.0), (0.1, 0.01, -0.02)])
def test_gradient_equals_finite_differences_over_all_steps(theta, mechanics, backend):
    mesh, contact = batch_of([sheet(10, 10)], [44])
    weight = torch.randn(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))

    def loss(values):
        return (weight * rollout(values[None], mesh, contact, mechanics, backend)[0]).sum()

    values = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(loss(values), values)
    for index in range(3):
        offset = torch.zeros(3, dtype=torch.float64)
        offset[index] = 1e-5 * abs(theta[index])
        with torch.no_grad():
            central = (loss(values + offset) - loss(values - offset)) / (2 * offset[index])
        assert gradient[index].item() == pytest.approx(central.item(), rel=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_gradient_in_single_precision_agrees_with_double(backend):
    mesh, contact = batch_of([sheet(10, 10)], [44])
    gradients = []
    for dtype in (torch.float32, torch.float64):
        theta = torch.tensor([[0.7, 0.05, -0.1]], dtype=dtype, requires_grad=True)
        rollout(theta, mesh, contact, backend=backend)[:, :, 2].mean().backward()
        gradients.append(theta.grad.double())
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=0)


box = st.tuples(*(st.floats(low, high) for low, high in zip(Bounds().lower, Bounds().upper, strict=True)))


@settings(max_examples=25, deadline=None)
@given(
    theta=box,
    scheme=st.sampled_from(["euler", "dkd"]),
    boundary=st.sampled_from(["fixed", "free"]),
    backend=st.sampled_from(["auto", "torch"]),
)
def test_implicit_damping_is_finite_on_the_whole_box(theta, scheme, boundary, backend):
    mesh, contact = batch_of([sheet(7, 7)], [24])
    values = torch.tensor([theta], dtype=torch.float32, requires_grad=True)
    trajectory = rollout(values, mesh, contact, Mechanics(scheme=scheme, boundary=boundary), backend)
    assert trajectory.shape == (1, 200, 3)
    assert torch.isfinite(trajectory).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_gradient_is_finite_at_rest_without_stiffness_and_with_coincident_vertices(backend):
    mesh = hand_mesh([[0, 0, 1], [0, 0, 1], [0.01, 0, 1]], [[0, 1], [0, 2], [1, 2]])
    joined, contact = batch_of([mesh], [0])
    for values in ([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.5, 0.1, -1.0]):
        theta = torch.tensor([values], requires_grad=True)
        rollout(theta, joined, contact, Mechanics(boundary="free"), backend).square().sum().backward()
        assert torch.isfinite(theta.grad).all()


def test_load_can_be_given_step_by_step():
    meshes, vertices = [sheet(6, 6), sheet(6, 6)], [14, 15]
    theta = torch.tensor([[0.7, 0.05, -0.1], [0.2, 0.3, -0.4]])
    mesh, contact = batch_of(meshes, vertices, [50, 7])
    profile = (torch.arange(200) < torch.tensor([[50], [7]])).float()
    same = batch_of(meshes, vertices, [0, 0], profile)[1]
    torch.testing.assert_close(rollout(theta, mesh, same), rollout(theta, mesh, contact))


def test_half_precision_is_computed_in_single():
    mesh, contact = batch_of([sheet(6, 6)], [14])
    assert rollout(torch.tensor([[0.5, 0.1, -0.1]], dtype=torch.float16), mesh, contact).dtype == torch.float32


def test_shapes_that_do_not_belong_together_are_named():
    mesh, contact = batch_of([sheet(6, 6)], [14])
    with pytest.raises(ValueError, match=r"theta has shape \(2, 3\); give \(1, 3\) for 1 meshes"):
        rollout(torch.zeros(2, 3), mesh, contact)
    with pytest.raises(ValueError, match="no mesh"):
        MeshBatch.from_meshes([])
    with pytest.raises(ValueError, match="no vertices"):
        MeshBatch.from_meshes([hand_mesh([], [])])
    with pytest.raises(ValueError, match="don't form one batch"):
        MeshBatch.from_meshes([sheet(6, 6), sheet(6, 7)])
