"""The stencil read from a grid mesh."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.physics.mesh import grid_mesh
from palpate.physics.msd.grid_layout import LENGTH, LINK, MOBILE, PITCHES, REST_PLANES, grid_layout
from tests.physics.sheets import hand_mesh, sheet

FLOAT = np.dtype(np.float64)


def planes(layout) -> np.ndarray:
    return layout.rest.reshape(-1, REST_PLANES, layout.pitch)


def test_positions_lengths_links_and_free_vertices_are_where_they_belong():
    mesh = sheet(4, 5)
    free = ~mesh.rim
    layout = grid_layout(mesh, np.array([7]), 9, FLOAT)
    assert (planes(layout).shape[0], layout.centre, layout.corner) == (4 + 2, (2, 3), (-1, -1))
    row, column = mesh.pixels.T + 1
    rest = planes(layout)
    np.testing.assert_array_equal(rest[row, :3, column], mesh.vertices.astype(np.float64))
    np.testing.assert_array_equal(rest[row, MOBILE, column], free)
    assert rest[:, MOBILE].sum() == free.sum()
    assert rest[:, LINK].sum() == 4 * 4  # right
    assert rest[:, LINK + 1].sum() == 3 * 5  # down
    assert rest[:, LINK + 2].sum() == 3 * 4  # diagonal
    expected = np.linalg.norm(mesh.vertices[8].astype(np.float64) - mesh.vertices[7])
    np.testing.assert_allclose(rest[2, LENGTH, 3], expected, rtol=1e-12)
    np.testing.assert_array_equal(layout.first[1:5], [1] * 4)
    np.testing.assert_array_equal(layout.last[1:5], [5] * 4)
    assert layout.last[0] < layout.first[0]


def test_only_what_is_within_reach_is_laid_out():
    mesh = sheet(20, 30)
    vertex = 10 * 30 + 15
    layout = grid_layout(mesh, np.array([vertex]), 3, FLOAT)
    assert planes(layout).shape[0] == 7 + 2
    assert (planes(layout)[:, MOBILE] == 1).sum() == 9 * 9
    assert (planes(layout)[:, LENGTH] > 0).sum() == 9 * 9
    np.testing.assert_array_equal(layout.first[1:8], [1] * 7)
    np.testing.assert_array_equal(layout.last[1:8], [7] * 7)
    row, column = layout.centre
    np.testing.assert_array_equal(planes(layout)[row, :3, column], mesh.vertices[vertex].astype(np.float64))


def test_springs_may_be_stored_from_either_end():
    mesh = sheet(3, 3)
    turned = replace(mesh, springs=mesh.springs[:, ::-1])
    first, second = (grid_layout(each, np.array([4]), 5, FLOAT) for each in (mesh, turned))
    np.testing.assert_array_equal(first.rest, second.rest)


def test_a_window_of_the_kept_grid_is_that_of_a_fresh_one():
    """Loads far apart share a mesh: neither moves what the other holds."""
    mesh, float32 = sheet(20, 30), np.dtype(np.float32)
    for pressed, reach, dtype in (([0, 1], 9, FLOAT), ([315], 4, FLOAT), ([315], 4, float32), ([599, 569], 3, FLOAT)):
        kept, fresh = (grid_layout(each, np.array(pressed), reach, dtype) for each in (mesh, replace(mesh)))
        for values, others in zip(kept, fresh, strict=True):
            np.testing.assert_array_equal(values, others)
        row, column = (mesh.pixels[pressed] - kept.corner).T
        assert (planes(kept)[row, MOBILE, column] == 1).all()
        assert planes(kept).dtype == dtype
    assert set(mesh.grids) == {FLOAT, float32}


@pytest.mark.parametrize(
    "mesh",
    [
        hand_mesh(np.arange(12).reshape(4, 3), [[0, 2]]),
        hand_mesh(np.arange(12).reshape(4, 3), [[0, 1], [0, 3]]),
        replace(sheet(3, 3), springs=np.array([[1, 3]], np.int32)),
        replace(hand_mesh([[0, 0, 1], [0, 0, 2]], []), pixels=np.zeros((2, 2), np.int32), grid_shape=(1, 1)),
    ],
    ids=["two apart", "three apart", "the other diagonal", "two vertices on a pixel"],
)
def test_other_meshes_are_no_grid(mesh):
    assert grid_layout(mesh, np.array([0]), 5, FLOAT) is None


def test_a_window_too_wide_for_the_compiled_code_is_left_to_the_plain_version():
    width = PITCHES[-1]
    column = np.arange(width)
    points = np.stack([np.stack([column * 0.01, row + 0 * column, 0 * column + 0.5], -1) for row in (0.0, 0.01)])
    mesh = grid_mesh(points, np.ones((2, width), dtype=bool))
    middle = np.array([width // 2])
    assert grid_layout(mesh, middle, width, FLOAT) is None
    assert grid_layout(mesh, middle, 10, FLOAT).pitch == PITCHES[0]
