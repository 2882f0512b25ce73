"""The compiled rollout equals the plain one, on every mesh and over the whole admissible box."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from sheets import hand_mesh, sheet, surface

from physics import grid_layout, jit, msd_numpy
from physics.mechanics import Bounds, Mechanics
from physics.mesh import Mesh, contact_normal, grid_mesh
from physics.msd_compiled import Case, contact_rollout, field_rollout
from physics.msd_kernel import load_profile, simulate, simulate_field, simulate_sensitivities

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
    "default": Mechanics(),
    "dkd": Mechanics(scheme="dkd", anchor=0.3),
    "free": Mechanics(boundary="free", steps=31, load_steps=3),
    "explicit": Mechanics(damping="explicit"),
    "window": Mechanics(window_error=1e-6),
    "one step": Mechanics(steps=1, load_steps=1),
}
DIRECTION = np.array([0.1, 0.2, -0.97])


def case_of(mesh, vertex, theta, mechanics, dtype=np.float64) -> Case:
    return Case(np.array(theta, dtype), mesh, vertex, DIRECTION, load_profile(mechanics), mechanics)


@pytest.mark.parametrize("mechanics", MECHANICS.values(), ids=MECHANICS)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_compiled_equals_plain(mesh, mechanics):
    vertex = len(mesh.vertices) // 2
    case = case_of(mesh, vertex, (0.7, 0.05, -0.1), mechanics)
    plain = (case.theta, mesh, vertex, DIRECTION, mechanics, case.load)
    field = np.stack(list(msd_numpy.steps(*plain)))
    trajectory, jacobian = msd_numpy.sensitivities(*plain)
    peak = np.abs(field).max()
    np.testing.assert_allclose(trajectory, field[:, vertex], atol=1e-14 * peak)
    seen = np.full_like(field, np.nan)
    field_rollout(case, seen)
    np.testing.assert_allclose(seen, field, atol=1e-13 * peak)
    allowed = 1e-13 if mechanics.window_error == 0 else mechanics.window_error
    np.testing.assert_allclose(contact_rollout(case, False)[0], trajectory, atol=allowed * peak)
    seen, seen_jacobian = contact_rollout(case, True)
    np.testing.assert_allclose(seen, trajectory, atol=allowed * peak)
    np.testing.assert_allclose(seen_jacobian, jacobian, atol=10 * allowed * np.abs(jacobian).max())


def test_cone_equals_whole_mesh_to_round_off():
    mesh, mechanics = sheet(50, 60), Mechanics(steps=70, load_steps=20)
    vertex = 25 * 60 + 30
    for theta in ((1.0, 0.0, -0.5), (0.5, 0.1, -0.05)):
        whole = simulate_field(theta, mesh, vertex, DIRECTION, mechanics, dtype=np.float64)[:, vertex]
        cone = simulate(theta, mesh, vertex, DIRECTION, mechanics, dtype=np.float64)
        np.testing.assert_allclose(cone, whole, atol=1e-15 * np.abs(whole).max() * 70)


def test_every_row_length_gives_the_same(monkeypatch):
    mesh = sheet(30, 60)
    mechanics = Mechanics(steps=60, load_steps=20)
    arguments = ((0.7, 0.05, -0.1), mesh, 15 * 60 + 30, DIRECTION, mechanics)
    short = simulate_sensitivities(*arguments)
    monkeypatch.setattr(grid_layout, "PITCHES", (144,))
    for seen, expected in zip(simulate_sensitivities(*arguments), short, strict=True):
        np.testing.assert_array_equal(seen, expected)


box = st.tuples(*(st.floats(low, high) for low, high in zip(Bounds().lower, Bounds().upper, strict=True)))


@settings(max_examples=20, deadline=None)
@given(theta=box.filter(lambda theta: theta[1] > 0.003), scheme=st.sampled_from(["euler", "dkd"]))
def test_window_error_is_kept(theta, scheme):
    mesh = sheet(64, 64)
    vertex = 32 * 64 + 32
    exact, window = (Mechanics(scheme=scheme, window_error=error) for error in (0.0, 1e-4))
    expected, expected_jacobian = simulate_sensitivities(theta, mesh, vertex, DIRECTION, exact, dtype=np.float64)
    seen, jacobian = simulate_sensitivities(theta, mesh, vertex, DIRECTION, window, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()
    scale = np.abs(expected_jacobian).max(axis=(0, 1))
    assert (np.abs(jacobian - expected_jacobian).max(axis=(0, 1)) <= 1e-2 * scale).all()


def test_a_window_that_fails_its_check_is_not_used():
    # Without damping, far beyond the box: chaotic, so that the smallest neglected part grows.
    mesh, vertex, theta = sheet(130, 130), 65 * 130 + 65, (5.34, 0.0, -5.0)
    expected = simulate(theta, mesh, vertex, DIRECTION, Mechanics(), dtype=np.float64)
    seen = simulate(theta, mesh, vertex, DIRECTION, Mechanics(window_error=1e-4), dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()


@settings(max_examples=40, deadline=None)
@given(
    valid=arrays.arrays(bool, st.tuples(st.integers(2, 12), st.integers(2, 12)), fill=st.just(True)),
    keep=st.sampled_from([1.0, 0.5]),
    theta=box,
    mechanics=st.sampled_from(list(MECHANICS.values())[:3]),
    where=st.integers(0, 10**6),
)
def test_any_mask_and_any_theta_is_finite_and_silent(valid, keep, theta, mechanics, where):
    mesh = grid_mesh(surface(*valid.shape), valid, max_edge=1.0, keep=keep)
    if len(mesh.vertices) == 0:
        return
    vertex = where % len(mesh.vertices)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arguments = (theta, mesh, vertex, contact_normal(mesh, vertex), mechanics)
        trajectory, jacobian = simulate_sensitivities(*arguments)
        field = simulate_field(*arguments)
    assert np.isfinite(trajectory).all()
    assert np.isfinite(jacobian).all()
    assert np.isfinite(field).all()
    assert trajectory.dtype == jacobian.dtype == field.dtype == np.float32


def test_indices_outside_the_mesh_are_refused():
    broken = hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 2]])
    with pytest.raises(ValueError, match="springs join vertices up to 2; the mesh has 2"):
        simulate((0.5, 0.1, -0.1), broken, 0, DIRECTION, Mechanics())
    with pytest.raises(ValueError, match="vertex is -1"):
        simulate((0.5, 0.1, -0.1), MESHES["two"], -1, DIRECTION, Mechanics())
