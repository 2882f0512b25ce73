"""The plain version's building blocks."""

import numpy as np
import pytest

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.reference import free_vertices, integrator, spring_force
from tests.physics.sheets import gripped, hand_mesh, loose, position_form_force, pressed, sheet


@pytest.mark.parametrize("mechanics", [Mechanics(), Mechanics(scheme="dkd")])
def test_slopes_of_the_coefficients_are_their_derivatives(mechanics):
    # k_d = 0.01 lies on the series' border (Δt·k_d/m = 0.05).
    damping = np.array([0.002, 0.0099, 0.0101, 0.05, 0.9])
    seen = integrator(damping, mechanics)
    plus, minus = integrator(damping + 1e-6, mechanics), integrator(damping - 1e-6, mechanics)
    np.testing.assert_allclose(seen.keep_slope, (plus.keep - minus.keep) / 2e-6, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(seen.kick_slope, (plus.kick - minus.kick) / 2e-6, rtol=1e-6, atol=1e-8)


def test_exact_damping_by_series_and_quotient_agree_and_start_at_one():
    mechanics = Mechanics(scheme="dkd")
    start = integrator(0.0, mechanics)
    assert (start.keep, start.kick, start.lag) == (1.0, 5.0, 0.0025)
    assert start.kick_slope == pytest.approx(-25.0 / 2)
    below, above = integrator(np.array([0.01 - 1e-12, 0.01 + 1e-12]), mechanics).kick_slope
    assert below == pytest.approx(above, rel=1e-9)


def test_displacement_form_equals_the_textbook_force():
    mesh = sheet(5, 6)
    displacement = 0.003 * np.random.default_rng(0).standard_normal((30, 3))
    vertices = mesh.vertices.astype(np.float64)
    rest = vertices[mesh.springs[:, 1]] - vertices[mesh.springs[:, 0]]
    pull = spring_force(displacement, rest, mesh.springs)
    total = np.zeros((30, 3))
    np.add.at(total, mesh.springs[:, 0], pull)
    np.add.at(total, mesh.springs[:, 1], -pull)
    np.testing.assert_allclose(0.7 * total, position_form_force(displacement, mesh, 0.7), atol=1e-14)


def test_displacement_form_keeps_digits_that_the_textbook_form_loses():
    # A stretch of 1e-8 on a spring of length 1: |d| − |d₀| is 0 in single precision.
    rest = np.array([[1.0, 0.0, 0.0]], np.float32)
    displacement = np.array([[0, 0, 0], [1e-8, 0, 0]], np.float32)
    pull = spring_force(displacement, rest, np.array([[0, 1]]))
    np.testing.assert_allclose(pull, [[1e-8, 0, 0]], rtol=1e-6)


def test_free_vertices():
    mesh = hand_mesh([[0, 0, 1], [1, 0, 1], [2, 0, 1]], [], rim=[True, True, False])
    np.testing.assert_array_equal(free_vertices(mesh, pressed(mesh, 0, 1, 1)), [True, False, True])
    np.testing.assert_array_equal(free_vertices(mesh, gripped(mesh, [2], 1, 1)), [False, False, False])
    np.testing.assert_array_equal(free_vertices(loose(mesh), gripped(mesh, [0], 1, 1)), [False, True, True])
