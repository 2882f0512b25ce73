"""Radii of the exact cone and of windows inside it."""

import itertools

import numpy as np
import pytest

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.cone import GRID_EIGENVALUE, INSIDE, Reach, exact_radii, window_radii


def test_exact_radii_are_what_a_walk_there_and_back_allows():
    np.testing.assert_array_equal(exact_radii(7, Reach()), [0, 1, 2, 3, 2, 1, 0])
    np.testing.assert_array_equal(exact_radii(4, Reach()), [0, 1, 1, 0])
    np.testing.assert_array_equal(exact_radii(1, Reach()), [0])
    np.testing.assert_array_equal(exact_radii(6, Reach(loaded=2)), [2, 3, 3, 2, 1, 0])
    np.testing.assert_array_equal(exact_radii(6, Reach(watched=3)), [0, 1, 2, 3, 4, 3])


@pytest.mark.parametrize("reach", [Reach(4), Reach(0, 6), Reach(4, 6)])
def test_windows_of_wide_loads_lie_inside_the_cone_and_around_the_narrow_one(reach):
    mechanics = Mechanics(window_error=1e-4)
    exact = exact_radii(200, reach)
    used, checked = window_radii(0.5, 0.1, mechanics, 200, reach)
    narrow, _ = window_radii(0.5, 0.1, mechanics, 200, Reach())
    assert (checked <= used).all()
    assert (used <= exact).all()
    assert (used >= np.minimum(narrow, exact)).all()
    assert used.max() < 0.6 * exact.max()


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
@pytest.mark.parametrize("theta", [(1.0, 0.0), (0.5, 0.1), (0.05, 0.6)])
def test_windows_lie_inside_the_cone_and_grow_with_accuracy(theta, scheme):
    mechanics = [Mechanics(window_error=error, scheme=scheme) for error in (1e-2, 1e-4, 1e-6)]
    radii = [window_radii(*theta, each, 200, Reach()) for each in mechanics]
    exact = exact_radii(200, Reach())
    for used, checked in radii:
        assert (checked <= used).all()
        assert (used <= exact).all()
    for (_, coarse), (_, fine) in itertools.pairwise(radii):
        assert (coarse <= fine).all()
    assert radii[0][0].max() < 60


@pytest.mark.parametrize(("stiffness", "damping"), [(0.9, 0.0), (0.4, 0.05)])
def test_the_bound_holds_on_a_chain(stiffness, damping):
    # A chain of masses that moves along itself is linear: cut it at each step's radius and compare.
    mechanics, steps = Mechanics(window_error=1e-3), 120
    count = 129
    operator = stiffness * (2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1))
    operator[0, 0] = operator[-1, -1] = stiffness
    distance = np.abs(np.arange(count) - count // 2)

    def contact(radii):
        displacement, velocity = np.zeros(count), np.zeros(count)
        keep = 1 / (1 + mechanics.time_step * damping / mechanics.mass)
        trajectory = []
        for step, radius in enumerate(radii):
            force = -operator @ displacement
            force[count // 2] += 1.0 if step == 0 else 0.0
            inside = distance <= radius
            velocity[inside] = keep * (velocity + mechanics.time_step / mechanics.mass * force)[inside]
            displacement[inside] += mechanics.time_step * velocity[inside]
            trajectory.append(displacement[count // 2])
        return np.array(trajectory)

    used, checked = window_radii(stiffness * 4 / GRID_EIGENVALUE, damping, mechanics, steps, Reach())
    full = contact(np.full(steps, count))
    peak = np.abs(full).max()
    assert np.abs(contact(exact_radii(steps, Reach())) - full).max() < 1e-13 * peak
    # What is lost on the way out and on the way back adds up over the steps.
    assert np.abs(contact(checked) - full).max() < 10 * mechanics.window_error * peak
    assert np.abs(contact(used) - full).max() < 10 * INSIDE * mechanics.window_error * peak


@pytest.mark.parametrize(
    "theta", [(0.0, 0.1), (float("nan"), 0.1), (0.5, float("nan")), (float("inf"), 0.0), (1e9, 0.0)]
)
def test_what_cannot_be_bounded_gets_the_exact_cone(theta):
    used, checked = window_radii(*theta, Mechanics(window_error=1e-3), 200, Reach())
    np.testing.assert_array_equal(used, exact_radii(200, Reach()))
    np.testing.assert_array_equal(checked, exact_radii(200, Reach()))
