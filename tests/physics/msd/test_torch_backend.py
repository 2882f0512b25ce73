"""The torch reference: everything can be differentiated."""

import torch

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.rollouts import rollout
from palpate.physics.msd.torch_backend import integrator
from tests.physics.batches import batch_of
from tests.physics.sheets import sheet


def test_second_derivatives():
    mesh, load = batch_of([sheet(4, 4)], [5], [4], 10)
    theta = torch.tensor([[0.7, 0.05, -0.1]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradgradcheck(lambda value: rollout(value, mesh, load, backend="torch"), theta)


def test_gradient_by_the_mesh_and_the_direction():
    mesh, load = batch_of([sheet(4, 4)], [5], [4], 8)
    mesh.vertices, load.direction = mesh.vertices.double(), load.direction.double()
    theta = torch.tensor([[0.7, 0.05, -0.1]], dtype=torch.float64)

    def end_point(vertices, direction):
        mesh.vertices, load.direction = vertices, direction
        return rollout(theta, mesh, load)

    inputs = (mesh.vertices.clone().requires_grad_(), load.direction.clone().requires_grad_())
    assert torch.autograd.gradcheck(end_point, inputs, eps=1e-7, atol=1e-5)


def test_exact_damping_is_smooth_through_zero():
    damping = torch.tensor([0.0, 1e-5, 1.999e-4, 2.001e-4, 0.1], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda value: integrator(value, Mechanics(scheme="dkd"))[:2], damping)
