"""A surface carried by tetrahedra moves as they do, and forces on it do the same work."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.palpation import cover
from estimators.palpation.skin import Match
from physics.fem import box, make_solid


def surface(count: int) -> tuple[np.ndarray, np.ndarray]:
    fine = make_solid(*box((1.0, 1.0, 1.0), (count, count, count)))
    used, which = np.unique(fine.faces, return_inverse=True)
    return fine.rest[used], which.reshape(-1, 3)


@pytest.mark.parametrize("order", [1, 2])
def test_displacements_of_the_elements_own_degree_are_exact(order: int) -> None:
    skin = cover(make_solid(*box((1.0, 1.0, 1.0), (2, 2, 2)), order=order), *surface(5))

    def field(places: np.ndarray) -> np.ndarray:
        return places @ [[1, 2, 0], [0, 1, 3], [1, 0, 0]] + (places[:, :1] ** 2 if order == 2 else 0)

    moved = skin.moved(field(skin.body.rest))
    np.testing.assert_allclose(moved - skin.vertices, field(skin.vertices), atol=1e-12)
    assert skin.areas.sum() == pytest.approx(6)


def test_a_press_keeps_its_force_and_its_moment() -> None:
    skin = cover(make_solid(*box((1.0, 1.0, 1.0), (2, 2, 2)), order=2), *surface(10))
    place, force = np.array([0.5, 0.5, 1.0]), np.array([1.0, 2.0, -3.0])
    forces = skin.pressed(place, 0.3, force)
    np.testing.assert_allclose(forces.sum(axis=0), force, atol=1e-12)
    np.testing.assert_allclose(np.cross(skin.body.rest, forces).sum(axis=0), np.cross(place, force), atol=1e-2)
    with pytest.raises(ValueError, match="0 vertices lie within"):
        skin.pressed(np.array([5.0, 5, 5]), 0.3, force)


def test_triangles_that_face_inwards_are_turned() -> None:
    vertices, triangles = surface(2)
    body = make_solid(*box((1.0, 1.0, 1.0), (1, 1, 1)))
    for each in (triangles, triangles[:, ::-1]):
        skin = cover(body, vertices, each)
        match = Match.of(np.array([[0.5, 0.4, 1.2]]), vertices, skin.triangles)
        assert match.distance == pytest.approx(0.2)
        np.testing.assert_allclose(match.normal, [[0, 0, 1]], atol=1e-12)
