"""Divided tetrahedra fill the same body without hanging nodes, and are as short as was asked for."""

import numpy as np
import pytest

from palpate.physics.fem import Material, box, find_equilibrium, make_solid
from palpate.physics.fem.meshing import GROWTH, WORST, around, refine
from palpate.physics.fem.solid import EDGES, qualities

PLACE = np.array([[0.5, 0.5, 1.0]])


def divided() -> tuple[np.ndarray, np.ndarray]:
    return refine(*box((1.0, 1.0, 1.0), (3, 3, 3)), around(PLACE, 0.2, 0.2))


def test_the_body_stays_whole() -> None:
    """A hanging node would leave inner faces bare, of which the surface would be larger, and fail the patch test."""
    solid = make_solid(*divided())
    assert solid.volumes.sum() == pytest.approx(1)
    one, two, three = solid.rest[solid.faces].transpose(1, 0, 2)
    assert np.linalg.norm(np.cross(two - one, three - one), axis=1).sum() / 2 == pytest.approx(6)
    held = np.repeat(((solid.rest == 0) | (solid.rest == 1)).any(axis=1)[:, None], 3, axis=1)
    motion = solid.rest @ [[0.1, 0.02, 0], [0, -0.05, 0.03], [0.01, 0, 0.04]]
    found = find_equilibrium(solid, Material("neo_hookean", 1e4, 0.3), held, motion=motion)
    np.testing.assert_allclose(found.displacement, motion, atol=1e-8)


def test_edges_are_as_short_as_asked_for_and_elements_no_slivers() -> None:
    coarse, (nodes, tetrahedra) = box((1.0, 1.0, 1.0), (3, 3, 3)), divided()
    np.testing.assert_array_equal(nodes[: len(coarse[0])], coarse[0])
    corners = nodes[tetrahedra]
    length = np.linalg.norm(corners[:, EDGES[:, 0]] - corners[:, EDGES[:, 1]], axis=2).max(axis=1)
    apart = np.linalg.norm(corners.mean(axis=1) - PLACE, axis=1)
    assert (length <= 0.2 + GROWTH * np.maximum(apart - 0.2, 0) + 1e-12).all()
    assert length[apart > 0.8].mean() > 1.5 * length[apart < 0.2].mean()
    assert qualities(nodes, tetrahedra).min() > WORST
    same = refine(*coarse, lambda places: np.full(len(places), 9.0))
    np.testing.assert_array_equal(same[1], coarse[1])
