"""Forward simulation against closed forms, an adaptive integrator and conservation laws."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from physics.load import Grip, Press, held, ramped
from physics.mechanics import Mechanics
from physics.mesh import contact_normal, grid_mesh, nearest_vertex
from physics.msd.simulation import simulate, simulate_field, simulate_reaction, simulate_sensitivities
from tests.physics.sheets import (
    energy,
    gripped,
    hand_mesh,
    position_form_force,
    pressed,
    sheet,
    smooth_path,
    surface,
)

Z = np.array([0.0, 0.0, 1.0])
X = np.array([1.0, 0.0, 0.0])


def press_on(mesh, vertex, direction, mechanics) -> Press:
    """A press on one vertex over the steps that the mechanics name."""
    return pressed(mesh, vertex, mechanics.load_steps, mechanics.steps, direction)


def solve(mesh, load, theta, mechanics, course, corners) -> np.ndarray:
    """Displacement [T, N, 3] by an adaptive eighth-order method, restarted at the corners of the load's course.

    Args:
        course: factor of a press at a time, or displacement of a grip's vertices [G, 3].
        corners: times at which it is not smooth, the first 0 and the last at the end or later.
    """
    stiffness, damping, force = theta
    held = (mesh.rim if mechanics.boundary == "fixed" else np.zeros(len(mesh.rim), dtype=bool)).copy()
    held[load.vertices] = isinstance(load, Grip)
    count = len(mesh.vertices)

    def place(displacement, time):
        if isinstance(load, Grip):
            displacement = displacement.copy()
            displacement[load.vertices] = course(time)
        return displacement

    def derivative(time, state):
        displacement, velocity = state.reshape(2, count, 3)
        total = position_form_force(place(displacement, time), mesh, stiffness, mechanics.anchor) - damping * velocity
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
    mesh = hand_mesh([[0, 0, 1]], [])
    seen = simulate([0.5, damping, -0.3], mesh, press_on(mesh, 0, Z, mechanics), mechanics, dtype=np.float64)
    np.testing.assert_allclose(seen[:, 2], expected, rtol=1e-12)
    assert not seen[:, :2].any()


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
def test_single_mass_approaches_the_continuous_closed_form(scheme):
    # m v' = F − k_d v from rest: x = F/k_d (t − τ(1 − e^(−t/τ))), τ = m/k_d. Semi-implicit Euler lags or leads
    # by at most one step of the speed, |v|·Δt ≤ |F|/k_d·Δt. DKD solves this linear problem's velocity exactly and
    # integrates it by the midpoint of positions: error ≤ t·Δt²/12·max|v''| ≤ t·Δt²/12·F/(m τ)·.
    damping, force = 0.02, -0.3
    mechanics = Mechanics(load_steps=200, scheme=scheme)
    time, tau = mechanics.times, mechanics.mass / damping
    expected = force / damping * (time - tau * (1 - np.exp(-time / tau)))
    mesh = hand_mesh([[0, 0, 1]], [])
    load = press_on(mesh, 0, Z, mechanics)
    seen = simulate([0.5, damping, force], mesh, load, mechanics, dtype=np.float64)[:, 2]
    first_order = abs(force) / damping * mechanics.time_step
    second_order = time * mechanics.time_step**2 / 12 * abs(force) / (mechanics.mass * tau)
    assert (np.abs(seen - expected) <= (first_order if scheme == "euler" else second_order)).all()


@pytest.mark.parametrize(("held", "inertia"), [(False, 0.0005), (True, 0.001)])
def test_two_masses_on_a_spring_have_the_closed_form_frequency(held, inertia):
    # Load along the axis for one step; then ω = √(k/μ), μ = m/2 for two free masses and m with one held.
    stiffness, mechanics = 0.5, Mechanics(time_step=1e-4, steps=6000, load_steps=1, boundary="fixed")
    mesh = hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 1]], rim=[False, held])
    load = press_on(mesh, 0, X, mechanics)
    field = simulate_field([stiffness, 0.0, 0.1], mesh, load, mechanics, dtype=np.float64)
    stretch = field[:, 0, 0] - field[:, 1, 0]
    impulse = 0.1 * mechanics.time_step / mechanics.mass
    frequency = np.sqrt(stiffness / inertia)
    expected = impulse / frequency * np.sin(frequency * mechanics.times)
    # Symplectic Euler: phase error ω³Δt²t/24 and half a step of offset, together below Δt·ω of the amplitude.
    amplitude = impulse / frequency
    np.testing.assert_allclose(stretch, expected, atol=amplitude * mechanics.time_step * frequency)
    crossings = mechanics.times[1:][np.diff(np.sign(stretch)) != 0]
    assert np.pi / np.diff(crossings).mean() == pytest.approx(frequency, rel=2e-3)


REFINEMENTS = [1, 2, 4, 8]


def convergence(mesh, theta, load_of, mechanics_of, exact) -> tuple[float, float]:
    """Measured order, and the error at the largest step relative to the peak."""
    errors = []
    for factor in REFINEMENTS:
        mechanics = mechanics_of(factor)
        seen = simulate_field(theta, mesh, load_of(factor, mechanics), mechanics, dtype=np.float64)
        errors.append(np.abs(seen[factor - 1 :: factor] - exact).max() / np.abs(exact).max())
    return -np.polyfit(np.log(REFINEMENTS), np.log(errors), 1)[0], errors[0]


def test_order_of_convergence_on_a_sheet():
    mesh, vertex, theta = sheet(8, 8), 27, (0.6, 0.02, -0.02)
    direction = contact_normal(mesh, vertex)

    def load_of(_, mechanics):
        return press_on(mesh, vertex, direction, mechanics)

    coarse = Mechanics(time_step=0.002, steps=100, load_steps=40)
    exact = solve(mesh, load_of(1, coarse), theta, coarse, lambda time: float(time < 0.08), [0, 0.08, 0.2])
    for scheme, order in (("euler", 1), ("dkd", 2)):

        def mechanics_of(factor, scheme=scheme):
            return Mechanics(time_step=0.002 / factor, steps=100 * factor, load_steps=40 * factor, scheme=scheme)

        slope, first = convergence(mesh, theta, load_of, mechanics_of, exact)
        assert slope == pytest.approx(order, abs=0.15), scheme
        assert first < (0.1 if order == 1 else 0.02)


@pytest.mark.parametrize("kind", ["patch", "grip"])
def test_order_of_convergence_of_patches_and_grips(kind):
    mesh, theta, inside = sheet(9, 9), (0.6, 0.02, -0.02), [38, 39, 48]
    corners = [0, 0.02, 0.05, 0.08, 0.1]

    def load_of(factor, mechanics):
        if kind == "patch":
            times = ramped(10 * factor, 15 * factor, 15 * factor, 50 * factor)
            return Press.on_patch(mesh, 40, 2.5, contact_normal(mesh, 40), times)
        return gripped(mesh, inside, 0.08, 50 * factor, mechanics.time_step)

    coarse = Mechanics(time_step=0.002, steps=50, load_steps=0)
    load = load_of(1, coarse)

    def course(time):
        if kind == "patch":
            return np.interp(time, corners, [0, 1, 1, 0, 0])
        return smooth_path(time, 0.08) * load.displacement[-1]

    exact = solve(mesh, load, theta, coarse, course, corners)
    for scheme, order in (("euler", 1), ("dkd", 2)):

        def mechanics_of(factor, scheme=scheme):
            return Mechanics(time_step=0.002 / factor, steps=50 * factor, scheme=scheme)

        slope, first = convergence(mesh, theta, load_of, mechanics_of, exact)
        assert slope == pytest.approx(order, abs=0.15), scheme
        assert first < (0.1 if order == 1 else 0.02)


def test_anchor_springs_agree_with_the_adaptive_integrator():
    mesh, vertex = sheet(5, 5), 12
    mechanics = Mechanics(time_step=2.5e-4, steps=400, load_steps=100, anchor=0.3, boundary="free", scheme="dkd")
    direction, theta = contact_normal(mesh, vertex), (0.6, 0.01, -0.02)
    load = press_on(mesh, vertex, direction, mechanics)
    seen = simulate_field(theta, mesh, load, mechanics, dtype=np.float64)
    exact = solve(mesh, load, theta, mechanics, lambda time: float(time < 0.025), [0, 0.025, 0.1])
    np.testing.assert_allclose(seen, exact, atol=1e-3 * np.abs(exact).max())


def test_held_vertices_stay_and_the_contact_vertex_moves_even_on_the_rim():
    mesh = sheet(6, 7)
    corner = 0
    assert mesh.rim[corner]
    load = pressed(mesh, corner, 10, 30, Z)
    field = simulate_field([0.5, 0.1, -0.1], mesh, load, Mechanics())
    kept = mesh.rim.copy()
    kept[corner] = False
    assert not field[:, kept].any()
    assert np.abs(field[:, corner]).max() > 0
    free = simulate_field([0.5, 0.1, -0.1], mesh, load, Mechanics(boundary="free"))
    assert np.abs(free[-1, kept]).max() > 0


def test_momentum_of_a_free_undamped_mesh_is_the_impulse():
    mesh, mechanics = sheet(7, 8), Mechanics(boundary="free", load_steps=50)
    direction = contact_normal(mesh, 20)
    load = press_on(mesh, 20, direction, mechanics)
    field = simulate_field([0.8, 0.0, -0.05], mesh, load, mechanics, dtype=np.float64)
    velocity = np.diff(field, axis=0, prepend=0) / mechanics.time_step
    momentum = mechanics.mass * velocity.sum(axis=1)
    loaded = np.minimum(np.arange(1, 201), 50)[:, None] * mechanics.time_step
    np.testing.assert_allclose(momentum, -0.05 * loaded * direction, atol=1e-14)


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
def test_energy_without_load(scheme):
    def relative_error(refinement, damping):
        mesh = sheet(7, 8)
        mechanics = Mechanics(
            time_step=1e-3 / refinement, steps=1000 * refinement, load_steps=20 * refinement, scheme=scheme
        )
        theta = (0.8, damping, -0.02)
        load = press_on(mesh, 27, contact_normal(mesh, 27), mechanics)
        field = simulate_field(theta, mesh, load, mechanics, dtype=np.float64)
        # Velocity at the steps by central differences, second order for both schemes.
        speed = (field[2:] - field[:-2]) / (2 * mechanics.time_step)
        values = [energy(u, v, mesh, 0.8, mechanics.mass) for u, v in zip(field[1:-1], speed, strict=True)]
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


def test_explicit_damping_diverges_beyond_its_limit_and_implicit_never():
    mesh = sheet(6, 6)
    limit = 2 * 0.001 / 0.005
    explicit = Mechanics(damping="explicit")
    load = pressed(mesh, 14, 50, 200, Z)
    below = simulate([0.5, 0.9 * limit, -0.1], mesh, load, explicit, dtype=np.float64)
    beyond = simulate([0.5, 1.3 * limit, -0.1], mesh, load, explicit, dtype=np.float64)
    implicit = simulate([0.5, 1.3 * limit, -0.1], mesh, load, Mechanics(), dtype=np.float64)
    assert np.abs(below).max() < 1
    assert np.abs(beyond[-1]).max() > 1e3
    assert np.abs(implicit).max() < 1


def test_coincident_vertices_and_no_stiffness_are_safe():
    mesh = hand_mesh([[0, 0, 1], [0, 0, 1], [0.01, 0, 1]], [[0, 1], [0, 2], [1, 2]])
    load = pressed(mesh, 0, 50, 200, X)
    for theta in ([0.5, 0.1, -0.1], [0.0, 0.0, -0.1], [0.0, 0.0, 0.0]):
        assert np.isfinite(simulate_field(theta, mesh, load, Mechanics(boundary="free"))).all()
    free_fall = simulate([0.0, 0.0, -0.1], mesh, load, Mechanics(), dtype=np.float64)[:, 0]
    steps = np.arange(1, 51)
    np.testing.assert_allclose(free_fall[:50], -100 * 0.005**2 * steps * (steps + 1) / 2, rtol=1e-12)


def test_the_motion_follows_the_load_s_course():
    mesh, theta = sheet(6, 6), [0.5, 0.05, -0.1]
    quarter = simulate(theta, mesh, pressed(mesh, 14, 10, 40, Z), Mechanics())
    halved = simulate([0.5, 0.05, -0.2], mesh, Press.at(14, Z, 0.5 * held(10, 40)), Mechanics())
    np.testing.assert_allclose(halved, quarter, rtol=1e-5, atol=1e-9)
    earlier = simulate(theta, mesh, pressed(mesh, 14, 10, 40, Z).until(25), Mechanics())
    np.testing.assert_array_equal(earlier, quarter[:25])
    assert not simulate(theta, mesh, pressed(mesh, 14, 0, 40, Z), Mechanics()).any()


def test_bad_input_is_named():
    mesh, mechanics = sheet(5, 5), Mechanics()
    load, theta = pressed(mesh, 3, 5, 10, Z), [0.5, 0.1, 1.0]
    for arguments, said in (
        (([0.5, 0.1], mesh, load, mechanics), "three finite numbers k_s, k_d and F"),
        (([0.5, np.nan, 1.0], mesh, load, mechanics), "three finite"),
        (([-0.5, 0.1, 1.0], mesh, load, mechanics), "neither may be negative"),
        ((theta, mesh, pressed(mesh, 25, 5, 10, Z), mechanics), "load names vertex 25; the mesh has 25"),
        ((theta, mesh, Grip(np.array([3, -1]), np.zeros((4, 2, 3))), mechanics), "load names vertex -1"),
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
@pytest.mark.parametrize("boundary", ["fixed", "free"])
def test_an_affine_grip_of_the_rim_moves_the_inside_affinely(boundary, scheme):
    """Stretched, sheared and tilted: opposite springs of an inner vertex then pull alike, whatever the strain."""
    mesh, mechanics = flat_sheet(), Mechanics(scheme=scheme, boundary=boundary)
    affine = np.array([[0.2, 0.03, 0.0], [-0.02, 0.15, 0.0], [0.1, -0.05, 0.0]])
    goal = mesh.vertices.astype(np.float64) @ affine.T
    rim = np.flatnonzero(mesh.rim)
    way = smooth_path(mechanics.time_step * np.arange(1, 1201), 0.2)
    grip = Grip(rim, way[:, None, None] * goal[rim])
    theta = (0.8, 0.02, 0.0)
    field = simulate_field(theta, mesh, grip, mechanics, dtype=np.float64)
    size = np.abs(goal).max()
    assert np.abs(field[30] - way[30] * goal).max() > 0.1 * size  # on the way it is not affine
    np.testing.assert_allclose(field[-1], goal, atol=1e-12 * size)
    # Its forces are then known beforehand: springs of known lengths pull at the rim, and cancel inside.
    force = simulate_reaction(theta, mesh, grip, mechanics, dtype=np.float64)[0][-1]
    pull = position_form_force(goal, mesh, 0.8)
    scale = np.abs(pull).max()
    assert np.abs(pull[~mesh.rim]).max() < 1e-12 * scale
    np.testing.assert_allclose(force, -pull[rim], atol=1e-10 * scale)


@pytest.mark.parametrize("keep", [1.0, 0.5])
@pytest.mark.parametrize("anchor", [0.0, 0.2])
def test_forces_balance_under_a_static_grip(anchor, keep):
    """Two opposite edges are pulled apart: the sum of the springs is held there, and all outer forces cancel."""
    mesh, mechanics = sheet(7, 8, keep=keep), Mechanics(boundary="free", anchor=anchor)
    column = mesh.pixels[:, 1]
    where = np.flatnonzero((column == column.min()) | (column == column.max()))
    way = smooth_path(mechanics.time_step * np.arange(1, 1501), 0.2)
    goal = np.outer(column[where] / column.max(), [0.02, 0.004, 0.003])
    grip, theta = Grip(where, way[:, None, None] * goal), (0.8, 0.01, 0.0)
    force = simulate_reaction(theta, mesh, grip, mechanics, dtype=np.float64)[0][-1]
    field = simulate_field(theta, mesh, grip, mechanics, dtype=np.float64)[-1]
    pull, scale = position_form_force(field, mesh, 0.8, anchor), np.abs(force).max()
    assert scale > 5e-3
    np.testing.assert_allclose(force, -pull[where], atol=1e-12 * scale)
    anchors = -0.8 * anchor * field
    np.testing.assert_allclose(force.sum(axis=0) + anchors.sum(axis=0), 0, atol=1e-11 * scale)
    place = mesh.vertices + field
    moment = np.cross(place[where], force).sum(axis=0) + np.cross(place, anchors).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-11 * scale)


@pytest.mark.parametrize("steps", [1, 2, 3, 40])
def test_impulses_of_the_reaction_are_the_momentum_and_what_damping_took(steps):
    """Exact for Euler, whose velocities are those of the path: nothing but the grip and damping acts on the sheet."""
    mesh, damping = sheet(6, 7), 0.03
    mechanics = Mechanics(boundary="free")
    grip = gripped(mesh, [9, 10, 30], 0.1, steps)
    force, _ = simulate_reaction((0.8, damping, 0.0), mesh, grip, mechanics, dtype=np.float64)
    field = simulate_field((0.8, damping, 0.0), mesh, grip, mechanics, dtype=np.float64)
    velocity = np.diff(field, axis=0, prepend=0).sum(axis=1) / mechanics.time_step
    momentum = mechanics.mass * velocity
    lost = damping * mechanics.time_step * np.cumsum(velocity, axis=0)
    impulse = mechanics.time_step * np.cumsum(force.sum(axis=1), axis=0)
    np.testing.assert_allclose(impulse, momentum + lost, atol=1e-12 * np.abs(impulse).max())


@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("dkd", 2)])
@pytest.mark.parametrize("kind", ["patch", "grip"])
def test_work_becomes_energy_and_heat(kind, scheme, order):
    """Work of the load = elastic and kinetic energy + ∫ k_d·v², up to an error that falls with the scheme's order."""
    mesh, stiffness, damping, errors = sheet(8, 8), 0.8, 0.02, []
    refinements = [1, 2, 4, 8]
    for factor in refinements:
        steps, step = 60 * factor, 0.002 / factor
        mechanics = Mechanics(time_step=step, scheme=scheme, boundary="free")
        theta = (stiffness, damping, -0.05)
        if kind == "patch":
            course = ramped(15 * factor, 30 * factor, 10 * factor, steps)
            load = Press.on_patch(mesh, 27, 2.5, contact_normal(mesh, 27), course)
            force = -0.05 * course[:, None, None] * np.outer(load.weights, load.direction)
        else:
            load = gripped(mesh, [18, 19, 27], 0.15, steps, step)
            force, _ = simulate_reaction(theta, mesh, load, mechanics, dtype=np.float64)
        field = np.concatenate([np.zeros((1, 64, 3)), simulate_field(theta, mesh, load, mechanics, dtype=np.float64)])
        moved = np.diff(field, axis=0)
        work = (force * moved[:, load.vertices]).sum()
        heat = damping * np.square(moved).sum() / step
        speed = (3 * field[-1] - 4 * field[-2] + field[-3]) / (2 * step)
        stored = energy(field[-1], speed, mesh, stiffness, mechanics.mass)
        assert min(heat, stored) > 0.1 * work
        errors.append(abs(work - stored - heat) / work)
    slope = -np.polyfit(np.log(refinements), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.2), errors
    assert errors[-1] < (0.02 if order == 1 else 5e-4), errors


ISLANDS = np.ones((8, 13), dtype=bool)
ISLANDS[:, 8:10] = False
"""Two sheets in one mesh, of 8 and of 3 columns."""


@pytest.mark.parametrize("keep", [1.0, 0.5])
@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd", anchor=0.1)], ids=["euler", "dkd"])
@pytest.mark.parametrize("kind", ["vertex", "patch", "grip"])
def test_derivatives_equal_differences_wherever_one_looks(kind, mechanics, keep):
    """Watched: in the load, beside it, further off, on the held rim, and on an island that nothing connects with it."""
    mesh = grid_mesh(surface(8, 13), ISLANDS, max_edge=1.0, keep=keep)
    middle = nearest_vertex(mesh, mesh.vertices[mesh.pixels[:, 1] < 8].mean(axis=0))
    beside = np.argsort(np.linalg.norm(mesh.pixels - mesh.pixels[middle], axis=1))
    loads = {
        "vertex": pressed(mesh, middle, 15, 60),
        "patch": Press.on_patch(mesh, middle, 2.2, contact_normal(mesh, middle), ramped(10, 20, 10, 60)),
        "grip": gripped(mesh, beside[[0, 1, 3]], 0.2, 60),
    }
    load, theta = loads[kind], np.array([0.6, 0.04, -0.1])
    rim = np.flatnonzero(mesh.rim & (mesh.pixels[:, 1] < 7))[0]
    island = np.flatnonzero(mesh.pixels[:, 1] > 9)[0]
    watch = np.array([*beside[[0, 1, 2, 4, 5]], rim, island])

    def motion(values):
        return simulate(values, mesh, load, mechanics, watch=watch, dtype=np.float64)

    path, slopes = simulate_sensitivities(theta, mesh, load, mechanics, watch=watch, dtype=np.float64)
    field = simulate_field(theta, mesh, load, mechanics, dtype=np.float64)
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


@pytest.mark.parametrize("keep", [1.0, 0.5])
@pytest.mark.parametrize("scheme", ["euler", "dkd"])
@pytest.mark.parametrize("steps", [1, 2, 60])
def test_derivatives_of_the_reaction_equal_differences(steps, scheme, keep):
    mesh, mechanics = sheet(8, 9, keep=keep), Mechanics(scheme=scheme, anchor=0.1, window_error=1e-2)
    grip, theta = gripped(mesh, [0, len(mesh.vertices) // 2, 3], 0.2, steps), np.array([0.6, 0.04, 0.0])
    force, slopes = simulate_reaction(theta, mesh, grip, mechanics, dtype=np.float64)
    assert (force.shape, slopes.shape) == ((steps, 3, 3), (steps, 3, 3, 2))
    for parameter in range(2):
        offset = 1e-6 * theta[parameter] * np.eye(3)[parameter]
        plus, minus = (
            simulate_reaction(theta + sign * offset, mesh, grip, mechanics, dtype=np.float64)[0] for sign in (1, -1)
        )
        central = (plus - minus) / (2 * offset[parameter])
        np.testing.assert_allclose(slopes[..., parameter], central, atol=1e-6 * np.abs(central).max())
    single, single_slopes = simulate_reaction(theta, mesh, grip, mechanics)
    assert single.dtype == single_slopes.dtype == np.float32
    np.testing.assert_allclose(single, force, atol=1e-5 * np.abs(force).max())


def test_the_reaction_far_from_the_first_gripped_vertex_is_that_of_the_whole_field():
    """Springs next to every gripped vertex count up to the last step, not only those near the first."""
    mesh, mechanics = sheet(9, 40), Mechanics(boundary="free")
    steps, where = 30, np.array([4 * 40, 4 * 40 + 39, 8 * 40 + 20])
    grip = gripped(mesh, where, 0.1, steps)
    theta = (0.6, 0.04, 0.0)
    force, _ = simulate_reaction(theta, mesh, grip, mechanics, dtype=np.float64)
    field = np.concatenate([np.zeros((1, 360, 3)), simulate_field(theta, mesh, grip, mechanics, dtype=np.float64)])
    # Euler: the springs of each step act at its beginning.
    elastic = np.stack([position_form_force(before, mesh, 0.6)[where] for before in field[:-1]])
    velocity = np.diff(field[:, where], axis=0) / mechanics.time_step
    inertia = mechanics.mass * np.diff(velocity, axis=0, prepend=0) / mechanics.time_step
    np.testing.assert_allclose(force, inertia + 0.04 * velocity - elastic, atol=1e-12 * np.abs(force).max())


def test_the_reaction_is_exact_whatever_a_window_may_neglect():
    """The check of a window looks at where watched vertices go, and gripped ones always go where they are put."""
    mesh, theta = sheet(40, 40), (0.3, 0.2, 0.0)
    grip = gripped(mesh, [820, 821, 860], 0.2, 80)
    exact = simulate_reaction(theta, mesh, grip, Mechanics())
    for seen, expected in zip(simulate_reaction(theta, mesh, grip, Mechanics(window_error=0.3)), exact, strict=True):
        np.testing.assert_array_equal(seen, expected)
