"""Curved elements fill a round body, and what is linear in place is exact on them."""

import numpy as np
import pytest

from benchmarks.palpation.synthetic import sphere
from palpate.physics.fem import Solid, box, make_solid, mesh_surface
from palpate.physics.fem.curved import curve

BALL = 4 / 3 * np.pi


@pytest.fixture(scope="module")
def bodies() -> tuple[Solid, Solid]:
    """A ball of straight elements, and of curved ones."""
    vertices, triangles = sphere(5)
    meshed = mesh_surface(vertices, triangles, cells=7, longest=lambda places: np.full(len(places), 9.0))
    straight = make_solid(meshed.nodes, meshed.tetrahedra, order=2)
    return straight, curve(straight, vertices[triangles], np.zeros(len(straight.rest), bool))


def test_a_ball_is_filled(bodies: tuple[Solid, Solid]) -> None:
    straight, curved = bodies
    assert straight.volumes.sum() < 0.96 * BALL
    assert curved.volumes.sum() == pytest.approx(BALL, rel=0.006)
    outer = np.unique(straight.faces)
    np.testing.assert_array_equal(curved.rest[outer], straight.rest[outer])


def test_what_is_linear_in_place_is_exact(bodies: tuple[Solid, Solid]) -> None:
    _, curved = bodies
    slope = np.array([[0.1, 0.02, 0.0], [0.0, -0.05, 0.03], [0.01, 0.0, 0.04]])
    deformed = curved.deformation(curved.rest @ slope.T)
    np.testing.assert_allclose(deformed, np.broadcast_to(np.eye(3) + slope, deformed.shape), atol=1e-12)


def test_flat_faces_and_fixed_nodes_stay() -> None:
    block = make_solid(*box((1.0, 1.0, 1.0), (2, 2, 2)), order=2)
    flat = curve(block, block.rest[block.faces], np.zeros(len(block.rest), bool))
    np.testing.assert_allclose(flat.rest, block.rest, atol=1e-12)
    np.testing.assert_allclose(flat.gradients, block.gradients, atol=1e-12)
    raised = block.rest[block.faces] + np.array([0, 0, 0.05])
    top = block.rest[:, 2] < 1
    moved = curve(block, raised[raised[:, :, 2].min(axis=1) > 1], top).rest - block.rest
    assert np.abs(moved[top]).max() == 0
    middles = np.flatnonzero(~top & (np.arange(len(block.rest)) >= block.elements[:, :4].max() + 1))
    np.testing.assert_allclose(moved[middles], np.broadcast_to([0, 0, 0.05], (len(middles), 3)), atol=1e-12)


def test_an_element_that_would_be_crushed_goes_back() -> None:
    """A surface below the body's middle would turn its upper elements inside out."""
    block = make_solid(*box((1.0, 1.0, 1.0), (2, 2, 2)), order=2)
    low = np.array([[[-9, -9, 0.1], [9, -9, 0.1], [0, 9, 0.1]]])
    found = curve(block, low, block.rest[:, 2] < 1)
    assert (np.linalg.det(block.deformation(found.rest - block.rest)) > 0).all()
    assert found.weights.min() > 0
