"""Forward simulation against closed forms, an adaptive integrator and conservation laws; compiled against plain."""

import dataclasses
import itertools
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.integrate import solve_ivp

from palpate.physics.load import Grip, Load, Press, held, ramped
from palpate.physics.mechanics import RECOMMENDED, Bounds, Mechanics
from palpate.physics.mesh import Mesh, contact_normal, grid_mesh, nearest_vertex
from palpate.physics.msd import grid_layout, reference
from palpate.physics.msd.simulation import Case, simulate, simulate_sensitivities, watched_rollout
from tests.physics import sheets

Z = np.array([0.0, 0.0, 1.0])


def press_on(mesh, vertex, direction, mechanics) -> Press:
    """A press on one vertex over the steps that the mechanics name."""
    return sheets.pressed(mesh, vertex, mechanics.load_steps, mechanics.steps, direction)


def solve(mesh, load, theta, mechanics, course, corners) -> np.ndarray:
    """Displacement [T, N, 3] by an adaptive eighth-order method, restarted at the corners of the load's course.

    Args:
        course: factor of a press at a time, or displacement of a grip's vertices [G, 3].
        corners: times at which it is not smooth, the first 0 and the last at the end or later.
    """
    stiffness, damping, force = theta
    held = mesh.rim.copy()
    held[load.vertices] = isinstance(load, Grip)
    count = len(mesh.vertices)

    def place(displacement, time):
        if isinstance(load, Grip):
            displacement = displacement.copy()
            displacement[load.vertices] = course(time)
        return displacement

    def derivative(time, state):
        displacement, velocity = state.reshape(2, count, 3)
        total = sheets.position_form_force(place(displacement, time), mesh, stiffness) - damping * velocity
        if isinstance(load, Press):
            total[load.vertices] += course(time) * force * np.outer(load.weights, load.direction)
        total[held] = 0
        return np.concatenate([velocity.ravel(), total.ravel() / mechanics.mass])

    times, state, found = mechanics.times, np.zeros(6 * count), []
    for start, end in itertools.pairwise(corners):
        inside = np.minimum(times[(times > start + 1e-12) & (times <= end + 1e-12)], end)
        at = np.append(inside[inside < end - 1e-12], end)
        path = solve_ivp(derivative, (start, end), state, t_eval=at, method="DOP853", rtol=1e-9, atol=1e-12).y
        state = path[:, -1]
        found += [place(row.reshape(2, count, 3)[0], time) for row, time in zip(path.T, inside, strict=False)]
    return np.stack(found)


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.5])
def test_single_mass_follows_the_discrete_closed_form(damping):
    # v_n = kF Σ a^j with a = 1/(1+c), k = Δt/m·a, c = Δt·k_d/m; then v decays as aⁿ.
    mechanics = Mechanics(steps=60, load_steps=25)
    a = 1 / (1 + mechanics.time_step * damping / mechanics.mass)
    velocity, position, expected = 0.0, 0.0, []
    for step in range(60):
        velocity = a * (velocity + mechanics.time_step / mechanics.mass * (-0.3 if step < 25 else 0.0))
        position += mechanics.time_step * velocity
        expected.append(position)
    mesh = sheets.hand_mesh([[0, 0, 1]], [])
    seen = simulate([0.5, damping, -0.3], mesh, press_on(mesh, 0, Z, mechanics), mechanics, dtype=np.float64)
    np.testing.assert_allclose(seen[:, 2], expected, rtol=1e-12)
    assert not seen[:, :2].any()


REFINEMENTS = [1, 2, 4, 8]


def convergence(mesh, theta, load_of, mechanics_of, exact) -> tuple[float, float]:
    """Measured order, and the error at the largest step relative to the peak."""
    errors = []
    for factor in REFINEMENTS:
        mechanics = mechanics_of(factor)
        seen = sheets.whole_field(theta, mesh, load_of(factor, mechanics), mechanics, dtype=np.float64)
        errors.append(np.abs(seen[factor - 1 :: factor] - exact).max() / np.abs(exact).max())
    return -np.polyfit(np.log(REFINEMENTS), np.log(errors), 1)[0], errors[0]


@pytest.mark.parametrize("kind", ["vertex", "patch", "grip"])
def test_order_of_convergence_on_a_sheet(kind):
    mesh, theta = sheets.sheet(9, 9), (0.6, 0.02, -0.02)
    corners, shares = ([0, 0.04, 0.1], None) if kind == "vertex" else ([0, 0.02, 0.05, 0.08, 0.1], [0, 1, 1, 0, 0])

    def load_of(factor, mechanics):
        if kind == "vertex":
            return sheets.pressed(mesh, 40, 20 * factor, 50 * factor)
        if kind == "patch":
            times = ramped(10 * factor, 15 * factor, 15 * factor, 50 * factor)
            return Press.on_patch(mesh, 40, 2.5, contact_normal(mesh, 40), times)
        return sheets.gripped(mesh, [38, 39, 48], 0.08, 50 * factor, mechanics.time_step)

    coarse = Mechanics(time_step=0.002, steps=50, load_steps=0)
    load = load_of(1, coarse)

    def course(time):
        if kind == "grip":
            return sheets.smooth_path(time, 0.08) * load.displacement[-1]
        return float(time < 0.04) if kind == "vertex" else np.interp(time, corners, shares)

    exact = solve(mesh, load, theta, coarse, course, corners)
    for scheme, order in (("euler", 1), ("dkd", 2)):

        def mechanics_of(factor, scheme=scheme):
            return Mechanics(time_step=0.002 / factor, steps=50 * factor, scheme=scheme)

        slope, first = convergence(mesh, theta, load_of, mechanics_of, exact)
        assert slope == pytest.approx(order, abs=0.15), scheme
        assert first < (0.1 if order == 1 else 0.02)


def test_held_vertices_stay_and_the_contact_vertex_moves_even_on_the_rim():
    mesh = sheets.sheet(6, 7)
    corner = 0
    assert mesh.rim[corner]
    load = sheets.pressed(mesh, corner, 10, 30, Z)
    field = sheets.whole_field([0.5, 0.1, -0.1], mesh, load, Mechanics())
    kept = mesh.rim.copy()
    kept[corner] = False
    assert not field[:, kept].any()
    assert np.abs(field[:, corner]).max() > 0
    free = sheets.whole_field([0.5, 0.1, -0.1], sheets.loose(mesh), load, Mechanics())
    assert np.abs(free[-1, kept]).max() > 0


def test_momentum_of_a_free_undamped_mesh_is_the_impulse():
    mesh, mechanics = sheets.loose(sheets.sheet(7, 8)), Mechanics(load_steps=50)
    direction = contact_normal(mesh, 20)
    load = press_on(mesh, 20, direction, mechanics)
    field = sheets.whole_field([0.8, 0.0, -0.05], mesh, load, mechanics, dtype=np.float64)
    velocity = np.diff(field, axis=0, prepend=0) / mechanics.time_step
    momentum = mechanics.mass * velocity.sum(axis=1)
    loaded = np.minimum(np.arange(1, 201), 50)[:, None] * mechanics.time_step
    np.testing.assert_allclose(momentum, -0.05 * loaded * direction, atol=1e-14)


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
def test_energy_without_load(scheme):
    def relative_error(refinement, damping):
        mesh = sheets.sheet(7, 8)
        mechanics = Mechanics(0.001, 1e-3 / refinement, 1000 * refinement, 20 * refinement, scheme)
        theta = (0.8, damping, -0.02)
        load = press_on(mesh, 27, contact_normal(mesh, 27), mechanics)
        field = sheets.whole_field(theta, mesh, load, mechanics, dtype=np.float64)
        # Velocity at the steps by central differences, second order for both schemes.
        speed = (field[2:] - field[:-2]) / (2 * mechanics.time_step)
        values = [sheets.energy(u, v, mesh, 0.8, mechanics.mass) for u, v in zip(field[1:-1], speed, strict=True)]
        return np.array(values[20 * refinement :])

    coarse, fine = relative_error(1, 0.0), relative_error(2, 0.0)
    bounds = [np.abs(values / values.mean() - 1).max() for values in (coarse, fine)]
    assert bounds[0] < 0.1
    assert bounds[1] < 0.35 * bounds[0]  # O(Δt²): a quarter
    drift = np.abs(coarse[: len(coarse) // 2].mean() / coarse[len(coarse) // 2 :].mean() - 1)
    assert drift < 0.1 * bounds[0]
    damped = relative_error(1, 0.02)
    assert (np.diff(damped) <= 1e-3 * damped[0]).all()
    assert damped[-1] < 0.01 * damped[0]


def test_strong_damping_never_diverges():
    """Three times what explicit damping would bear, 2m/Δt."""
    mesh = sheets.sheet(6, 6)
    load = sheets.pressed(mesh, 14, 50, 200, Z)
    assert np.abs(simulate([0.5, 1.2, -0.1], mesh, load, Mechanics(), dtype=np.float64)).max() < 1


def test_the_motion_follows_the_load_s_course():
    mesh, theta = sheets.sheet(6, 6), [0.5, 0.05, -0.1]
    quarter = simulate(theta, mesh, sheets.pressed(mesh, 14, 10, 40, Z), Mechanics())
    halved = simulate([0.5, 0.05, -0.2], mesh, Press.at(14, Z, 0.5 * held(10, 40)), Mechanics())
    np.testing.assert_allclose(halved, quarter, rtol=1e-5, atol=1e-9)
    earlier = simulate(theta, mesh, sheets.pressed(mesh, 14, 10, 40, Z).until(25), Mechanics())
    np.testing.assert_array_equal(earlier, quarter[:25])
    assert not simulate(theta, mesh, sheets.pressed(mesh, 14, 0, 40, Z), Mechanics()).any()


def test_bad_input_is_named():
    mesh, mechanics = sheets.sheet(5, 5), Mechanics()
    load, theta = sheets.pressed(mesh, 3, 5, 10, Z), [0.5, 0.1, 1.0]
    for arguments, said in (
        (([0.5, 0.1], mesh, load, mechanics), "three finite numbers k_s, k_d and F"),
        (([0.5, np.nan, 1.0], mesh, load, mechanics), "three finite"),
        (([-0.5, 0.1, 1.0], mesh, load, mechanics), "neither may be negative"),
        ((theta, mesh, sheets.pressed(mesh, 25, 5, 10, Z), mechanics), "load names vertex 25; the mesh has 25"),
        ((theta, mesh, Grip(np.array([3, -1]), np.zeros((4, 2, 3))), mechanics), "load names vertex -1"),
        ((theta, dataclasses.replace(mesh, springs=np.array([[0, 25]])), load, mechanics), "springs .* up to 25;"),
    ):
        with pytest.raises(ValueError, match=said):
            simulate(*arguments)
    for watch, said in (
        (np.array([3, 25]), "watch names vertex 25"),
        (np.array([[3]]), r"watch has shape \(1, 1\)"),
        (np.array([0.5]), "type float64"),
        (np.array([], np.int64), r"watch has shape \(0,\)"),
    ):
        with pytest.raises(ValueError, match=said):
            simulate(theta, mesh, load, mechanics, watch=watch)


def flat_sheet(height: int = 8, width: int = 9):
    """A regular flat sheet; every inner vertex has six springs, opposite ones alike."""
    row, column = np.mgrid[:height, :width]
    points = np.stack([column, row, 0 * row + 64], -1).astype(np.float32) / 128  # exact in single precision
    return grid_mesh(points, np.ones((height, width), dtype=bool))


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
@pytest.mark.parametrize("mesh", [flat_sheet(), sheets.loose(flat_sheet())], ids=["fixed", "free"])
def test_an_affine_grip_of_the_rim_moves_the_inside_affinely(mesh, scheme):
    """Stretched, sheared and tilted: opposite springs of an inner vertex then pull alike, whatever the strain."""
    mechanics = Mechanics(scheme=scheme)
    affine = np.array([[0.2, 0.03, 0.0], [-0.02, 0.15, 0.0], [0.1, -0.05, 0.0]])
    goal = mesh.vertices.astype(np.float64) @ affine.T
    rim = np.flatnonzero(flat_sheet().rim)
    way = sheets.smooth_path(mechanics.time_step * np.arange(1, 1201), 0.2)
    grip = Grip(rim, way[:, None, None] * goal[rim])
    theta = (0.8, 0.02, 0.0)
    field = sheets.whole_field(theta, mesh, grip, mechanics, dtype=np.float64)
    size = np.abs(goal).max()
    assert np.abs(field[30] - way[30] * goal).max() > 0.1 * size  # on the way it is not affine
    np.testing.assert_allclose(field[-1], goal, atol=1e-12 * size)


@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("dkd", 2)])
def test_work_becomes_energy_and_heat(scheme, order):
    """Work of the load = elastic and kinetic energy + ∫ k_d·v², up to an error that falls with the scheme's order."""
    mesh, stiffness, damping, errors = sheets.loose(sheets.sheet(8, 8)), 0.8, 0.02, []
    refinements = [1, 2, 4, 8]
    for factor in refinements:
        steps, step = 60 * factor, 0.002 / factor
        mechanics = Mechanics(time_step=step, scheme=scheme)
        theta = (stiffness, damping, -0.05)
        course = ramped(15 * factor, 30 * factor, 10 * factor, steps)
        load = Press.on_patch(mesh, 27, 2.5, contact_normal(mesh, 27), course)
        force = -0.05 * course[:, None, None] * np.outer(load.weights, load.direction)
        field = np.concatenate(
            [np.zeros((1, 64, 3)), sheets.whole_field(theta, mesh, load, mechanics, dtype=np.float64)]
        )
        moved = np.diff(field, axis=0)
        work = (force * moved[:, load.vertices]).sum()
        heat = damping * np.square(moved).sum() / step
        speed = (3 * field[-1] - 4 * field[-2] + field[-3]) / (2 * step)
        stored = sheets.energy(field[-1], speed, mesh, stiffness, mechanics.mass)
        assert min(heat, stored) > 0.1 * work
        errors.append(abs(work - stored - heat) / work)
    slope = -np.polyfit(np.log(refinements), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.2), errors
    assert errors[-1] < (0.02 if order == 1 else 5e-4), errors


ISLANDS = np.ones((8, 13), dtype=bool)
ISLANDS[:, 8:10] = False
"""Two sheets in one mesh, of 8 and of 3 columns."""


@pytest.mark.parametrize("keep", [1.0, 0.5])
@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd")], ids=["euler", "dkd"])
@pytest.mark.parametrize("kind", ["vertex", "patch", "grip"])
def test_derivatives_equal_differences_wherever_one_looks(kind, mechanics, keep):
    """Watched: in the load, beside it, further off, on the held rim, and on an island that nothing connects with it."""
    mesh = grid_mesh(sheets.surface(8, 13), ISLANDS, max_edge=1.0, keep=keep)
    middle = nearest_vertex(mesh, mesh.vertices[mesh.pixels[:, 1] < 8].mean(axis=0))
    beside = np.argsort(np.linalg.norm(mesh.pixels - mesh.pixels[middle], axis=1))
    loads = {
        "vertex": sheets.pressed(mesh, middle, 15, 60),
        "patch": Press.on_patch(mesh, middle, 2.2, contact_normal(mesh, middle), ramped(10, 20, 10, 60)),
        "grip": sheets.gripped(mesh, beside[[0, 1, 3]], 0.2, 60),
    }
    load, theta = loads[kind], np.array([0.6, 0.04, -0.1])
    rim = np.flatnonzero(mesh.rim & (mesh.pixels[:, 1] < 7))[0]
    island = np.flatnonzero(mesh.pixels[:, 1] > 9)[0]
    watch = np.array([*beside[[0, 1, 2, 4, 5]], rim, island])

    def motion(values):
        return simulate(values, mesh, load, mechanics, watch=watch, dtype=np.float64)

    path, slopes = simulate_sensitivities(theta, mesh, load, mechanics, watch=watch, dtype=np.float64)
    field = sheets.whole_field(theta, mesh, load, mechanics, dtype=np.float64)
    np.testing.assert_allclose(path, field[:, watch], atol=1e-14 * np.abs(field).max())
    np.testing.assert_allclose(motion(theta), path, atol=1e-14 * np.abs(path).max())
    assert not path[:, -2:].any()
    assert path[-1, :5].any(axis=1).all()
    for parameter in range(2 if kind == "grip" else 3):
        offset = 1e-6 * abs(theta[parameter]) * np.eye(3)[parameter]
        central = (motion(theta + offset) - motion(theta - offset)) / (2 * offset[parameter])
        scale = np.abs(central).max()
        assert scale > 0
        np.testing.assert_allclose(slopes[..., parameter], central, atol=1e-6 * scale)
    if kind == "grip":
        assert not slopes[..., 2].any()
        assert not slopes[:, np.isin(watch, load.vertices)].any()
        steps = np.searchsorted(load.vertices, watch[:2], sorter=np.argsort(load.vertices))
        held_at = load.displacement[:, np.argsort(load.vertices)[steps]]
        np.testing.assert_array_equal(path[:, :2], held_at)


HOLES = np.random.default_rng(0).random((14, 17)) > 0.15
NECK = np.ones((11, 15), dtype=bool)
NECK[:5, 7], NECK[7:, 7] = False, False


def shuffled(mesh: Mesh) -> Mesh:
    """Mesh with its vertices in another order."""
    order = np.random.default_rng(1).permutation(len(mesh.vertices))
    rank = np.argsort(order).astype(np.int32)
    parts = (mesh.vertices[order], rank[mesh.triangles], rank[mesh.springs], mesh.rim[order], mesh.pixels[order])
    return Mesh(*parts, mesh.grid_shape)


MESHES = {
    "grid": sheets.sheet(9, 8),
    "holes": grid_mesh(sheets.surface(14, 17), HOLES, max_edge=1.0),
    "shuffled": shuffled(grid_mesh(sheets.surface(14, 17), HOLES, max_edge=1.0)),
    "free": sheets.loose(sheets.sheet(9, 8)),
    "neck": grid_mesh(sheets.surface(11, 15), NECK, max_edge=1.0),
    "one": sheets.hand_mesh([[0, 0, 1]], []),
    "two": sheets.hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 1]], [False, True]),
    "isolated": sheets.hand_mesh([[0, 0, 1], [0.02, 0, 1], [0.5, 0.02, 1]], [[0, 1]]),
}
MECHANICS = {
    "default": (Mechanics(), 200),
    "dkd": (Mechanics(scheme="dkd"), 200),
    "short": (Mechanics(), 31),
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
        return sheets.gripped(
            mesh, np.unique(np.clip([vertex, vertex + 1, vertex - 2], 0, len(mesh.vertices) - 1)), 0.3, steps
        )
    return sheets.pressed(mesh, vertex, 50 if steps > 50 else 3, steps, DIRECTION)


@pytest.mark.parametrize(("mechanics", "steps"), MECHANICS.values(), ids=MECHANICS)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("kind", ["vertex", "patch"])
def test_compiled_equals_plain(kind, mesh, mechanics, steps):
    vertex = len(mesh.vertices) // 2
    load, watch = load_of(kind, mesh, vertex, steps), np.unique([vertex, 0, vertex // 2, len(mesh.vertices) - 1])
    case = Case(np.array([0.7, 0.05, -0.1]), mesh, load, mechanics, watch)
    plain = list(reference.steps(case.theta, mesh, load, mechanics, sensitive=True))
    field = np.stack([displacement for displacement, _ in plain])
    jacobian = np.stack([np.moveaxis(moved[:, watch], 0, -1) for _, moved in plain])
    peak = np.abs(field).max()
    whole = case._replace(watch=np.arange(len(mesh.vertices)), mechanics=dataclasses.replace(mechanics, window_error=0))
    np.testing.assert_allclose(watched_rollout(whole, False)[0], field, atol=1e-13 * peak)
    allowed = 1e-13 if mechanics.window_error == 0 else mechanics.window_error
    np.testing.assert_allclose(watched_rollout(case, False)[0], field[:, watch], atol=allowed * peak)
    path, slopes = watched_rollout(case, True)
    np.testing.assert_allclose(path, field[:, watch], atol=allowed * peak)
    np.testing.assert_allclose(slopes, jacobian, atol=10 * allowed * np.abs(jacobian).max())


@pytest.mark.parametrize("kind", ["vertex", "patch"])
def test_cone_equals_whole_mesh_to_round_off(kind):
    mesh, mechanics = sheets.sheet(50, 60), Mechanics()
    vertex = 25 * 60 + 30
    watch = vertex + np.array([0, 1, -3 * 60 + 2, 7 * 60 + 12])
    load = sheets.pressed(mesh, vertex, 20, 70, DIRECTION) if kind == "vertex" else load_of(kind, mesh, vertex, 70)
    for theta in ((1.0, 0.0, -0.5), (0.5, 0.1, -0.05)):
        whole = sheets.whole_field(theta, mesh, load, mechanics, dtype=np.float64)[:, watch]
        for chosen in (watch[:1], watch):
            cone = simulate(theta, mesh, load, mechanics, watch=chosen, dtype=np.float64)
            np.testing.assert_allclose(cone, whole[:, : len(chosen)], atol=1e-15 * np.abs(whole).max() * 70)


@pytest.mark.slow
def test_every_row_length_gives_the_same(monkeypatch):
    mesh = sheets.sheet(30, 60)
    arguments = ((0.7, 0.05, -0.1), mesh, sheets.pressed(mesh, 15 * 60 + 30, 20, 60, DIRECTION), Mechanics())
    short = simulate_sensitivities(*arguments)
    monkeypatch.setattr(grid_layout, "PITCHES", (144,))
    for seen, expected in zip(simulate_sensitivities(*arguments), short, strict=True):
        np.testing.assert_array_equal(seen, expected)


def box_of(bounds: Bounds) -> st.SearchStrategy:
    return st.tuples(*(st.floats(low, high) for low, high in zip(bounds.lower, bounds.upper, strict=True)))


box = box_of(Bounds())


@settings(max_examples=20, deadline=None)
@given(theta=box, scheme=st.sampled_from(["euler", "dkd"]))
@example(theta=(0.83, 0.0, -0.78), scheme="dkd")
def test_window_error_is_kept(theta, scheme):
    mesh = sheets.sheet(64, 64)
    load = sheets.pressed(mesh, 32 * 64 + 32, 50, 200, DIRECTION)
    exact, window = (Mechanics(scheme=scheme, window_error=error) for error in (0.0, 1e-4))
    expected, expected_jacobian = simulate_sensitivities(theta, mesh, load, exact, dtype=np.float64)
    seen, jacobian = simulate_sensitivities(theta, mesh, load, window, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()
    scale = np.abs(expected_jacobian).max(axis=(0, 1))
    assert (np.abs(jacobian - expected_jacobian).max(axis=(0, 1)) <= 1e-4 * scale).all()


WIDE = sheets.sheet(64, 64)


@settings(max_examples=30, deadline=None)
@given(
    theta=box_of(RECOMMENDED),
    scheme=st.sampled_from(["euler", "dkd"]),
    radius=st.floats(0.5, 6.0),
    offsets=st.lists(st.tuples(st.integers(-30, 30), st.integers(-30, 30)), min_size=1, max_size=6),
)
def test_window_error_is_kept_for_wide_loads_and_many_watched_vertices(theta, scheme, radius, offsets):
    """Share of the largest displacement that is watched, near the load or far from it."""

    def at(offset):
        return int(np.argmin(np.abs(WIDE.pixels - (np.array([32, 32]) + offset)).sum(axis=1)))

    load = Press.on_patch(WIDE, at((0, 0)), radius, DIRECTION, ramped(10, 40, 10, 120))
    watch = np.array([at(offset) for offset in offsets])
    exact, window = (Mechanics(scheme=scheme, window_error=error) for error in (0.0, 1e-4))
    expected, expected_slopes = simulate_sensitivities(theta, WIDE, load, exact, watch=watch, dtype=np.float64)
    seen, slopes = simulate_sensitivities(theta, WIDE, load, window, watch=watch, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()
    scale = np.abs(expected_slopes).max(axis=(0, 1, 2))
    # Far from the load on creeping tissue derivatives are as small as the rounding of the largest displacement.
    rounding = np.finfo(np.float64).eps * np.abs(expected).max() / np.abs(theta)
    assert (np.abs(slopes - expected_slopes).max(axis=(0, 1, 2)) <= 1e-4 * scale + rounding).all()


@pytest.mark.parametrize(
    ("size", "theta", "steps", "beside"), [(64, (0.1, 0.4, -0.1), 120, 30), (130, (5.34, 0.0, -5.0), 200, 0)]
)
def test_a_window_that_fails_its_check_is_not_used(size, theta, steps, beside):
    """One ends before the watched vertex: both windows then say that it doesn't move at all, and agree.

    Without damping, far beyond the box, the other's motion is chaotic, so that the smallest neglected part grows.
    """
    mesh, middle = sheets.sheet(size, size), size // 2 * (size + 1)
    load, watch = sheets.pressed(mesh, middle, 50, steps, DIRECTION), np.array([middle + beside])
    expected = simulate(theta, mesh, load, Mechanics(), watch=watch, dtype=np.float64)
    assert np.abs(expected).max() > 0
    seen = simulate(theta, mesh, load, Mechanics(window_error=1e-4), watch=watch, dtype=np.float64)
    assert np.abs(seen - expected).max() <= 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("theta", "mechanics"),
    [
        ((3.53019939, 2.1473037e-3, -9.51977048), Mechanics(window_error=1e-2)),
        ((3.03947714, 0.0, -7.51413361), Mechanics(window_error=1e-6, scheme="dkd")),
    ],
)
def test_a_window_good_for_the_path_alone_is_not_used_for_derivatives(theta, mechanics):
    """Nearly chaotic motion: the window's path is within the threshold, its derivatives would be some times beyond."""
    mesh, exact = sheets.sheet(130, 130), dataclasses.replace(mechanics, window_error=0.0)
    load = sheets.pressed(mesh, 65 * 131, 50, 200, DIRECTION)
    expected, expected_slopes = simulate_sensitivities(theta, mesh, load, exact, dtype=np.float64)
    seen = simulate(theta, mesh, load, mechanics, dtype=np.float64)
    assert 0 < np.abs(seen - expected).max() <= mechanics.window_error * np.abs(expected).max()
    path, slopes = simulate_sensitivities(theta, mesh, load, mechanics, dtype=np.float64)
    np.testing.assert_array_equal(path, expected)
    np.testing.assert_array_equal(slopes, expected_slopes)


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
    mesh = grid_mesh(sheets.surface(*valid.shape), valid, max_edge=1.0, keep=keep)
    if len(mesh.vertices) == 0:
        return
    load = load_of(kind, mesh, where % len(mesh.vertices), mechanics[1])
    arguments = theta, mesh, load, mechanics[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = [*simulate_sensitivities(*arguments), sheets.whole_field(*arguments)]
    for values in found:
        assert np.isfinite(values).all()
        assert values.dtype == np.float32


def test_single_precision_follows_double():
    mesh, watch = sheets.sheet(20, 21), np.array([200, 205, 150])
    for kind in ("vertex", "patch", "grip"):
        load, theta = load_of(kind, mesh, 200, 200), (0.5, 0.08, -0.1)
        for mechanics in (Mechanics(), Mechanics(scheme="dkd")):
            double = simulate_sensitivities(theta, mesh, load, mechanics, watch=watch, dtype=np.float64)
            single = simulate_sensitivities(theta, mesh, load, mechanics, watch=watch)
            for seen, expected in zip(single, double, strict=True):
                np.testing.assert_allclose(seen, expected, atol=1e-4 * np.abs(expected).max())


def test_threads_share_nothing():
    """Cases of several kinds and sizes at once give what each gives alone."""
    meshes = [sheets.sheet(20, 21), sheets.sheet(30, 30), sheets.sheet(20, 20, keep=0.5)]
    jobs = [
        ((0.5, 0.05 + 0.01 * index, -0.1), mesh, load_of(kind, mesh, 90, 60), Mechanics(window_error=1e-4))
        for index, (mesh, kind) in enumerate(itertools.product(meshes, ("vertex", "patch", "grip")))
    ]
    alone = [simulate_sensitivities(*job) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        for seen, expected in zip(pool.map(lambda job: simulate_sensitivities(*job), jobs * 3), alone * 3, strict=True):
            np.testing.assert_array_equal(seen[0], expected[0])
            np.testing.assert_array_equal(seen[1], expected[1])
