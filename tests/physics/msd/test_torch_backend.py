"""The torch reference: the stencil equals the edge list, and everything can be differentiated."""

import pytest
import torch

from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import grid_mesh
from palpate.physics.msd.rollouts import rollout
from palpate.physics.msd.torch_backend import edge_steps, integrator, is_grid, watched_trajectory
from tests.physics.batches import batch_of
from tests.physics.sheets import sheet, surface


@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd")])
def test_stencil_equals_edge_list(mechanics):
    valid = torch.rand(9, 8, generator=torch.Generator().manual_seed(0)).numpy() > 0.1
    mesh, load = batch_of([grid_mesh(surface(9, 8), valid, max_edge=1.0), sheet(9, 8)], [20, 30], [20, 50])
    theta = torch.tensor([[0.7, 0.05, -0.1], [0.2, 0.3, -0.4]], dtype=torch.float64)
    assert is_grid(mesh)
    watch = torch.tensor([[20, 3], [30, 31]])
    place = mesh.vertex_offsets[:-1, None] + watch
    expected = torch.stack(list(edge_steps(theta, mesh, place, load, mechanics)), dim=1)
    seen = watched_trajectory(theta, mesh, load, watch, mechanics)
    torch.testing.assert_close(seen, expected, rtol=0, atol=1e-14)


def test_other_meshes_are_no_grid():
    assert not is_grid(batch_of([sheet(9, 8, keep=0.5)], [5])[0])
    mesh, _ = batch_of([sheet(4, 4)], [5])
    mesh.pixels = torch.zeros_like(mesh.pixels)
    assert not is_grid(mesh)


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
