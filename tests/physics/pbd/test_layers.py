"""Volumes below surfaces: they hold what lies there, each part once."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.physics.fem.solid import outer_faces
from palpate.physics.pbd.layers import layered
from tests.physics.pbd.particles import sheet

DOWN = np.array([0.0, 0.0, -1.0])


def volumes(rest: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    return np.linalg.det(rest[tetrahedra[:, 1:]] - rest[tetrahedra[:, :1]]) / 6


def anticlockwise(body) -> np.ndarray:
    """Faces of a sheet as they are visible from above."""
    one, two, three = body.rest[body.faces].transpose(1, 0, 2)
    turned = np.cross(two - one, three - one)[:, 2] < 0
    return np.where(turned[:, None], body.faces[:, ::-1], body.faces)


def test_a_flat_sheet_becomes_a_block():
    flat = sheet(4, 6, 0.01)
    rest, tetrahedra = layered(flat.rest, anticlockwise(flat), 0.02 * np.tile(DOWN, (24, 1)), 3)
    np.testing.assert_array_equal(rest[:24], flat.rest)
    np.testing.assert_allclose(rest[24:48, 2], -0.01)
    np.testing.assert_allclose(rest[48:, 2], -0.02)
    assert len(tetrahedra) == 3 * len(flat.faces) * 2
    parts = volumes(rest, tetrahedra)
    np.testing.assert_allclose(parts, 0.01**3 / 6, rtol=1e-9)
    assert parts.sum() == pytest.approx(0.03 * 0.05 * 0.02)
    # Sides of prisms fit: outside are both sheets, and two triangles a layer for each of the 16 edges around.
    assert len(outer_faces(tetrahedra)) == 2 * len(flat.faces) + 2 * 2 * 16


def test_order_and_winding_of_the_triangles_don_t_count():
    flat = sheet(4, 6, 0.01)
    faces = np.random.default_rng(0).permutation(np.roll(anticlockwise(flat), 1, axis=1))
    rest, tetrahedra = layered(flat.rest, faces, 0.02 * np.tile(DOWN, (24, 1)), 2)
    assert (volumes(rest, tetrahedra) > 0).all()
    assert len(outer_faces(tetrahedra)) == 2 * len(faces) + 2 * 16


def test_below_a_bend_there_is_less():
    """A part of a cylinder of radius 1: between it and one of 0.8 lies 0.9 times area and thickness."""
    flat = sheet(3, 40, 0.02)
    angle = flat.rest[:, 0]
    outward = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    upper = outward + flat.rest * (0, 1, 0)
    rest, tetrahedra = layered(upper, anticlockwise(flat), -0.2 * outward, 2)
    assert volumes(rest, tetrahedra).sum() == pytest.approx(0.9 * 0.04 * 0.78 * 0.2, rel=1e-3)
    assert len(layered(upper, anticlockwise(flat), -1.5 * outward, 7)[1]) == 0  # across the axis


def test_nothing_lies_below_a_step_that_leans_over():
    flat = sheet(3, 20, 0.01)
    upper, faces = flat.rest.copy(), anticlockwise(flat)
    upper[:, 0] -= np.where(upper[:, 0] > 0.095, 0.02, 0.0)  # column 10 comes to lie over column 9
    upper[:, 2] += np.where(flat.rest[:, 0] > 0.095, 0.03, 0.0)
    rest, tetrahedra = layered(upper, faces, 0.02 * np.tile(DOWN, (60, 1)), 3)
    assert len(tetrahedra) == 3 * 2 * (len(faces) - 4)
    assert volumes(rest, tetrahedra).sum() == pytest.approx(0.02 * 0.18 * 0.02)
