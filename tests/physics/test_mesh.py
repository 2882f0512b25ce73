"""Triangulation, rim, decimation and contact normal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from palpate.physics.mesh import contact_normal, grid_mesh, grid_springs, incidence, laplacian, nearest_vertex
from tests.physics.sheets import hand_mesh, surface


def plane(height: int, width: int, spacing: float = 0.01) -> np.ndarray:
    row, column = np.mgrid[:height, :width]
    return np.stack([column * spacing, row * spacing, np.full(row.shape, 0.5)], -1).astype(np.float32)


def test_full_grid_has_two_triangles_a_cell_and_unique_springs():
    mesh = grid_mesh(plane(4, 5), np.ones((4, 5), dtype=bool))
    assert len(mesh.vertices) == 20
    assert len(mesh.triangles) == 2 * 3 * 4
    assert len(mesh.springs) == 4 * 4 + 3 * 5 + 3 * 4  # right, down, diagonal
    assert len(np.unique(mesh.springs, axis=0)) == len(mesh.springs)
    assert (mesh.springs[:, 0] < mesh.springs[:, 1]).all()
    steps = {tuple(step) for step in mesh.pixels[mesh.springs[:, 1]] - mesh.pixels[mesh.springs[:, 0]]}
    assert steps == {(0, 1), (1, 0), (1, 1)}
    np.testing.assert_array_equal(mesh.vertices, plane(4, 5)[mesh.pixels[:, 0], mesh.pixels[:, 1]])
    assert mesh.vertices.dtype == np.float32
    assert mesh.springs.dtype == mesh.triangles.dtype == mesh.pixels.dtype == np.int32


def test_diagonals_alternate_where_that_is_asked_for():
    mesh = grid_mesh(plane(3, 4), np.ones((3, 4), dtype=bool), alternating=True)
    steps = np.diff(mesh.pixels[mesh.springs], axis=1)[:, 0]
    across = steps.prod(axis=1) != 0
    cells = mesh.pixels[mesh.springs[across]].min(axis=1)
    assert sorted(map(tuple, cells.tolist())) == [(row, column) for row in range(2) for column in range(3)]
    np.testing.assert_array_equal(steps[across].prod(axis=1), np.where(cells.sum(axis=1) % 2 == 1, -1, 1))
    first, second, third = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    areas = np.cross(second - first, third - first)[:, 2] / 2
    np.testing.assert_allclose(areas, areas[0])  # all are turned alike
    assert abs(areas.sum()) == pytest.approx(6 * 0.01**2)


def test_triangles_with_a_long_edge_are_dropped():
    points = plane(3, 6)
    points[:, 3:, 2] += 0.2  # a depth step between the columns 2 and 3
    mesh = grid_mesh(points, np.ones((3, 6), dtype=bool), max_edge=0.05)
    assert len(mesh.triangles) == 2 * 2 * 2 * 2
    lengths = np.linalg.norm(np.diff(mesh.vertices[mesh.springs], axis=1)[:, 0], axis=1)
    assert lengths.max() < 0.05
    sides = mesh.pixels[mesh.springs][..., 1] >= 3
    assert (sides[:, 0] == sides[:, 1]).all()


def test_rim_is_the_boundary_without_what_the_occluder_hides():
    valid = np.ones((12, 12), dtype=bool)
    mesh = grid_mesh(plane(12, 12), valid)
    border = (mesh.pixels == 0).any(axis=1) | (mesh.pixels == 11).any(axis=1)
    np.testing.assert_array_equal(mesh.rim, border)

    occluder = np.zeros_like(valid)
    occluder[:6, 5:7] = True
    hidden = grid_mesh(plane(12, 12), valid & ~occluder, occluder=occluder)
    held = {tuple(pixel) for pixel in hidden.pixels[hidden.rim]}
    assert (3, 4) not in held
    assert (3, 7) not in held
    assert (6, 5) not in held
    assert {(0, 0), (11, 5), (0, 1), (5, 11)} <= held

    hole = grid_mesh(plane(12, 12), valid & ~occluder)
    assert {(3, 4), (3, 7), (6, 5)} <= {tuple(pixel) for pixel in hole.pixels[hole.rim]}


def test_contact_normal_of_a_tilted_plane_faces_the_camera():
    row, column = np.mgrid[:7, :9]
    points = np.stack([column * 0.01, row * 0.01, 0.5 + 0.003 * column - 0.002 * row], -1)
    mesh = grid_mesh(points, np.ones((7, 9), dtype=bool))
    # z = 0.5 + 0.3 x − 0.2 y, so the normal towards smaller z is (0.3, −0.2, −1) / norm.
    expected = np.array([0.3, -0.2, -1.0]) / np.sqrt(1.13)
    for vertex in (0, 31, len(mesh.vertices) - 1):
        np.testing.assert_allclose(contact_normal(mesh, vertex), expected, atol=2e-5)


def test_contact_normal_weighs_faces_by_area():
    vertices = [[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 3]]
    mesh = hand_mesh(vertices, [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]], triangles=[[0, 1, 2], [0, 2, 3]])
    # Areas 0.5 with normal −z and 1 with normal ±x; the second face holds the line of sight (0,0,1) and so has no
    # front: its sign is the triangle's winding, +x here ((0,1,0)×(0,0,2) = (2,0,0)).
    expected = np.array([2.0, 0.0, -1.0]) / np.sqrt(5)
    np.testing.assert_allclose(contact_normal(mesh, 0), expected, atol=1e-12)


def test_contact_normal_without_area_looks_at_the_camera():
    lonely = hand_mesh([[0.3, 0.0, 0.4]], [])
    np.testing.assert_allclose(contact_normal(lonely, 0), [-0.6, 0.0, -0.8], atol=1e-7)
    origin = hand_mesh([[0.0, 0.0, 0.0]], [])
    np.testing.assert_array_equal(contact_normal(origin, 0), [0, 0, -1])


def test_decimation_keeps_about_the_asked_share():
    points, valid = surface(60, 80), np.ones((60, 80), dtype=bool)
    full, thin = grid_mesh(points, valid), grid_mesh(points, valid, keep=0.3)
    assert len(thin.vertices) / len(full.vertices) == pytest.approx(0.3, abs=0.02)
    # The subset still covers the grid: no pixel is far from a vertex.
    row, column = np.mgrid[:60, :80]
    distance = np.hypot(row[..., None] - thin.pixels[:, 0], column[..., None] - thin.pixels[:, 1]).min(axis=2)
    assert distance.max() < 3
    assert (thin.springs[:, 0] < thin.springs[:, 1]).all()


def test_decimation_bridges_no_hole():
    valid = np.ones((40, 40), dtype=bool)
    valid[10:30, 18:22] = False
    mesh = grid_mesh(surface(40, 40), valid, keep=0.3)
    middles = np.floor(mesh.pixels[mesh.springs].mean(axis=1) + 0.5).astype(int)
    corners = np.floor(mesh.pixels[mesh.triangles].mean(axis=1) + 0.5).astype(int)
    assert valid[middles[:, 0], middles[:, 1]].all()
    assert valid[corners[:, 0], corners[:, 1]].all()


@pytest.mark.parametrize("keep", [1.0, 0.3])
@pytest.mark.parametrize("pixels", [[], [(1, 1)], [(1, 1), (1, 2)]])
def test_too_few_pixels_give_an_empty_mesh(pixels, keep):
    valid = np.zeros((4, 5), dtype=bool)
    for pixel in pixels:
        valid[pixel] = True
    mesh = grid_mesh(plane(4, 5), valid, keep=keep)
    assert mesh.vertices.shape == (0, 3)
    assert mesh.springs.shape == (0, 2)
    assert mesh.triangles.shape == (0, 3)
    assert mesh.rim.shape == (0,)
    with pytest.raises(ValueError, match="no vertices"):
        nearest_vertex(mesh, np.zeros(3))


def test_three_pixels_give_one_triangle():
    valid = np.zeros((4, 5), dtype=bool)
    valid[1, 1] = valid[2, 1] = valid[2, 2] = True
    mesh = grid_mesh(plane(4, 5), valid)
    assert len(mesh.vertices) == len(mesh.springs) == 3
    assert mesh.rim.all()


def test_invalid_depth_is_left_out():
    points = plane(5, 5)
    points[2, 2] = np.nan
    mesh = grid_mesh(points, np.ones((5, 5), dtype=bool))
    assert len(mesh.vertices) == 24
    assert np.isfinite(mesh.vertices).all()


def test_nearest_vertex():
    mesh = grid_mesh(plane(5, 5), np.ones((5, 5), dtype=bool))
    assert nearest_vertex(mesh, mesh.vertices[13] + [0.001, -0.002, 0.0]) == 13


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match=r"\(4, 5, 2\)"):
        grid_mesh(np.zeros((4, 5, 2)), np.ones((4, 5), dtype=bool))
    with pytest.raises(ValueError, match="occluder"):
        grid_mesh(plane(4, 5), np.ones((4, 5), dtype=bool), occluder=np.zeros((2, 2), dtype=bool))


@settings(max_examples=60, deadline=None)
@given(
    valid=arrays.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))), keep=st.sampled_from([1.0, 0.5, 0.3])
)
def test_any_mask_gives_a_consistent_mesh(valid, keep):
    mesh = grid_mesh(plane(*valid.shape), valid, keep=keep)
    count = len(mesh.vertices)
    assert valid[mesh.pixels[:, 0], mesh.pixels[:, 1]].all()
    assert len(np.unique(mesh.pixels, axis=0)) == count
    assert set(np.unique(mesh.triangles)) == set(range(count))
    edges = {
        tuple(sorted(edge))
        for triangle in mesh.triangles.tolist()
        for edge in zip(triangle, np.roll(triangle, 1), strict=True)
    }
    assert edges == {tuple(spring) for spring in mesh.springs.tolist()}


def test_forces_of_springs_are_summed_and_their_stiffness_is_their_product_s():
    """Three nodes in a row and a fourth that nothing but its foundation holds."""
    springs, stiffness, anchor = np.array([[0, 1], [2, 1]]), np.array([2.0, 5.0]), np.array([0.5, 0.0, 0.25, 3.0])
    ends = incidence(springs, 4)
    np.testing.assert_array_equal(ends.toarray(), [[1, 0], [-1, -1], [0, 1], [0, 0]])
    found = laplacian(springs, stiffness, anchor).toarray()
    np.testing.assert_array_equal(found, [[2.5, -2, 0, 0], [-2, 7, -5, 0], [0, -5, 5.25, 0], [0, 0, 0, 3]])
    np.testing.assert_array_equal(found, (ends * stiffness) @ ends.T.toarray() + np.diag(anchor))


def test_springs_of_a_grid_join_nodes_so_many_rows_and_columns_apart():
    """Two rows of three nodes, 0 to 5."""
    assert grid_springs((2, 3), 0, 1).tolist() == [[0, 1], [1, 2], [3, 4], [4, 5]]
    assert grid_springs((2, 3), 1, 0).tolist() == [[0, 3], [1, 4], [2, 5]]
    assert grid_springs((2, 3), 1, 1).tolist() == [[0, 4], [1, 5]]
    assert grid_springs((2, 3), 1, -1).tolist() == [[1, 3], [2, 4]]
    assert grid_springs((2, 3), 0, 2).tolist() == [[0, 2], [3, 5]]
    assert grid_springs((2, 3), 2, 0).tolist() == []
