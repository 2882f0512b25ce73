"""What joins the particles of sheets and blocks, and bad input; volumes below sheets hold each part once."""

import dataclasses
import itertools

import numpy as np
import pytest

from palpate.physics.fem.solid import outer_faces
from palpate.physics.pbd.body import layered, make_body
from tests.physics.pbd.particles import block, sheet

DOWN = np.array([0.0, 0.0, -1.0])


def test_a_sheet_has_an_edge_once_and_a_shape_a_particle():
    body = sheet(4, 5)
    assert len(body.edges) == 4 * 4 + 3 * 5 + 3 * 4  # along, across, one diagonal a cell
    assert [kind.stop - kind.start for kind in body.kinds] == [len(body.edges), 0, 20]
    lengths = np.linalg.norm(body.rest[body.edges[:, 0]] - body.rest[body.edges[:, 1]], axis=1)
    np.testing.assert_allclose(body.layout.rest[body.kinds[0]], lengths, rtol=1e-14)
    assert set(np.round(lengths / 0.005, 6)) == {1.0, round(2**0.5, 6)}
    members = np.split(body.layout.members, body.layout.starts[1:-1])[body.kinds[2]]
    assert [shape[0] for shape in members] == list(range(20))
    for particle, shape in enumerate(members):
        near = body.edges[(body.edges == particle).any(axis=1)]
        assert set(shape) == set(near.ravel())
    np.testing.assert_array_equal(np.unique(body.faces), np.arange(20))


def test_a_block_keeps_the_volume_of_all_its_tetrahedra():
    body = block((2, 3, 2))
    assert body.layout.rest[body.kinds[1]].sum() == pytest.approx(12 * 0.005**3, rel=1e-12)
    assert len(body.tetrahedra) == 5 * 12
    inner = ((body.rest > 0) & (body.rest < np.array([2, 3, 2]) * 0.005)).all(axis=1)
    np.testing.assert_array_equal(np.unique(body.faces), np.flatnonzero(~inner))


def test_means_are_over_the_particles_of_a_constraint():
    body = block((1, 1, 1))
    field = np.random.default_rng(1).normal(size=body.count)
    starts, members = body.layout.starts, body.layout.members
    expected = [field[members[one:two]].mean() for one, two in itertools.pairwise(starts)]
    np.testing.assert_allclose(body.averages @ field, expected, rtol=1e-13)


def test_neighbours_on_a_line_form_no_shape():
    body = make_body(np.diag([1.0, 2.0, 3.0]) @ np.ones((3, 3)) * [1, 0, 0], np.array([[0, 1, 2]]))
    assert [kind.stop - kind.start for kind in body.kinds] == [3, 0, 0]


def test_what_is_pinned_or_gripped_has_no_inverse_mass():
    body = block((1, 1, 1))
    pinned = dataclasses.replace(body, pinned=np.arange(8) < 2)
    np.testing.assert_array_equal(pinned.inverse_mass(np.array([5])), [0, 0, 1, 1, 1, 0, 1, 1])
    np.testing.assert_array_equal(body.inverse_mass(np.array([], int)), np.ones(8))


@pytest.mark.parametrize(("changed", "sentence"), [
    ({"rest": np.zeros((3, 2))}, "rest has shape (3, 2)"),
    ({"rest": np.full((3, 3), np.nan)}, "give finite positions"),
    ({"rest": np.zeros((3, 3))}, "lie in one place"),
    ({"faces": np.array([[0, 1, 3]])}, "faces has shape"),
    ({"tetrahedra": np.array([[0, 1, 2]])}, "tetrahedra has shape"),
    ({"pinned": np.zeros(2, bool)}, "pinned has shape (2,)"),
])  # fmt: skip
def test_bad_input_is_said(changed, sentence):
    given = {"rest": np.eye(3), "faces": np.array([[0, 1, 2]])} | changed
    with pytest.raises(ValueError, match=sentence.replace("(", r"\(").replace(")", r"\)")):
        make_body(**given)


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
