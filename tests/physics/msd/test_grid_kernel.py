"""The compiled stencil against steps computed by hand, and at the edge of single precision."""

import numpy as np
import pytest

from palpate.physics import jit
from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.grid_kernel import specialised
from palpate.physics.msd.simulation import simulate_sensitivities
from tests.physics.sheets import hand_mesh, pressed, sheet, whole_field

pytestmark = pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")

X = np.array([1.0, 0.0, 0.0])


def test_two_steps_by_hand():
    # Two vertices 0.1 apart on x, the second held; F pulls the first away along −x in the first step only.
    mesh = hand_mesh([[0, 0, 1], [0.1, 0, 1]], [[0, 1]], rim=[False, True])
    stiffness, damping, force = 0.5, 0.1, -0.2
    a = 1 / (1 + 0.005 * damping / 0.001)
    b = 5 * a
    first_velocity = b * force
    first = 0.005 * first_velocity
    second_velocity = a * first_velocity + b * stiffness * -first
    second = first + 0.005 * second_velocity
    slope = -5 * a**2  # da/dk_d; db/dk_d = 5·slope
    by_damping = 0.005 * 5 * slope * force
    by_damping_velocity = (
        slope * first_velocity + a * 5 * slope * force - 5 * slope * stiffness * first - b * stiffness * by_damping
    )
    theta = (stiffness, damping, force)
    trajectory, jacobian = simulate_sensitivities(theta, mesh, pressed(mesh, 0, 1, 2, X), Mechanics(), dtype=np.float64)
    np.testing.assert_allclose(trajectory[:, 0], [first, second], rtol=1e-12)
    np.testing.assert_allclose(jacobian[0, 0], [0, by_damping, first / force], rtol=1e-12, atol=1e-16)
    expected = [0.005 * b * -first, by_damping + 0.005 * by_damping_velocity, second / force]
    np.testing.assert_allclose(jacobian[1, 0], expected, rtol=1e-12)
    assert not trajectory[:, 1:].any()
    assert not jacobian[:, 1:].any()


def test_nothing_denormal_is_left_ahead_of_the_wave():
    # On a flat sheet a normal load spreads by squares of squares: without flushing, most of it would be denormal.
    flat = sheet(40, 40)
    flat.vertices[:, 2] = 0.5
    load = pressed(flat, 20 * 40 + 20, 50, 60, np.array([0.0, 0.0, 1.0]))
    field = whole_field((0.5, 0.1, -0.1), flat, load, Mechanics())
    size = np.abs(field[field != 0])
    assert size.min() > np.finfo(np.float32).tiny
    assert (field[-1] == 0).mean() < 0.9


def test_code_is_compiled_once_for_a_row_length():
    assert specialised(80, True) is specialised(80, True)
    assert specialised(80, True) is not specialised(80, False)
