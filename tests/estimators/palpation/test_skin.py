"""A surface carried by tetrahedra moves as they do, and forces on it do the same work."""

import numpy as np
import pytest

from palpate.estimators.palpation.skin import Match, cover
from palpate.physics.fem import Solid, box, make_solid


def cube(count: int, order: int = 1) -> Solid:
    """Cube of edges of 1, so many cells each."""
    return make_solid(*box((1.0, 1.0, 1.0), (count, count, count)), order=order)


def surface(count: int) -> tuple[np.ndarray, np.ndarray]:
    fine = cube(count)
    used, which = np.unique(fine.faces, return_inverse=True)
    return fine.rest[used], which.reshape(-1, 3)


@pytest.mark.parametrize("order", [1, 2])
def test_displacements_of_the_elements_own_degree_are_exact(order: int) -> None:
    skin = cover(cube(2, order), *surface(5))

    def field(places: np.ndarray) -> np.ndarray:
        return places @ [[1, 2, 0], [0, 1, 3], [1, 0, 0]] + (places[:, :1] ** 2 if order == 2 else 0)

    moved = skin.moved(field(skin.body.rest))
    np.testing.assert_allclose(moved - skin.vertices, field(skin.vertices), atol=1e-12)


def test_places_know_how_far_sharp_edges_and_rims_are() -> None:
    skin = cover(cube(1), *surface(5))
    places = np.array([[0.5, 0.5, 1.0], [0.5, 0.93, 1.0], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(skin.from_creases(places), [0.5, 0.07, 0.2, 0], atol=0.02)
    corners, triangles = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    sheet = cover(skin.body, corners, triangles)
    assert sheet.from_creases(np.array([[0.5, 0.5, 0.0]])) == pytest.approx(0.5, abs=0.02)  # not the diagonal
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    one, two = np.arange(40), (np.arange(40) + 1) % 40
    walls = np.column_stack([one, two, two + 40]), np.column_stack([one, two + 40, one + 40])
    round_body = cover(skin.body, np.concatenate([ring, np.add(ring, [0, 0, 1])]), np.concatenate(walls))
    assert round_body.from_creases(np.array([[1.0, 0, 0.4]])) == pytest.approx(0.4, abs=0.1)  # its rims alone


def test_sights_meet_the_place_that_was_seen_however_far_off_the_point_is() -> None:
    """Beside edges by more than that: behind them another side may be closer. A line that passes by meets none."""
    vertices, triangles = surface(5)
    chance = np.random.default_rng(0)
    eye = np.array([2.0, 1.5, 4.0])
    places = np.concatenate([chance.uniform(0.2, 0.8, (200, 2)), np.ones((200, 1))], axis=1)
    back = (eye - places) / np.linalg.norm(eye - places, axis=1, keepdims=True)
    off = chance.normal(0, 0.05, 200)
    match = Match.along(places + off[:, None] * back, back, vertices, triangles)
    np.testing.assert_allclose(match.distance, off, atol=1e-9)
    np.testing.assert_allclose(match.at(triangles, vertices), places, atol=1e-9)
    beside = Match.along(np.array([[1.1, 0.5, 1.1]]), np.array([[0.0, 0.0, 1.0]]), vertices, triangles)
    assert np.isnan(beside.distance).all()


def test_held_vertices_stand_still_whatever_the_elements_do() -> None:
    vertices, triangles = surface(4)
    skin = cover(cube(2), vertices, triangles, vertices[:, 2] <= 0.25)
    moved = skin.moved(np.ones_like(skin.body.rest)) - vertices
    np.testing.assert_allclose(moved, np.repeat(vertices[:, 2:] > 0.25, 3, axis=1), atol=1e-12)


def test_a_press_keeps_its_force_and_its_moment() -> None:
    """Also beside the surface's vertices, and as wide as it is: of 1 - (r/R)² the mean of r² is R²/3."""
    skin = cover(cube(2, 2), *surface(10))
    place, force = np.array([0.53, 0.46, 1.0]), np.array([1.0, 2.0, -3.0])
    forces = skin.pressed(place, 0.3, force)
    np.testing.assert_allclose(forces.sum(axis=0), force, atol=1e-12)
    np.testing.assert_allclose(np.cross(skin.body.rest, forces).sum(axis=0), np.cross(place, force), atol=2e-3)
    # Work on u = r², which quadratic elements hold exactly, and triangles with legs h too large by h²/3 on average.
    work = forces[:, 2] @ np.square(skin.body.rest - place).sum(axis=1)
    assert work == pytest.approx(-3 * (0.3**2 + 0.1**2) / 3, rel=0.01)
    with pytest.raises(ValueError, match="0 vertices lie within"):
        skin.pressed(np.array([5.0, 5, 5]), 0.3, force)


def test_triangles_that_face_inwards_are_turned() -> None:
    vertices, triangles = surface(2)
    for each in (triangles, triangles[:, ::-1]):
        skin = cover(cube(1), vertices, each)
        match = Match.of(np.array([[0.5, 0.4, 1.2]]), vertices, skin.triangles)
        assert match.distance == pytest.approx(0.2)
        np.testing.assert_allclose(match.normal, [[0, 0, 1]], atol=1e-12)
