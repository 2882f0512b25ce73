"""Motions by eigenmodes against those that are simulated step by step."""

import numpy as np
import pytest

from palpate.physics.fem import Inertia, Material, Relaxation, simulate
from palpate.physics.fem.modes import Modes
from palpate.physics.load import Press
from tests.physics.fem.bodies import clamped
from tests.physics.fem.test_dynamics import DENSITY, bar


@pytest.mark.parametrize(
    ("young", "damping", "relaxation"), [(2e5, 0.0, None), (4e4, 30.0, None), (1e5, 0.0, Relaxation(1.5, 0.02))]
)
def test_modes_move_as_the_simulated_body(young: float, damping: float, relaxation: Relaxation | None) -> None:
    body, end = bar()
    course = np.concatenate([np.ones(6), [0.4], np.zeros(8)])
    share, direction, step = np.full(len(end), 1 / len(end)), np.array([0, 0.6, 0.8]), 0.004
    pattern = np.zeros_like(body.rest)
    pattern[end] = share[:, None] * direction
    stiffer = np.linspace(1.0, 3.0, len(body.elements))
    material = Material("linear", stiffer, 0.3)
    modes = Modes(body, material, clamped(body), DENSITY, pattern, 4 / (1e5 * step**2))
    found = modes.follow(young, damping, 0.3 * course, step, relaxation) @ modes.shapes.T
    expected = simulate(
        body, Material("linear", young * stiffer, 0.3), clamped(body), Press(end, share, direction, course), step,
        inertia=Inertia(DENSITY, damping), force=0.3, relaxation=relaxation,
    ).displacement[1:]  # fmt: skip
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-9 * np.abs(expected).max())
