"""Shape functions and the sums over elements."""

import numpy as np
import pytest

from palpate.physics.fem.laws import LAWS, respond
from palpate.physics.fem.meshing import box, fill_cells
from palpate.physics.fem.solid import make_solid, qualities
from tests.physics.fem.bodies import block, rotation


@pytest.mark.parametrize("order", [1, 2])
def test_gradients_are_exact_for_polynomials_of_the_order(order: int) -> None:
    body = block(2, order, seed=0)
    affine = np.random.default_rng(0).normal(size=(3, 3))
    np.testing.assert_allclose(body.deformation(body.rest @ affine.T) - np.eye(3) - affine, 0, atol=1e-13)
    if order == 2:
        square = np.zeros_like(body.rest)
        square[:, 0] = body.rest[:, 1] ** 2
        mean = (body.weights * body.deformation(square)[..., 0, 1]).sum()
        assert mean == pytest.approx(1.0, rel=1e-13)  # ∫ 2y over the cube


def test_a_lattice_fills_its_cells_and_its_surface_is_closed() -> None:
    inside = np.random.default_rng(0).random((4, 3, 5)) < 0.6
    nodes, tetrahedra = fill_cells(inside)
    assert len(tetrahedra) == 5 * inside.sum()
    body = make_solid(nodes, tetrahedra)
    assert body.volumes.sum() == pytest.approx(inside.sum())
    corners = body.rest[body.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    np.testing.assert_allclose(normal.sum(axis=0), 0, atol=1e-12)
    assert (corners.mean(axis=1) * normal).sum() / 3 == pytest.approx(inside.sum())  # Gauss, faces seen from outside
    # Facing cells share their diagonals: no triangle lies within the block.
    assert len(block(4).faces) == 6 * 16 * 2


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("order", [1, 2])
def test_stiffness_is_the_derivative_of_the_forces(law: str, order: int) -> None:
    body = block(1, order)
    generator = np.random.default_rng(3)
    at, along = (0.05 * generator.normal(size=body.rest.shape) for _ in range(2))
    here = respond(law, body.deformation(at), 3.0, 7.0, tangent=True)
    more, less = (body.forces(respond(law, body.deformation(at + s * 1e-6 * along), 3.0, 7.0).stress) for s in (1, -1))
    found = (body.stiffness(here.tangent) @ along.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(found, (more - less) / 2e-6, atol=1e-7)


@pytest.mark.parametrize("law", [law for law in LAWS if law != "linear"])
def test_a_rigid_rotation_takes_no_force(law: str) -> None:
    body = block(2, seed=1)
    moved = body.rest @ (rotation(4) - np.eye(3)).T
    assert np.abs(body.forces(respond(law, body.deformation(moved), 3.0, 7.0).stress)).max() < 1e-13


def test_bad_meshes_are_refused() -> None:
    nodes, tetrahedra = box((1.0, 1.0, 1.0), (1, 1, 1))
    inverted, flat = tetrahedra.copy(), nodes.copy()
    inverted[2, :2] = inverted[2, 1::-1]
    flat[:, 2] = 0
    for mesh, said in (
        ((nodes, inverted), "1 of 5 tetrahedra are inverted or flat, number 2 first"),
        ((flat, tetrahedra), "5 of 5"),
        ((nodes, tetrahedra + 1), "of 8"),
        ((nodes[:, :2], tetrahedra), "nodes have shape"),
        ((nodes, tetrahedra[:, :3]), "tetrahedra have shape"),
    ):
        with pytest.raises(ValueError, match=said):
            make_solid(*mesh)
    with pytest.raises(ValueError, match="order is 3"):
        make_solid(nodes, tetrahedra, order=3)
    regular = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1.0]])
    assert qualities(regular, np.array([[0, 1, 2, 3]]))[0] == pytest.approx(np.sqrt(0.5))
