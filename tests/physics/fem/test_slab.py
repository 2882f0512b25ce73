"""A slab beneath a surface: where its nodes lie, what is held, how a force and a displacement are shared out."""

import numpy as np
import pytest

from palpate.physics.fem import NoBody
from palpate.physics.fem.slab import CELLS, slab_beneath
from palpate.physics.mesh import Mesh, grid_mesh

SIDE, FOCAL = 81, 100.0
PIXELS = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij"), axis=-1)
NORMAL = np.array([0.0, 0.0, -1.0])
THICKNESS = 0.06


def surface(depth: np.ndarray, seen: np.ndarray | None = None, occluder: np.ndarray | None = None) -> Mesh:
    rays = (PIXELS[..., ::-1] - SIDE / 2) / FOCAL
    points = np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1)
    return grid_mesh(points, np.ones((SIDE, SIDE), bool) if seen is None else seen, occluder=occluder)


def middle(mesh: Mesh) -> int:
    return int(np.flatnonzero((mesh.pixels == SIDE // 2).all(axis=1))[0])


def bowl(rows: np.ndarray = PIXELS[..., 0], columns: np.ndarray = PIXELS[..., 1]) -> np.ndarray:
    """Its depth at places of the picture."""
    down, across = rows - SIDE / 2, columns - SIDE / 2
    return 0.5 + 2e-5 * (down**2 + across * down)


def test_a_slab_lies_under_its_surface_with_the_contact_in_the_middle() -> None:
    mesh = surface(bowl())
    vertex = middle(mesh)
    slab = slab_beneath(mesh, vertex, NORMAL, THICKNESS, CELLS)
    rest, top = slab.solid.rest, slab.top
    np.testing.assert_allclose(rest[top[5, 5]], mesh.vertices[vertex], atol=1e-7)
    np.testing.assert_allclose(slab.focal_lengths, FOCAL, rtol=1e-5)
    columns = slab.columns[:, None]
    np.testing.assert_allclose(rest[top, 2], bowl(slab.rows, columns), atol=3e-5)
    np.testing.assert_allclose(rest[top, 0], (columns - SIDE / 2) / FOCAL * rest[top, 2], atol=1e-6)
    assert rest[:, 2].max() - rest[top, 2].max() == pytest.approx(THICKNESS, rel=1e-6)
    # Along the normal it is as thick everywhere, and filled once.
    area = np.diff(rest[top, 0], axis=0)[:, :-1] * np.diff(rest[top, 1], axis=1)[:-1]
    assert slab.solid.volumes.sum() == pytest.approx(THICKNESS * area.sum(), rel=0.01)
    held = slab.held.all(axis=1)
    assert held[top[[0, -1]]].all()
    assert held[top[:, [0, -1]]].all()
    assert not held[top[1:-1, 1:-1]].any()
    assert held.sum() == 11 * 11 + 3 * 40  # the bottom, and the sides above it


def test_what_lies_beyond_the_tissues_edge_is_held_and_what_a_tool_hides_is_not() -> None:
    seen = PIXELS[..., 1] < SIDE // 2 + 8
    edge = surface(bowl(), seen)
    slab = slab_beneath(edge, middle(edge), NORMAL, THICKNESS, CELLS)
    inner = slab.held.all(axis=1)[slab.top][1:-1, 1:-1]
    beyond = slab.columns[1:-1] > SIDE // 2 + 9
    assert beyond.any()
    np.testing.assert_array_equal(inner, np.broadcast_to(beyond[:, None], inner.shape))
    loose = slab_beneath(edge, middle(edge), NORMAL, THICKNESS, CELLS, attached=False)
    assert not loose.held[loose.top[1:-1, 1:-1]].any()
    np.testing.assert_array_equal(loose.held[loose.top[0]], slab.held[slab.top[0]])
    # Where tissue is visible, the surface is the mesh's.
    inside = loose.columns[:-1] < SIDE // 2 + 8
    expected = bowl(loose.rows, loose.columns[:-1][inside, None])
    np.testing.assert_allclose(loose.solid.rest[loose.top[:-1][inside], 2], expected, atol=3e-5)
    hidden = surface(bowl(), seen, occluder=~seen)
    slab = slab_beneath(hidden, middle(hidden), NORMAL, THICKNESS, CELLS)
    assert not slab.held.all(axis=1)[slab.top][1:-1, 1:-1].any()
    # Its surface goes on smoothly.
    np.testing.assert_allclose(slab.solid.rest[slab.top[-3], 2], bowl(slab.rows, slab.columns[-3]), atol=5e-4)


def test_a_force_is_shared_out_whole_and_without_a_moment() -> None:
    mesh = surface(np.full((SIDE, SIDE), 0.5))
    slab = slab_beneath(mesh, middle(mesh), NORMAL, THICKNESS, CELLS)
    shares = slab.patch(5.0)
    assert shares.sum() == pytest.approx(1)
    assert (shares >= 0).all()
    assert set(np.flatnonzero(shares)) <= set(slab.top.ravel())
    places = slab.solid.rest - mesh.vertices[middle(mesh)]
    np.testing.assert_allclose(shares @ places[:, :2], 0, atol=1e-9)
    # ∫ r² (1 - r²/R²) over the disc, over the force, is R²/3; tents of the nodes add to it, so it is more.
    spread = float(shares @ np.square(places[:, :2]).sum(axis=1)) / (0.5 / FOCAL) ** 2
    assert 25 / 3 < spread < 25


def test_places_between_nodes_move_as_linear_elements_do() -> None:
    mesh = surface(bowl())
    slab = slab_beneath(mesh, middle(mesh), NORMAL, THICKNESS, CELLS)
    pixels = np.array([[40.0, 40.0], [37.3, 45.1], [50.9, 33.2]])
    weights = slab.between(pixels)
    field = np.zeros(len(slab.solid.rest))
    field[slab.top] = 3 + 2 * slab.columns[:, None] - slab.rows
    np.testing.assert_allclose(weights @ field, 3 + 2 * pixels[:, 1] - pixels[:, 0])


def test_a_slab_that_is_no_body_is_refused_in_a_sentence() -> None:
    mesh = surface(bowl())
    for thickness in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(NoBody, match="give a positive one"):
            slab_beneath(mesh, middle(mesh), NORMAL, thickness, CELLS)
    with pytest.raises(NoBody, match=r"a slab of 0\.06 folds"):
        slab_beneath(mesh, middle(mesh), np.array([1.0, 0.0, 0.0]), THICKNESS, CELLS)


def test_quadratic_elements_have_nodes_between_corners_and_show_quadratic_motions_exactly() -> None:
    mesh = surface(bowl())
    corners = slab_beneath(mesh, middle(mesh), NORMAL, THICKNESS, (4, 6, 2))
    slab = slab_beneath(mesh, middle(mesh), NORMAL, THICKNESS, (4, 6, 2), order=2)
    rest, top = slab.solid.rest, slab.top
    assert top.shape == (9, 13)
    assert len(np.unique(top)) == top.size
    np.testing.assert_array_equal(top[::2, ::2], corners.top)
    np.testing.assert_array_equal(slab.columns[::2], corners.columns)
    np.testing.assert_allclose(slab.rows[1::2], (corners.rows[1:] + corners.rows[:-1]) / 2)
    np.testing.assert_allclose(rest[top[1::2, ::2]], (rest[top[:-1:2, ::2]] + rest[top[2::2, ::2]]) / 2)
    np.testing.assert_allclose(rest[top[4, 1::2]], (rest[top[4, :-1:2]] + rest[top[4, 2::2]]) / 2)
    held = slab.held.all(axis=1)
    assert held[top[[0, -1]]].all()
    assert held[top[:, [0, -1]]].all()
    assert not held[top[1:-1, 1:-1]].any()
    # A motion that is quadratic in columns and rows is told at every place as it is.
    places = np.random.default_rng(3).uniform([25, 25], [55, 55], (200, 2))
    at = np.zeros((len(rest), 2))
    at[top] = np.stack(np.meshgrid(slab.columns, slab.rows, indexing="ij"), axis=-1)

    def motion(across: np.ndarray, down: np.ndarray) -> np.ndarray:
        return 1 + 0.2 * across - 0.1 * down + 0.03 * across**2 - 0.02 * across * down + 0.01 * down**2

    found = slab.between(places) @ motion(*at.T)
    np.testing.assert_allclose(found, motion(places[:, 1], places[:, 0]), rtol=1e-9)
    # Its triangles are the faces of its elements: each shows a place by the six nodes of one of them.
    used = slab.between(places)
    faces = {frozenset(item) for item in slab.solid.faces.tolist()}
    for row in range(len(places)):
        nodes = set(used.indices[used.indptr[row] : used.indptr[row + 1]].tolist())
        assert frozenset(node for node in nodes if node < len(corners.solid.rest)) in faces


@pytest.mark.parametrize("order", [1, 2])
def test_a_force_lies_where_it_is_put(order: int) -> None:
    mesh = surface(bowl())
    slab = slab_beneath(mesh, middle(mesh), NORMAL, THICKNESS, (8, 8, 2), order=order)
    at = np.zeros((len(slab.solid.rest), 2))
    at[slab.top] = np.stack(np.meshgrid(slab.columns, slab.rows, indexing="ij"), axis=-1)
    np.testing.assert_allclose(slab.patch(6.0) @ at, slab.place, atol=1e-9)
    np.testing.assert_allclose(slab.patch(6.0, (41.3, 38.9)) @ at, (41.3, 38.9), atol=1e-9)
    assert slab.patch(6.0, (41.3, 38.9)).sum() == pytest.approx(1)
