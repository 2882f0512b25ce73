"""Time steps and their adjoint: against the plain version, finite differences, conservation laws and a minimum."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

from palpate.physics.load import Grip
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential import Potential
from palpate.physics.pbd.simulation import Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness, spread
from tests.physics.pbd.particles import block, sheet
from tests.physics.pbd.plain import steps

BODIES = {"sheet": sheet(5, 4, pinned_rows=1), "block": block((2, 2, 1))}
STEPPINGS = {
    "positions only": Stepping(iterations=5),
    "on a foundation": Stepping(time_step=0.7, iterations=5, foundation=0.8),
}


def fields_of(body: Body, seed: int = 0) -> Stiffness:
    random = np.random.default_rng(seed)
    return Stiffness(random.uniform(0.5, 3.0, body.count), random.uniform(0.2, 1.0, body.count))


def grip_of(body: Body, count: int = 10, size: float = 1.0) -> Grip:
    """Two corners pulled and lifted over some steps."""
    ramp = np.linspace(0.1, 1.0, count)[:, None, None]
    path = np.array([[0.004, 0.006, 0.005], [0.004, 0.006, 0.003]])
    return Grip(np.array([body.count - 1, body.count - 2]), size * ramp * path)


@pytest.mark.parametrize("stepping", STEPPINGS)
@pytest.mark.parametrize("name", BODIES)
def test_compiled_steps_equal_plain_ones(name, stepping):
    body, how, grip = BODIES[name], STEPPINGS[stepping], grip_of(BODIES[name])
    path = body.rest[grip.vertices] + grip.displacement
    expected = steps(body, spread(body, fields_of(body))[0], body.rest, grip.vertices, path, how)
    found = simulate(body, fields_of(body), grip, how)
    np.testing.assert_allclose(found.positions[0, 1:], np.stack(list(expected)), atol=1e-14)
    np.testing.assert_allclose(found.positions[0, -1, grip.vertices], body.rest[grip.vertices] + grip.displacement[-1])
    assert (found.positions[0, :, body.pinned] == body.rest[body.pinned][:, None]).all()


@pytest.mark.parametrize("stepping", STEPPINGS)
@pytest.mark.parametrize("name", BODIES)
def test_gradient_of_ten_steps_equals_finite_differences(name, stepping):
    body, how, grip, fields = BODIES[name], STEPPINGS[stepping], grip_of(BODIES[name]), fields_of(BODIES[name])
    random = np.random.default_rng(3)
    still = {"start": body.rest + 3e-4 * random.normal(size=body.rest.shape)}
    motion = simulate(body, fields, grip, how, **still)
    weights = random.normal(size=motion.positions.shape)
    slopes = motion.gradient(weights)

    def value(changed: Stiffness) -> float:
        return float((weights * simulate(body, changed, grip, how, **still).positions).sum())

    for which in ("distance", "shape"):
        central = np.empty(body.count)
        for particle in range(body.count):
            up, down = (getattr(fields, which).copy() for _ in range(2))
            up[particle] += 1e-5
            down[particle] -= 1e-5
            central[particle] = (value(fields._replace(**{which: up})) - value(fields._replace(**{which: down}))) / 2e-5
        found = getattr(slopes, which)[0]
        np.testing.assert_allclose(found, central, rtol=1e-6, atol=1e-7 * np.abs(central).max())
    if name == "block":
        stiffer, softer = (value(fields._replace(volume=share * 1e10)) for share in (1.001, 0.999))
        assert slopes.volume[0] == pytest.approx((stiffer - softer) / 2e7, rel=1e-5)


def test_loose_particles_go_back_to_their_rest_on_a_foundation():
    body = BODIES["block"]
    how = Stepping(time_step=0.5, foundation=3.0)
    away = body.rest + 0.01 * np.random.default_rng(8).normal(size=body.rest.shape)
    loose = Stiffness(np.zeros(body.count), np.zeros(body.count), 0.0)
    motion = simulate(body, loose, 4, how, start=away)
    # Implicit Euler of m Δx/Δt² = -f x, no velocity kept.
    left = (1 / (1 + 3.0 * 0.5**2)) ** np.arange(5)[:, None]
    np.testing.assert_allclose(motion.positions[0] - body.rest, left[..., None] * (away - body.rest), atol=1e-15)


def test_a_stiffness_of_zero_has_a_gradient():
    body, how, grip = BODIES["sheet"], STEPPINGS["positions only"], grip_of(BODIES["sheet"], 2)
    fields = Stiffness(np.ones(body.count), np.zeros(body.count))
    motion = simulate(body, fields, grip, how)
    weights = np.random.default_rng(4).normal(size=motion.positions.shape)
    more = simulate(body, fields._replace(shape=np.full(body.count, 1e-6)), grip, how)
    ahead = (weights * (more.positions - motion.positions)).sum() / 1e-6
    assert motion.gradient(weights).shape.sum() == pytest.approx(ahead, rel=1e-4)


def test_a_batch_is_its_members():
    body, how = BODIES["sheet"], STEPPINGS["on a foundation"]
    grips = [grip_of(body, 3, size) for size in (1.0, 0.5)]
    fields = [fields_of(body, seed) for seed in (0, 1)]
    starts = body.rest + 1e-4 * np.random.default_rng(5).normal(size=(2, *body.rest.shape))
    joined = Stiffness(*(np.stack([getattr(field, which) for field in fields]) for which in ("distance", "shape")))
    motion = simulate(body, joined, grips, how, start=starts)
    weights = np.random.default_rng(6).normal(size=motion.positions.shape)
    slopes = motion.gradient(weights)
    for index in range(2):
        alone = simulate(body, fields[index], grips[index], how, start=starts[index])
        np.testing.assert_array_equal(motion.positions[index], alone.positions[0])
        expected = alone.gradient(weights[index : index + 1])
        np.testing.assert_allclose(slopes.distance[index], expected.distance[0], rtol=1e-12)
    one_for_all = simulate(body, fields[0], grips, how, start=starts)
    np.testing.assert_array_equal(one_for_all.positions[0], motion.positions[0])


def pulled(iterations: int) -> np.ndarray:
    """A sheet in its plane, its first row pinned, after one step in which a corner is pulled."""
    body = sheet(8, 6, pinned_rows=1)
    fields = Stiffness(np.full(body.count, 5.0), np.full(body.count, 0.5))
    return simulate(body, fields, grip_of(body, 1), Stepping(iterations=iterations)).positions[0, -1]


def test_a_pulled_sheet_converges_under_iteration():
    settled = pulled(600)
    assert np.abs(pulled(601) - settled).max() < 1e-14
    apart = [np.abs(pulled(count) - settled).max() for count in (10, 20, 40, 80)]
    logs = np.log(apart)
    assert (np.diff(logs) < 0).all()
    # Linear convergence: twice the sweeps square the error's factor.
    assert (logs[3] - logs[2]) / (logs[2] - logs[1]) == pytest.approx(2, rel=0.25)
    assert apart[3] < 1e-3 * apart[0]


def test_a_pulled_sheet_comes_to_rest_where_its_energy_is_smallest():
    """To second order in the step: every sweep takes gradients where it is, not where it ends."""
    body = sheet(5, 4, pinned_rows=1)
    fields, grip = fields_of(body), grip_of(body, 1)
    energy, free = Potential(body, spread(body, fields)[0]), body.inverse_mass(grip.vertices) > 0
    held = body.rest.copy()
    held[grip.vertices] += grip.displacement[-1]

    def value(moved: np.ndarray) -> tuple[float, np.ndarray]:
        points = held.copy()
        points[free] += 1e-3 * moved.reshape(-1, 3)
        elastic, slope = energy.slope(points)
        return 1e6 * elastic, 1e3 * slope[free].ravel()

    best = minimize(value, np.zeros(3 * free.sum()), jac=True, options={"gtol": 1e-9, "maxiter": 2000})
    expected = body.rest[free] + 1e-3 * best.x.reshape(-1, 3)
    apart = []
    for time_step in (0.5, 0.25):
        steps_there = round(200 / time_step**2)
        still = Grip(grip.vertices, np.repeat(grip.displacement[-1:], steps_there, axis=0))
        how = Stepping(time_step=time_step, iterations=10)
        settled = simulate(body, fields, still, how).positions[0, -1, free]
        apart.append(np.abs(settled - expected).max() / np.abs(expected - body.rest[free]).max())
    assert apart[1] < 0.02
    assert apart[0] / apart[1] == pytest.approx(4, rel=0.2)


@pytest.mark.parametrize(("changed", "sentence"), [
    ({"start": np.zeros((3, 3))}, "start has shape"),
    ({"start": np.full((20, 3), np.inf)}, "start holds a number that is not finite"),
    ({"grips": Grip(np.array([99]), np.zeros((2, 1, 3)))}, "a particle that doesn't exist"),
    ({"grips": [Grip(np.array([1]), np.zeros((2, 1, 3))), Grip(np.array([2]), np.zeros((2, 1, 3)))]}, "path only"),
    ({"start": np.zeros((3, 20, 3)), "grips": [Grip(np.array([1]), np.zeros((2, 1, 3)))] * 2}, "as many of each"),
])  # fmt: skip
def test_bad_input_is_said(changed, sentence):
    body = BODIES["sheet"]
    given = {"grips": 2, **changed}
    with pytest.raises(ValueError, match=sentence):
        simulate(body, fields_of(body), given.pop("grips"), Stepping(), **given)
    with pytest.raises(ValueError, match="by_positions has shape"):
        simulate(body, fields_of(body), 2, Stepping()).gradient(np.zeros(3))


@pytest.mark.parametrize(("name", "value"), [("time_step", 0.0), ("iterations", 0), ("foundation", -1.0)])
def test_steps_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} is"):
        dataclasses.replace(Stepping(), **{name: value})
