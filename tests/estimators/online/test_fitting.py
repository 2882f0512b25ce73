"""What one number each says of gripped tissue: found from motion that it made, and used from then on."""

import dataclasses

import numpy as np
import pytest

from palpate.estimators.online.determined import BENDINGS, FOUNDATIONS, Fit, fit_motion, uniform
from palpate.physics.load import Grip
from palpate.physics.pbd.simulation import Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness
from tests.physics.pbd.particles import block, sheet

BODY = sheet(6, 5, pinned_rows=1)
STEPPING, STIFFNESS = Stepping(iterations=10), 2.0
PER_METRE = 1e4
"""Pixels: the grip moves by 60."""


def shown(states: np.ndarray) -> np.ndarray:
    return PER_METRE * (states - BODY.rest)[:, 5:20, :2]


GRIP = Grip(np.array([27, 28]), np.multiply.outer([0.2, 0.5, 1.0, 1.0], [[0.006, 0.003, 0.0012]] * 2))


def motion_of(fit: Fit) -> np.ndarray:
    fields = Stiffness(np.full(BODY.count, STIFFNESS), np.full(BODY.count, fit.bending * STIFFNESS))
    return shown(simulate(BODY, fields, GRIP, fit.stepping(STEPPING, STIFFNESS)).positions[0, 1:])


@pytest.mark.parametrize(("time_step", "foundation", "bending"), [(1.0, 0.1, 0.3), (4.0, 0.03, 1.0), (8.0, 0.3, 0.3)])
def test_what_made_the_motion_is_found(time_step: float, foundation: float, bending: float) -> None:
    made = Fit(time_step, foundation, bending, np.nan)
    seen = motion_of(made)
    seen[1, 3] = np.nan
    found = fit_motion(BODY, GRIP, seen, shown, STEPPING, STIFFNESS, BENDINGS)
    assert found[:3] == made[:3]
    assert found.error < 1e-9


def test_the_error_is_a_share_of_the_motion() -> None:
    """Points that run ahead of their grip: no sheet makes them, and none is closer than this."""
    seen = np.tile([300.0, 0.0], (4, 15, 1))
    found = fit_motion(BODY, GRIP, seen, shown, STEPPING, STIFFNESS, BENDINGS)
    off = np.sqrt(np.square(motion_of(found) - seen).sum(axis=2).mean(axis=1)) / 300
    assert found.error == pytest.approx(off.mean())
    assert found.foundation == FOUNDATIONS[0]


def test_nothing_is_fitted_where_nothing_moves() -> None:
    for seen in (np.zeros((4, 15, 2)), np.full((4, 15, 2), np.nan)):
        assert fit_motion(BODY, GRIP, seen, shown, STEPPING, STIFFNESS, BENDINGS) is None


def test_a_volume_moves_alike_in_any_unit() -> None:
    """Of volumes the stiffness is the paper's 10¹⁰ where edges are as long as its blocks', and goes with the unit."""
    states = []
    for unit in (1.0, 1000.0):
        body = block((3, 2, 2), 0.0075 * unit)
        pinned = dataclasses.replace(body, pinned=body.rest[:, 0] < 1e-9)
        stiffness = uniform(pinned, 1.0, 0.01)
        grip = Grip(np.array([body.count - 1]), unit * np.array([[[0.004, 0.0, 0.006]]] * 3))
        states.append(simulate(pinned, stiffness, grip, STEPPING).positions[0, -1] / unit)
        assert 1e9 < stiffness.volume * unit**4 < 1e11
    np.testing.assert_allclose(states[0], states[1], atol=1e-6)
