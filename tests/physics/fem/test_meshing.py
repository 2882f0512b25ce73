"""Surfaces with holes, with inner walls and touching themselves: meshed without a bad element."""

import numpy as np
import pytest

from palpate.physics.fem import box
from palpate.physics.fem.meshing import WORST, Meshed, NoBody, around, mesh_surface
from palpate.physics.fem.solid import make_solid, outer_faces, qualities
from palpate.physics.fem.surface import areas, nearest


def globe(rows: int = 12, columns: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A unit sphere of latitudes and longitudes."""
    polar, turn = np.meshgrid(np.linspace(0, np.pi, rows + 1), 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    places = [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)]
    return np.stack(places, axis=-1).reshape(-1, 3), strip(rows, columns)


def strip(rows: int, columns: int, turned: bool = False) -> np.ndarray:
    """Triangles of a band of so many rows and columns that closes on itself, turned over if it says so."""
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    last = column == columns - 1

    def at(down: int, right: int) -> np.ndarray:
        here = np.where(last & bool(right) & turned, rows - (row + down), row + down)
        return (here * columns + (column + right) % columns).ravel()

    one = np.column_stack([at(0, 0), at(1, 0), at(0, 1)])
    return np.concatenate([one, np.column_stack([at(0, 1), at(1, 0), at(1, 1)])])


def volume(found: Meshed) -> float:
    """Volume of a mesh that stands all checks."""
    assert qualities(found.nodes, found.tetrahedra).min() >= WORST
    return float(make_solid(found.nodes, found.tetrahedra).volumes.sum())


def off(found: Meshed, vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Root mean square distance of the body's surface nodes from the triangles [m]."""
    corners = vertices[triangles]
    corners = corners[areas(corners) > 1e-12]
    nodes = found.nodes[np.unique(outer_faces(found.tetrahedra))]
    face, shares = nearest(nodes, corners, 8)
    places = np.einsum("pk,pkx->px", shares, corners[face])
    return float(np.sqrt(np.square(nodes - places).sum(axis=1).mean()))


SPHERE = 4 / 3 * np.pi


def block(lengths: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The surface of a block."""
    outer = make_solid(*box(lengths, (3, 3, 3)))
    used, which = np.unique(outer.faces, return_inverse=True)
    return outer.rest[used], which.reshape(-1, 3)


@pytest.mark.parametrize("lengths", [(1.0, 1.0, 1.0), (1.0, 0.73, 0.31), (0.4, 1.0, 0.15)])
def test_flat_faces_along_the_axes_lose_and_gain_nothing(lengths: tuple[float, float, float]) -> None:
    for cells in (3, 4):
        found = mesh_surface(*block(lengths), cells=cells)
        np.testing.assert_allclose(np.ptp(found.nodes, axis=0), lengths, rtol=1e-6)
        assert volume(found) == pytest.approx(np.prod(lengths), rel=1e-6)
        assert off(found, *block(lengths)) < 1e-6


def test_a_floor_cuts_the_body_at_its_height_whatever_the_cells() -> None:
    """Nodes lie on the plane, and what is above it is filled."""
    vertices, triangles = globe()
    for cells in (5, 6):
        found = mesh_surface(vertices, triangles, cells=cells, floor=(2, -0.37))
        assert found.nodes[:, 2].min() == pytest.approx(-0.37)
        on_it = np.isclose(found.nodes[:, 2], -0.37)
        assert np.linalg.norm(found.nodes[on_it, :2], axis=1).max() == pytest.approx(np.sqrt(1 - 0.37**2), rel=0.06)
        cap = np.pi * 0.63**2 * (3 - 0.63) / 3
        assert volume(found) == pytest.approx(SPHERE - cap, rel=0.08)
    whole, low = (mesh_surface(vertices, triangles, cells=5, floor=floor) for floor in (None, (2, -7.0)))
    np.testing.assert_array_equal(whole.nodes, low.nodes)
    with pytest.raises(NoBody, match="all of the surface lies below the floor"):
        mesh_surface(vertices, triangles, cells=5, floor=(2, 1.5))


@pytest.mark.slow
def test_a_sphere_is_filled_and_comes_closer_with_more_cells() -> None:
    coarse, fine = (mesh_surface(*globe(), cells=cells) for cells in (8, 16))
    assert volume(fine) == pytest.approx(SPHERE, rel=0.06)
    assert abs(volume(fine) - SPHERE) < abs(volume(coarse) - SPHERE)
    assert off(fine, *globe()) < off(coarse, *globe()) < 0.01


def test_new_nodes_of_divided_elements_are_drawn_to_the_surface_too() -> None:
    """The sphere's cap lies closer to its surface where the elements are shorter."""
    coarse = mesh_surface(*globe(), cells=6)
    fine = mesh_surface(*globe(), cells=6, longest=around(np.array([[0, 0, 1.0]]), 0.3, 0.15))
    assert qualities(fine.nodes, fine.tetrahedra).min() > 0.02
    assert off(fine, *globe()) < 1e-4

    def below(found: Meshed) -> float:
        solid = make_solid(found.nodes, found.tetrahedra)
        middle = solid.rest[solid.faces].mean(axis=1)
        return 1 - float(np.linalg.norm(middle[middle[:, 2] > 0.8], axis=1).mean())

    assert below(fine) < 0.5 * below(coarse)


@pytest.mark.parametrize("degrees", [20, 45])
def test_nodes_lie_on_tilted_faces_too(degrees: float) -> None:
    """Elements that would become flat there kept some half a millimetre off, of cells of 9 mm."""
    vertices, triangles = block((0.09, 0.09, 0.03))
    turn = np.radians(degrees)
    tilted = vertices @ np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]).T
    found = mesh_surface(tilted, triangles, cells=10, longest=lambda places: np.ones(len(places)))
    assert off(found, tilted, triangles) < 1e-7
    assert volume(found) == pytest.approx(0.09 * 0.09 * 0.03, rel=0.08)


def test_holes_and_faces_of_either_side_do_not_matter() -> None:
    vertices, triangles = globe()
    generator = np.random.default_rng(0)
    whole = volume(mesh_surface(vertices, triangles, cells=8))
    turned = triangles.copy()
    some = generator.random(len(turned)) < 0.5
    turned[some] = turned[some, ::-1]
    found = mesh_surface(vertices, turned, cells=8)
    assert volume(found) == pytest.approx(whole, rel=0.01)
    holed = mesh_surface(vertices, triangles[generator.random(len(triangles)) > 0.06], cells=8)
    assert volume(holed) == pytest.approx(whole, rel=0.1)


def test_an_inner_wall_and_edges_of_three_triangles() -> None:
    vertices, triangles = globe()
    rim = 6 * 24 + np.arange(24)  # the equator
    wall = np.column_stack([np.full(24, len(vertices)), rim, np.roll(rim, -1)])
    found = mesh_surface(np.vstack([vertices, [[0, 0, 0]]]), np.concatenate([triangles, wall]), cells=8)
    assert volume(found) == pytest.approx(SPHERE, rel=0.15)


def test_spheres_that_touch_and_what_hangs_apart() -> None:
    vertices, triangles = globe()
    both = np.concatenate([triangles, triangles + len(vertices)])
    near = mesh_surface(np.concatenate([vertices, vertices + np.array([2.0, 0, 0])]), both, cells=16)
    joined = round(volume(near) / SPHERE)  # a point holds no two bodies together
    assert joined in (1, 2)
    assert volume(near) == pytest.approx(joined * SPHERE, rel=0.15)
    far = mesh_surface(np.concatenate([vertices, 0.5 * vertices + np.array([3, 0, 0])]), both, cells=16)
    assert volume(far) == pytest.approx(SPHERE, rel=0.15)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"vertices": np.full((300, 3), np.nan)}, "no finite places"),
        ({"triangles": np.array([[0, 1, 999]])}, "name vertices 0 to 999"),
        ({"triangles": np.zeros((4, 3), int)}, "no triangle with an area"),
        ({"triangles": np.zeros((0, 3), int)}, "are none"),
    ],
)
def test_bad_inputs_get_a_sentence(changed: dict, said: str) -> None:
    vertices, triangles = globe()
    with pytest.raises(NoBody, match=said):
        mesh_surface(**({"vertices": vertices, "triangles": triangles} | changed))
