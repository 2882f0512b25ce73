"""The compiled rollout equals the plain one, on every mesh and over the whole admissible box."""

from __future__ import annotations

import itertools
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from physics import jit
from physics.load import Grip, Load, Press, ramped
from physics.mechanics import RECOMMENDED, Bounds, Mechanics
from physics.mesh import Mesh, grid_mesh
from physics.msd import grid_layout, reference
from physics.msd.compiled import Case, field_rollout, watched_rollout
from physics.msd.simulation import simulate, simulate_field, simulate_reaction, simulate_sensitivities
from tests.physics.sheets import gripped, hand_mesh, pressed, sheet, surface

pytestmark = pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")

HOLES = np.random.default_rng(0).random((14, 17)) > 0.15
NECK = np.ones((11, 15), dtype=bool)
NECK[:5, 7], NECK[7:, 7] = False, False


def shuffled(mesh: Mesh) -> Mesh:
    """The same mesh with its vertices in another order."""
    order = np.random.default_rng(1).permutation(len(mesh.vertices))
    rank = np.argsort(order).astype(np.int32)
    parts = (mesh.vertices[order], rank[mesh.triangles], rank[mesh.springs], mesh.rim[order], mesh.pixels[order])
    return Mesh(*parts, mesh.grid_shape)


MESHES = {
    "grid": sheet(9, 8),
    "decimated": sheet(12, 12, keep=0.5),
    "holes": grid_mesh(surface(14, 17), HOLES, max_edge=1.0),
    "shuffled": shuffled(grid_mesh(surface(14, 17), HOLES, max_edge=1.0)),
    "neck": grid_mesh(surface(11, 15), NECK, max_edge=1.0),
    "one": hand_mesh([[0, 0, 1]], []),
    "two": hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 1]], [False, True]),
    "three": hand_mesh([[0, 0, 1], [0.02, 0, 1], [0.01, 0.02, 1]], [[0, 1], [0, 2], [1, 2]]),
    "isolated": hand_mesh([[0, 0, 1], [0.02, 0, 1], [0.5, 0.02, 1]], [[0, 1]]),
}
MECHANICS = {
    "default": (Mechanics(), 200),
    "dkd": (Mechanics(scheme="dkd", anchor=0.3), 200),
    "free": (Mechanics(boundary="free"), 31),
    "explicit": (Mechanics(damping="explicit"), 200),
    "window": (Mechanics(window_error=1e-6), 200),
    "one step": (Mechanics(), 1),
    "two steps": (Mechanics(scheme="dkd"), 2),
}
"""Constants and the number of steps."""
DIRECTION = np.array([0.1, 0.2, -0.97])


def load_of(kind: str, mesh: Mesh, vertex: int, steps: int) -> Load:
    """A load about a vertex: on it, on a patch around it, or a grip of it and its neighbours in the mesh's order."""
    if kind == "patch":
        return Press.on_patch(mesh, vertex, 2.5, DIRECTION, ramped(5, 30, 10, steps))
    if kind == "grip":
        return gripped(
            mesh, np.unique(np.clip([vertex, vertex + 1, vertex - 2], 0, len(mesh.vertices) - 1)), 0.3, steps
        )
    return pressed(mesh, vertex, 50 if steps > 50 else 3, steps, DIRECTION)


@pytest.mark.parametrize(("mechanics", "steps"), MECHANICS.values(), ids=MECHANICS)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("kind", ["vertex", "patch", "grip"])
def test_compiled_equals_plain(kind, mesh, mechanics, steps):
    vertex = len(mesh.vertices) // 2
    load, watch = load_of(kind, mesh, vertex, steps), np.unique([vertex, 0, vertex // 2, len(mesh.vertices) - 1])
    case = Case(np.array([0.7, 0.05, -0.1]), mesh, load, mechanics, watch)
    plain = list(reference.steps(case.theta, mesh, load, mechanics, sensitive=True))
    field = np.stack([step.displacement for step in plain])
    jacobian = np.stack([np.moveaxis(step.moved[:, watch], 0, -1) for step in plain])
    peak = np.abs(field).max()
    seen = np.full_like(field, np.nan)
    field_rollout(case, seen)
    np.testing.assert_allclose(seen, field, atol=1e-13 * peak)
    allowed = 1e-13 if mechanics.window_error == 0 else mechanics.window_error
    np.testing.assert_allclose(watched_rollout(case, False).path, field[:, watch], atol=allowed * peak)
    found = watched_rollout(case, True)
    np.testing.assert_allclose(found.path, field[:, watch], atol=allowed * peak)
    np.testing.assert_allclose(found.slopes, jacobian, atol=10 * allowed * np.abs(jacobian).max())
    if kind == "grip":
        force, slopes = simulate_reaction(case.theta, mesh, load, mechanics, dtype=np.float64)
        elastic = np.stack([step.elastic[load.vertices] for step in plain])
        expected, by_damping = reference.reaction(elastic, load, 0.05, mechanics)
        np.testing.assert_allclose(force, expected, atol=1e-12 * np.abs(expected).max())
        moved = np.stack([np.moveaxis(step.elastic_moved[:, load.vertices], 0, -1) for step in plain])[..., :2]
        expected = np.stack([-moved[..., 0], by_damping - moved[..., 1]], -1)
        np.testing.assert_allclose(slopes, expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["vertex", "patch", "grip"])
def test_cone_equals_whole_mesh_to_round_off(kind):
    mesh, mechanics = sheet(50, 60), Mechanics()
    vertex = 25 * 60 + 30
    watch = vertex + np.array([0, 1, -3 * 60 + 2, 7 * 60 + 12])
    load = pressed(mesh, vertex, 20, 70, DIRECTION) if kind == "vertex" else load_of(kind, mesh, vertex, 70)
    for theta in ((1.0, 0.0, -0.5), (0.5, 0.1, -0.05)):
        whole = simulate_field(theta, mesh, load, mechanics, dtype=np.float64)[:, watch]
        for chosen in (watch[:1], watch):
            cone = simulate(theta, mesh, load, mechanics, watch=chosen, dtype=np.float64)
            np.testing.assert_allclose(cone, whole[:, : len(chosen)], atol=1e-15 * np.abs(whole).max() * 70)


@pytest.mark.slow
def test_every_row_length_gives_the_same(monkeypatch):
    mesh = sheet(30, 60)
    arguments = ((0.7, 0.05, -0.1), mesh, pressed(mesh, 15 * 60 + 30, 20, 60, DIRECTION), Mechanics())
    short = simulate_sensitivities(*arguments)
    monkeypatch.setattr(grid_layout, "PITCHES", (144,))
    for seen, expected in zip(simulate_sensitivities(*arguments), short, strict=True):
        np.testing.assert_array_equal(seen, expected)


def box_of(bounds: Bounds) -> st.SearchStrategy:
    return st.tuples(*(st.floats(low, high) for low, high in zip(bounds.lower, bounds.upper, strict=True)))


box = box_of(Bounds())


@settings(max_examples=20, deadline=None)
@given(theta=box.filter(lambda theta: theta[1] > 0.003), scheme=st.sampled_from(["euler", "dkd"]))
def test_window_error_is_kept(theta, scheme):
    mesh = sheet(64, 64)
    load = pressed(mesh, 32 * 64 + 32, 50, 200, DIRECTION)
    exact, window = (Mechanics(scheme=scheme, window_error=error) for error in (0.0, 1e-4))
    expected, expected_jacobian = simulate_sensitivities(theta, mesh, load, exact, dtype=np.float64)
    seen, jacobian = simulate_sensitivities(theta, mesh, load, window, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()
    scale = np.abs(expected_jacobian).max(axis=(0, 1))
    assert (np.abs(jacobian - expected_jacobian).max(axis=(0, 1)) <= 1e-2 * scale).all()


WIDE = sheet(64, 64)
THIN = sheet(64, 64, keep=0.5)


@settings(max_examples=30, deadline=None)
@given(
    theta=box_of(RECOMMENDED),
    scheme=st.sampled_from(["euler", "dkd"]),
    mesh=st.sampled_from([WIDE, THIN]),
    kind=st.sampled_from(["patch", "grip"]),
    radius=st.floats(0.5, 6.0),
    offsets=st.lists(st.tuples(st.integers(-30, 30), st.integers(-30, 30)), min_size=1, max_size=6),
)
def test_window_error_is_kept_for_wide_loads_and_many_watched_vertices(theta, scheme, mesh, kind, radius, offsets):
    """Of the largest displacement that is watched, near the load or far from it."""

    def at(offset):
        return int(np.argmin(np.abs(mesh.pixels - (np.array([32, 32]) + offset)).sum(axis=1)))

    load = Press.on_patch(mesh, at((0, 0)), radius, DIRECTION, ramped(10, 40, 10, 120))
    if kind == "grip":
        load = gripped(mesh, load.vertices, 0.4, 120)
    watch = np.array([at(offset) for offset in offsets])
    exact, window = (Mechanics(scheme=scheme, window_error=error) for error in (0.0, 1e-4))
    expected, expected_slopes = simulate_sensitivities(theta, mesh, load, exact, watch=watch, dtype=np.float64)
    seen, slopes = simulate_sensitivities(theta, mesh, load, window, watch=watch, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()
    scale = np.abs(expected_slopes).max(axis=(0, 1, 2))
    # Far from a grip on creeping tissue derivatives are as small as the rounding of the largest displacement.
    rounding = np.finfo(np.float64).eps * np.abs(expected).max() / np.abs(theta)
    assert (np.abs(slopes - expected_slopes).max(axis=(0, 1, 2)) <= 1e-2 * scale + rounding).all()


def test_a_window_that_ends_before_a_watched_vertex_is_not_used():
    """Both windows then say that it doesn't move at all, and agree."""
    mesh, theta = sheet(64, 64), (0.1, 0.4, -0.1)
    load = pressed(mesh, 32 * 64 + 32, 50, 120, DIRECTION)
    watch = np.array([32 * 64 + 62])
    expected = simulate(theta, mesh, load, Mechanics(), watch=watch, dtype=np.float64)
    assert np.abs(expected).max() > 0
    seen = simulate(theta, mesh, load, Mechanics(window_error=1e-4), watch=watch, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()


def test_a_window_that_fails_its_check_is_not_used():
    # Without damping, far beyond the box: chaotic, so that the smallest neglected part grows.
    mesh, theta = sheet(130, 130), (5.34, 0.0, -5.0)
    load = pressed(mesh, 65 * 130 + 65, 50, 200, DIRECTION)
    expected = simulate(theta, mesh, load, Mechanics(), dtype=np.float64)
    seen = simulate(theta, mesh, load, Mechanics(window_error=1e-4), dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()


@settings(max_examples=40, deadline=None)
@given(
    valid=arrays.arrays(bool, st.tuples(st.integers(2, 12), st.integers(2, 12)), fill=st.just(True)),
    keep=st.sampled_from([1.0, 0.5]),
    theta=box,
    mechanics=st.sampled_from(list(MECHANICS.values())[:3]),
    kind=st.sampled_from(["vertex", "patch", "grip"]),
    where=st.integers(0, 10**6),
)
def test_any_mask_and_any_theta_is_finite_and_silent(valid, keep, theta, mechanics, kind, where):
    mesh = grid_mesh(surface(*valid.shape), valid, max_edge=1.0, keep=keep)
    if len(mesh.vertices) == 0:
        return
    load = load_of(kind, mesh, where % len(mesh.vertices), mechanics[1])
    arguments = theta, mesh, load, mechanics[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = [*simulate_sensitivities(*arguments), simulate_field(*arguments)]
        if kind == "grip":
            found += simulate_reaction(*arguments)
    for values in found:
        assert np.isfinite(values).all()
        assert values.dtype == np.float32


def test_single_precision_follows_double():
    mesh, watch = sheet(20, 21), np.array([200, 205, 150])
    for kind in ("vertex", "patch", "grip"):
        load, theta = load_of(kind, mesh, 200, 200), (0.5, 0.08, -0.1)
        for mechanics in (Mechanics(), Mechanics(scheme="dkd")):
            double = simulate_sensitivities(theta, mesh, load, mechanics, watch=watch, dtype=np.float64)
            single = simulate_sensitivities(theta, mesh, load, mechanics, watch=watch)
            for seen, expected in zip(single, double, strict=True):
                np.testing.assert_allclose(seen, expected, atol=1e-4 * np.abs(expected).max())


def test_threads_share_nothing():
    """Cases of several kinds and sizes at once give what each gives alone."""
    meshes = [sheet(20, 21), sheet(30, 30), sheet(20, 20, keep=0.5)]
    jobs = [
        ((0.5, 0.05 + 0.01 * index, -0.1), mesh, load_of(kind, mesh, 90, 60), Mechanics(window_error=1e-4))
        for index, (mesh, kind) in enumerate(itertools.product(meshes, ("vertex", "patch", "grip")))
    ]
    alone = [simulate_sensitivities(*job) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        for seen, expected in zip(pool.map(lambda job: simulate_sensitivities(*job), jobs * 3), alone * 3, strict=True):
            np.testing.assert_array_equal(seen[0], expected[0])
            np.testing.assert_array_equal(seen[1], expected[1])


def test_indices_outside_the_mesh_are_refused():
    broken = hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 2]])
    with pytest.raises(ValueError, match="springs join vertices up to 2; the mesh has 2"):
        simulate((0.5, 0.1, -0.1), broken, Press.at(0, DIRECTION, np.ones(9)), Mechanics())
    with pytest.raises(ValueError, match="load names vertex -1"):
        simulate((0.5, 0.1, -0.1), MESHES["two"], Press.at(-1, DIRECTION, np.ones(9)), Mechanics())
    with pytest.raises(ValueError, match="load names vertex 2; the mesh has 2"):
        simulate((0.5, 0.1, -0.1), MESHES["two"], Grip(np.array([0, 2]), np.zeros((4, 2, 3))), Mechanics())
