"""Forward simulation against closed forms, an adaptive integrator and conservation laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sheets import energy, hand_mesh, position_form_force, sheet

from physics.mechanics import Mechanics
from physics.mesh import contact_normal
from physics.msd_kernel import load_profile, simulate, simulate_field

Z = np.array([0.0, 0.0, 1.0])
X = np.array([1.0, 0.0, 0.0])


def solve(mesh, vertex, direction, theta, mechanics, load_time) -> np.ndarray:
    """Displacement [T, N, 3] by an adaptive eighth-order method, restarted where the load ends."""
    stiffness, damping, force = theta
    held = (mesh.rim if mechanics.boundary == "fixed" else np.zeros(len(mesh.rim), dtype=bool)).copy()
    held[vertex] = False
    count = len(mesh.vertices)

    def derivative(time, state, factor):
        displacement, velocity = state.reshape(2, count, 3)
        total = position_form_force(displacement, mesh, stiffness, mechanics.anchor) - damping * velocity
        total[vertex] += factor * force * np.asarray(direction)
        total[held] = 0
        return np.concatenate([velocity.ravel(), total.ravel() / mechanics.mass])

    times = mechanics.times
    options = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-12}
    early, late = times[times <= load_time + 1e-12], times[times > load_time + 1e-12]
    loaded = solve_ivp(derivative, (0, load_time), np.zeros(6 * count), args=(1.0,), t_eval=early, **options)
    parts = [loaded.y]
    if len(late):
        start = loaded.y[:, -1]
        parts.append(solve_ivp(derivative, (load_time, times[-1]), start, args=(0.0,), t_eval=late, **options).y)
    return np.concatenate(parts, axis=1).T.reshape(-1, 2, count, 3)[:, 0]


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
    seen = simulate([0.5, damping, -0.3], hand_mesh([[0, 0, 1]], []), 0, Z, mechanics, dtype=np.float64)
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
    seen = simulate([0.5, damping, force], hand_mesh([[0, 0, 1]], []), 0, Z, mechanics, dtype=np.float64)[:, 2]
    first_order = abs(force) / damping * mechanics.time_step
    second_order = time * mechanics.time_step**2 / 12 * abs(force) / (mechanics.mass * tau)
    assert (np.abs(seen - expected) <= (first_order if scheme == "euler" else second_order)).all()


@pytest.mark.parametrize(("held", "inertia"), [(False, 0.0005), (True, 0.001)])
def test_two_masses_on_a_spring_have_the_closed_form_frequency(held, inertia):
    # Load along the axis for one step; then ω = √(k/μ), μ = m/2 for two free masses and m with one held.
    stiffness, mechanics = 0.5, Mechanics(time_step=1e-4, steps=6000, load_steps=1, boundary="fixed")
    mesh = hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 1]], rim=[False, held])
    field = simulate_field([stiffness, 0.0, 0.1], mesh, 0, X, mechanics, dtype=np.float64)
    stretch = field[:, 0, 0] - field[:, 1, 0]
    impulse = 0.1 * mechanics.time_step / mechanics.mass
    frequency = np.sqrt(stiffness / inertia)
    expected = impulse / frequency * np.sin(frequency * mechanics.times)
    # Symplectic Euler: phase error ω³Δt²t/24 and half a step of offset, together below Δt·ω of the amplitude.
    amplitude = impulse / frequency
    np.testing.assert_allclose(stretch, expected, atol=amplitude * mechanics.time_step * frequency)
    crossings = mechanics.times[1:][np.diff(np.sign(stretch)) != 0]
    assert np.pi / np.diff(crossings).mean() == pytest.approx(frequency, rel=2e-3)


@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("dkd", 2)])
def test_order_of_convergence_on_a_sheet(scheme, order):
    mesh = sheet(10, 10)
    vertex = 44
    direction, theta = contact_normal(mesh, vertex), (0.6, 0.02, -0.02)
    errors = []
    refinements = [1, 2, 4, 8]
    for factor in refinements:
        mechanics = Mechanics(time_step=0.002 / factor, steps=100 * factor, load_steps=40 * factor, scheme=scheme)
        seen = simulate_field(theta, mesh, vertex, direction, mechanics, dtype=np.float64)[factor - 1 :: factor]
        if factor == 1:
            exact = solve(mesh, vertex, direction, theta, mechanics, 0.08)
        errors.append(np.abs(seen - exact).max() / np.abs(exact).max())
    slope = -np.polyfit(np.log(refinements), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.15), errors
    assert errors[0] < (0.1 if order == 1 else 0.02)


def test_anchor_springs_agree_with_the_adaptive_integrator():
    mesh, vertex = sheet(6, 6), 14
    mechanics = Mechanics(time_step=2.5e-4, steps=400, load_steps=100, anchor=0.3, boundary="free", scheme="dkd")
    direction, theta = contact_normal(mesh, vertex), (0.6, 0.01, -0.02)
    seen = simulate_field(theta, mesh, vertex, direction, mechanics, dtype=np.float64)
    exact = solve(mesh, vertex, direction, theta, mechanics, 0.025)
    np.testing.assert_allclose(seen, exact, atol=1e-3 * np.abs(exact).max())


def test_held_vertices_stay_and_the_contact_vertex_moves_even_on_the_rim():
    mesh = sheet(6, 7)
    corner = 0
    assert mesh.rim[corner]
    field = simulate_field([0.5, 0.1, -0.1], mesh, corner, Z, Mechanics(steps=30, load_steps=10))
    held = mesh.rim.copy()
    held[corner] = False
    assert not field[:, held].any()
    assert np.abs(field[:, corner]).max() > 0
    free = simulate_field([0.5, 0.1, -0.1], mesh, corner, Z, Mechanics(steps=30, load_steps=10, boundary="free"))
    assert np.abs(free[-1, held]).max() > 0


def test_momentum_of_a_free_undamped_mesh_is_the_impulse():
    mesh, mechanics = sheet(7, 8), Mechanics(boundary="free", load_steps=50)
    direction = contact_normal(mesh, 20)
    field = simulate_field([0.8, 0.0, -0.05], mesh, 20, direction, mechanics, dtype=np.float64)
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
        field = simulate_field(theta, mesh, 27, contact_normal(mesh, 27), mechanics, dtype=np.float64)
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
    below = simulate([0.5, 0.9 * limit, -0.1], mesh, 14, Z, explicit, dtype=np.float64)
    beyond = simulate([0.5, 1.3 * limit, -0.1], mesh, 14, Z, explicit, dtype=np.float64)
    implicit = simulate([0.5, 1.3 * limit, -0.1], mesh, 14, Z, Mechanics(), dtype=np.float64)
    assert np.abs(below).max() < 1
    assert np.abs(beyond[-1]).max() > 1e3
    assert np.abs(implicit).max() < 1


def test_coincident_vertices_and_no_stiffness_are_safe():
    mesh = hand_mesh([[0, 0, 1], [0, 0, 1], [0.01, 0, 1]], [[0, 1], [0, 2], [1, 2]])
    for theta in ([0.5, 0.1, -0.1], [0.0, 0.0, -0.1], [0.0, 0.0, 0.0]):
        assert np.isfinite(simulate_field(theta, mesh, 0, X, Mechanics(boundary="free"))).all()
    free_fall = simulate([0.0, 0.0, -0.1], mesh, 0, X, Mechanics(), dtype=np.float64)[:, 0]
    steps = np.arange(1, 51)
    np.testing.assert_allclose(free_fall[:50], -100 * 0.005**2 * steps * (steps + 1) / 2, rtol=1e-12)


def test_load_is_data():
    mesh, mechanics = sheet(6, 6), Mechanics(steps=40, load_steps=10)
    theta = [0.5, 0.05, -0.1]
    np.testing.assert_array_equal(load_profile(mechanics, 3), [1.0] * 3 + [0.0] * 37)
    quarter = simulate(theta, mesh, 14, Z, mechanics)
    np.testing.assert_array_equal(simulate(theta, mesh, 14, Z, mechanics, load=load_profile(mechanics)), quarter)
    np.testing.assert_array_equal(
        simulate(theta, mesh, 14, Z, Mechanics(steps=40, load_steps=0), load_steps=10), quarter
    )
    halved = simulate([0.5, 0.05, -0.2], mesh, 14, Z, mechanics, load=0.5 * load_profile(mechanics))
    np.testing.assert_allclose(halved, quarter, rtol=1e-5, atol=1e-9)
    assert not simulate(theta, mesh, 14, Z, mechanics, load_steps=0).any()


def test_bad_input_is_named():
    mesh, mechanics = sheet(5, 5), Mechanics(steps=10, load_steps=5)
    for arguments, said in (
        (([0.5, 0.1], mesh, 3, Z, mechanics), "three finite numbers k_s, k_d and F"),
        (([0.5, np.nan, 1.0], mesh, 3, Z, mechanics), "three finite"),
        (([-0.5, 0.1, 1.0], mesh, 3, Z, mechanics), "neither may be negative"),
        (([0.5, 0.1, 1.0], mesh, 25, Z, mechanics), "vertex is 25; the mesh has 25"),
        (([0.5, 0.1, 1.0], mesh, 3, [1.0, 0.0], mechanics), "direction"),
    ):
        with pytest.raises(ValueError, match=said):
            simulate(*arguments)
    with pytest.raises(ValueError, match="load_steps is 11"):
        simulate([0.5, 0.1, 1.0], mesh, 3, Z, mechanics, load_steps=11)
    with pytest.raises(ValueError, match="10 finite factors"):
        simulate([0.5, 0.1, 1.0], mesh, 3, Z, mechanics, load=np.ones(9))
