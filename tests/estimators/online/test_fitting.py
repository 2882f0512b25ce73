"""What one number each says of gripped tissue: found from motion that it made, and used from then on."""

import dataclasses

import numpy as np
import pytest

from palpate.estimators.online.determined import BENDINGS, FOUNDATIONS, Fit, Fitting, uniform
from palpate.estimators.online.objective import Objective
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


def fitted(seen: np.ndarray, moved: float = 1.0) -> Fit | None:
    """To these displacements of the points under the grip's way, or a share of it."""
    objective = Objective(BODY, GRIP.vertices, STEPPING)
    fitting = Fitting(objective, uniform(BODY, STIFFNESS, 0.01), BENDINGS, shown)
    for place, frame in zip(moved * GRIP.displacement, seen, strict=True):
        fitting.step(BODY.rest[GRIP.vertices] + place, frame)
    return fitting.best


@pytest.mark.parametrize(("time_step", "foundation", "bending"), [(1.0, 0.1, 0.3), (4.0, 0.03, 1.0), (8.0, 0.3, 0.3)])
def test_what_made_the_motion_is_found(time_step: float, foundation: float, bending: float) -> None:
    made = Fit(time_step, foundation, bending, np.nan)
    seen = motion_of(made)
    seen[1, 3] = np.nan
    found = fitted(seen)
    assert found[:3] == made[:3]
    assert found.error < 1e-9


def test_the_error_is_a_share_of_the_motion_of_frames_held_out() -> None:
    """What moves half as far again as a sheet does is explained by that sheet, or one that is as good: to a third."""
    made = Fit(1.0, FOUNDATIONS[0], 0.3, np.nan)
    seen = 1.5 * motion_of(made)
    found = fitted(seen)
    off = np.sqrt(np.square(motion_of(found) - seen).sum(axis=2).mean(axis=1))
    assert found.error == pytest.approx((off / np.sqrt(np.square(seen).sum(axis=2).mean(axis=1))).mean(), rel=0.1)
    assert 0.1 < found.error <= 0.34


@pytest.mark.parametrize("moved", [1.0, 1e-3, 0.0])
def test_nothing_is_fitted_to_noise(moved: float) -> None:
    """Some of 60 combinations always explains noise better than what is given, even if none moves: not what it
    says of frames that were held out."""
    for seed in range(4):
        assert fitted(np.random.default_rng(seed).normal(size=(4, 15, 2)), moved) is None


def test_nothing_is_fitted_where_nothing_moves_or_one_frame_alone_tells() -> None:
    moving = motion_of(Fit(4.0, 0.03, 1.0, np.nan))
    moving[:3] = np.nan
    for seen in (np.zeros((4, 15, 2)), np.full((4, 15, 2), np.nan), moving):
        assert fitted(seen) is None


def test_a_volume_moves_alike_in_any_unit() -> None:
    """Stiffness of volumes is the paper's 10¹⁰ where edges are as long as its blocks', and goes with the unit."""
    states = []
    for unit in (1.0, 1000.0):
        body = block((3, 2, 2), 0.0075 * unit)
        pinned = dataclasses.replace(body, pinned=body.rest[:, 0] < 1e-9)
        stiffness = uniform(pinned, 1.0, 0.01)
        grip = Grip(np.array([body.count - 1]), unit * np.array([[[0.004, 0.0, 0.006]]] * 3))
        states.append(simulate(pinned, stiffness, grip, STEPPING).positions[0, -1] / unit)
        assert 1e9 < stiffness.volume * unit**4 < 1e11
    np.testing.assert_allclose(states[0], states[1], atol=1e-6)
