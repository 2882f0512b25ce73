"""Motion: energy balance, frequency, order, and a standard linear solid's closed forms."""

import numpy as np
import pytest

from palpate.physics.fem import LAWS, Inertia, Material, Motion, Relaxation, Solid, box, make_solid, simulate
from palpate.physics.fem.dynamics import Direction
from palpate.physics.fem.laws import respond
from palpate.physics.load import Grip, Press
from tests.physics.fem.bodies import block, clamped

YOUNG, DENSITY = 2e5, 1000.0


def bar() -> tuple[Solid, np.ndarray]:
    """A cantilever of 10 cm, and the nodes of its end."""
    body = make_solid(*box((0.1, 0.03, 0.03), (6, 2, 2)))
    return body, np.flatnonzero(np.isclose(body.rest[:, 0], 0.1))


def pushed(
    law: str, step: float, damping: float = 0.0, relaxation: Relaxation | None = None, seconds: float = 0.12
) -> Motion:
    body, end = bar()
    count = round(seconds / step)
    load = Press(end, np.full(len(end), 1 / len(end)), np.array([0, 0, 1.0]), np.ones(count))
    inertia = Inertia(DENSITY, damping)
    return simulate(
        body, Material(law, YOUNG, 0.3), clamped(body), load, step, inertia=inertia, force=0.3, relaxation=relaxation
    )


def energies(body: Solid, material: Material, motion: Motion, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Of motion and of the law at the beginning and after each step, shape [T + 1] each [J]."""
    kinetic, elastic, velocity = [], [], np.zeros_like(body.rest)
    previous = np.concatenate([motion.displacement[:1], motion.displacement[:-1]])
    for before, after in zip(previous, motion.displacement, strict=True):
        velocity = 2 / step * (after - before) - velocity
        kinetic.append(DENSITY / 2 * velocity.ravel() @ (body.mass @ velocity.ravel()))
        elastic.append((body.weights * respond(material.law, body.deformation(after), *material.lame).energy).sum())
    return np.array(kinetic), np.array(elastic)


def balance(law: str, step: float, damping: float = 0.0, relaxation: Relaxation | None = None) -> np.ndarray:
    """Energies of motion and of the law, what damping has taken, and the force's work, shape [4, T + 1] [J]."""
    (body, end), motion = bar(), pushed(law, step, damping, relaxation)
    path = np.diff(motion.displacement, axis=0, prepend=0)
    lost = [damping / step * DENSITY * way.ravel() @ (body.mass @ way.ravel()) for way in path]
    work = 0.3 * path[:, end, 2].mean(axis=1)
    work[1] /= 2  # the force rises from 0 within the first step
    return np.array([*energies(body, Material(law, YOUNG, 0.3), motion, step), np.cumsum(lost), np.cumsum(work)])


def imbalance(kinetic: np.ndarray, elastic: np.ndarray, damped: np.ndarray, work: np.ndarray) -> float:
    return float(np.abs(kinetic + elastic + damped - work).max() / work.max())


@pytest.mark.parametrize("damping", [0.0, 4.0])
def test_energy_balances_to_rounding_where_the_law_is_linear(damping: float) -> None:
    found = balance("linear", 0.01, damping)
    assert imbalance(*found) < 1e-12
    assert (np.diff(found[2]) >= 0).all()
    assert (found[2, -1] > 0) == (damping > 0)


@pytest.mark.slow
@pytest.mark.parametrize("law", [law for law in LAWS if law != "linear"])
def test_energy_balances_at_second_order_elsewhere(law: str) -> None:
    coarse, fine = (imbalance(*balance(law, step, 2.0)) for step in (0.004, 0.001))
    assert fine < 3e-5
    assert np.log(coarse / fine) / np.log(4) > 1.6, (coarse, fine)


def test_a_relaxing_branch_only_takes_energy() -> None:
    kinetic, elastic, _, work = balance("linear", 0.005, relaxation=Relaxation(0.5, 0.05))
    taken = work - kinetic - elastic
    assert taken[1:].min() > 0
    assert taken[-1] > 0.05 * work[-1]


def test_a_bar_let_go_rings_at_its_frequency_and_loses_its_energy_at_the_rate_of_damping() -> None:
    """Euler–Bernoulli's first frequency, a little less for shear; energy falls as e^(-αt) over whole periods."""
    body = make_solid(*box((0.2, 0.02, 0.02), (10, 1, 1)), order=2)
    held, end = clamped(body), np.isclose(body.rest[:, 0], 0.2)
    material, damping, step = Material("linear", 8e6, 0.3), 3.0, 0.002
    drawn = (np.arange(335) < 35).astype(float)  # by half a period, so that it is let go at rest
    load = Press(np.flatnonzero(end), np.full(end.sum(), 1 / end.sum()), np.array([0, 0, 1.0]), drawn)
    motion = simulate(body, material, held, load, step, inertia=Inertia(DENSITY, damping), force=1e-4)
    times, tip = step * np.arange(336), motion.displacement[:, end, 2].mean(axis=1)
    crossings = np.flatnonzero(np.diff(np.sign(tip)) * (times[1:] > step * 35))
    moments = times[crossings] - step * tip[crossings] / (tip[crossings + 1] - tip[crossings])
    found = (len(moments) - 1) / 2 / (moments[-1] - moments[0])
    exact = 3.5160 / (2 * np.pi) * np.sqrt(8e6 * 0.02**2 / 12 / (DENSITY * 0.2**4))
    assert found == pytest.approx(exact, rel=0.02)
    energy = sum(energies(body, material, motion, step))
    first, last = (np.searchsorted(times, moments[k]) for k in (0, 4))
    assert np.log(energy[first] / energy[last]) / (moments[4] - moments[0]) == pytest.approx(damping, rel=0.03)


NONE = Inertia(1e-20)
"""Hardly any inertia."""


def stretched(law: str, strain: np.ndarray, step: float, relaxation: Relaxation) -> np.ndarray:
    """Force on a unit cube whose length follows a strain, its sides free to shrink, the mean of every step [N]."""
    body = block(1)
    ends = np.isclose(body.rest[:, 0], 1)
    held = np.zeros(body.rest.shape, bool)
    for axis in range(3):
        held[np.isclose(body.rest[:, axis], 0), axis] = True
    # A grip prescribes all three components: with ν = 0 the sides stay where they are.
    path = np.zeros((len(strain), ends.sum(), 3))
    path[..., 0] = strain[:, None]
    load = Grip(np.flatnonzero(ends), path)
    motion = simulate(body, Material(law, 10.0, 0.0), held, load, step, inertia=NONE, relaxation=relaxation)
    return motion.reaction[:, ends, 0].sum(axis=1)


@pytest.mark.parametrize("law", LAWS)
def test_a_held_strain_relaxes_as_in_closed_form(law: str) -> None:
    """Ramp to ε within t₀, then held: E ε (1 + γ τ/t₀ (1 - e^(-t₀/τ)) e^(-(t - t₀)/τ)), at any step."""
    strain, ramp, relaxation, step = 1e-7, 0.2, Relaxation(0.8, 0.5), 0.1
    times = step * (1 + np.arange(20))
    found = stretched(law, strain * np.minimum(times / ramp, 1), step, relaxation)
    tau = relaxation.time
    rising = times / ramp + relaxation.ratio * tau / ramp * (1 - np.exp(-times / tau))
    left = relaxation.ratio * tau / ramp * (1 - np.exp(-ramp / tau)) * np.exp(-(times - ramp) / tau)
    expected = 10 * strain * np.where(times <= ramp + 1e-9, rising, 1 + left)
    np.testing.assert_allclose(found, (expected + np.append(0, expected[:-1])) / 2, rtol=1e-6)


def test_large_strain_relaxes_to_the_law_alone() -> None:
    strain = np.full(60, 0.4)
    found = stretched("stable_neo_hookean", strain, 0.1, Relaxation(0.8, 0.3))
    alone = stretched("stable_neo_hookean", strain, 0.1, Relaxation(1e-12, 0.3))
    assert found[0] > 1.3 * alone[0]
    assert found[-1] == pytest.approx(alone[-1], rel=1e-7)


def test_bad_numbers_are_refused() -> None:
    body, end = bar()
    load = Press.at(int(end[0]), np.array([0, 0, 1.0]), np.ones(1))
    with pytest.raises(ValueError, match="time step of 0"):
        simulate(body, Material("linear", 1.0, 0.3), clamped(body), load, 0.0, inertia=NONE)
    for make in (
        lambda: Relaxation(0.0, 1.0),
        lambda: Relaxation(1.0, -1.0),
        lambda: Inertia(0.0),
        lambda: Inertia(1.0, -1.0),
    ):
        with pytest.raises(ValueError, match="positive"):
            make()
    told = (body, Material("linear", YOUNG, 0.3), clamped(body), load, 0.01)
    with pytest.raises(ValueError, match="relaxation that there is none of"):
        simulate(*told, inertia=NONE, directions=[Direction(ratio=1.0)])


DIRECTIONS = ("young", "damping", "force", "ratio", "time", "course")


def pressed(law: str, logs: np.ndarray, relaxing: bool, directions: bool) -> Motion:
    """A small block under a press that moves it by a tenth, by log E, log α, log F, log γ, log τ and the load's end."""
    body = block()
    young, damping, force, ratio, time = np.exp(logs[:5]) * (2e4, 4.0, 4000.0, 0.8, 0.03)
    top = np.flatnonzero(np.isclose(body.rest[:, 2], body.rest[:, 2].max()))
    factor = np.array([1, 1, 1, 1, 0.5 + logs[5], 0, 0, 0])
    load = Press(top, np.full(len(top), 1 / len(top)), np.array([0.6, 0, -0.8]), factor)
    pattern = np.zeros_like(body.rest)
    pattern[top] = force / len(top) * load.direction
    along = [Direction(young=1.0), Direction(damping=damping), Direction(pattern=pattern, course=factor)]
    along += [Direction(ratio=ratio), Direction(time=time)] if relaxing else []
    along += [Direction(pattern=pattern, course=np.eye(8)[4])]
    told = (body, Material(law, young, 0.4), clamped(body), load, 0.01)
    how = {"inertia": Inertia(DENSITY, damping), "relaxation": Relaxation(ratio, time) if relaxing else None}
    return simulate(*told, **how, force=force, directions=along if directions else ())


@pytest.mark.parametrize("relaxing", [False, True])
@pytest.mark.parametrize("law", LAWS)
def test_derivatives_of_a_motion_equal_finite_differences(law: str, relaxing: bool) -> None:
    found = pressed(law, np.zeros(6), relaxing, True)
    assert np.abs(found.displacement).max() > 0.1
    chosen = range(6) if relaxing else (0, 1, 2, 5)
    for index, parameter in enumerate(chosen):
        step = 1e-4 * np.eye(6)[parameter]
        more, less = (pressed(law, sign * step, relaxing, False).displacement for sign in (1, -1))
        slope = (more - less) / 2e-4
        off = np.abs(found.slopes[..., index] - slope).max() / np.abs(slope).max()
        assert off < 1e-6, DIRECTIONS[parameter]
