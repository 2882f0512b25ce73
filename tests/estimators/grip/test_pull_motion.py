"""Points above a slab that a grip carries along: the body's own motion and reaction, and its rest where it is slow."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.interpolate import BSpline

from palpate.estimators.direct.slab_motion import DENSITY, POISSON
from palpate.estimators.grip.pull_motion import KNOTS, STEPS, PullMotion
from palpate.physics.fem import Inertia, Material, find_equilibrium, simulate
from palpate.physics.fem.slab import Slab, slab_beneath
from palpate.physics.load import Grip
from palpate.physics.mesh import grid_mesh
from tests.physics.fem.test_slab import NORMAL, THICKNESS

SIDE, FOCAL = 121, 150.0
"""Of a grid of square pixels, whose middle is the contact."""
CELL = np.array([4.0, 4.0])
TIMES = 0.04 * np.arange(2, 11)
PLACES = np.array([[230.0, 220.0], [270.0, 250.0], [180.0, 290.0]])
RADIUS = 10.0
LOGS = np.log([150.0, 4e4])


@functools.lru_cache
def slab_of(cells: tuple[int, int, int] = (6, 6, 2)) -> Slab:
    row, column = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    depth = 0.5 + 1e-5 * (row**2 + column * row)
    points = np.stack([column / FOCAL * depth, row / FOCAL * depth, depth], axis=-1)
    mesh = grid_mesh(points, np.ones((SIDE, SIDE), bool))
    contact = int(np.flatnonzero((mesh.pixels == SIDE // 2).all(axis=1))[0])
    return slab_beneath(mesh, contact, NORMAL, THICKNESS, cells, attached=False)


def pull(times: np.ndarray = TIMES) -> PullMotion:
    return PullMotion(slab_of(), CELL, PLACES, RADIUS, times)


def way_of(numbers: np.ndarray, times: np.ndarray, end: float) -> np.ndarray:
    """Where a natural spline of numbers [KNOTS - 1, 2] is at some times, written out with SciPy's, shape [T, 2]."""
    tied = np.vstack([numbers, 2 * numbers[-1] - numbers[-2]])
    spline = BSpline(np.arange(KNOTS + 4.0), tied, 3, extrapolate=False)
    padded = BSpline(np.arange(-3.0, KNOTS + 4), np.vstack([np.zeros((3, 2)), tied]), 3)
    assert spline.k == padded.k
    return padded(np.minimum(times / end * KNOTS, KNOTS - 1e-9))


def test_points_and_force_are_the_bodys_under_the_same_way() -> None:
    motion = pull()
    numbers = 0.01 * np.random.default_rng(4).normal(size=(KNOTS - 1, 2)).cumsum(axis=0)
    moved, held = (part @ numbers.ravel() for part in motion.at(LOGS))
    steps = motion.step * np.arange(1, KNOTS * STEPS + 1)
    assert steps[-1] == pytest.approx(TIMES[-1])
    way = np.pad(way_of(numbers, steps, TIMES[-1]), ((0, 0), (0, 1)))
    grip = Grip(motion.gripped, np.repeat(way[:, None], len(motion.gripped), axis=1))
    slab, inertia = motion.slab, Inertia(DENSITY, np.exp(LOGS[1]) / DENSITY)
    law = Material("linear", float(np.exp(LOGS[0])), POISSON)
    body = simulate(slab.solid, law, slab.held, grip, motion.step, inertia=inertia)
    shown = slab.between(((PLACES + 0.5) / CELL - 0.5)[:, ::-1])
    path = np.stack([shown @ nodes for nodes in body.displacement])
    rest = shown @ slab.solid.rest
    # First order of f x/z in pixels of four to a grid pixel.
    seen = 4 * FOCAL * (path[..., :2] / rest[:, 2:] - rest[:, :2] * path[..., 2:] / rest[:, 2:] ** 2)
    times = np.append(0.0, steps)
    expected = np.stack([[np.interp(TIMES, times, seen[:, i, axis]) for axis in (0, 1)] for i in range(3)])
    np.testing.assert_allclose(moved, expected.transpose(2, 0, 1), atol=1e-6 * np.abs(expected).max())
    force = body.reaction[:, motion.gripped, :2].sum(axis=1) / np.exp(LOGS[0])
    between = np.concatenate([force[:1] / 2, (force[:-1] + force[1:]) / 2, force[-1:]])
    inner = TIMES[-1] > TIMES  # at the end the last step's own counts
    expected = np.stack([np.interp(TIMES, times, between[:, axis]) for axis in (0, 1)], axis=-1)
    np.testing.assert_allclose(held[inner], expected[inner], atol=1e-6 * np.abs(expected).max())


def test_slow_stiff_tissue_is_held_as_at_rest() -> None:
    motion = pull(100 * TIMES)
    numbers = np.zeros((KNOTS - 1, 2))
    numbers[:, 0] = np.linspace(0.0, 0.01, KNOTS - 1)
    moved, held = (part @ numbers.ravel() for part in motion.at(np.log([5e3, 500.0])))
    slab, gripped = motion.slab, np.zeros_like(motion.slab.held)
    gripped[motion.gripped] = True
    way = np.zeros_like(slab.solid.rest)
    way[motion.gripped, 0] = way_of(numbers, 100 * TIMES[-1:], 100 * TIMES[-1])[0, 0]
    rest = find_equilibrium(slab.solid, Material("linear", 1.0, POISSON), slab.held | gripped, motion=way)
    expected = rest.reaction[motion.gripped, :2].sum(axis=0)
    np.testing.assert_allclose(held[-1], expected, atol=0.01 * expected[0])
    assert expected[0] > 0
    shown = slab.between(((PLACES + 0.5) / CELL - 0.5)[:, ::-1]) @ rest.displacement
    np.testing.assert_allclose(moved[-1, :, 0] / 4 / FOCAL * 0.5, shown[:, 0], rtol=0.05, atol=2e-5)


def test_the_contact_moves_with_the_instrument_however_small_the_grip() -> None:
    slab = slab_of()
    motion = PullMotion(slab, CELL, PLACES, 0.0, TIMES)
    np.testing.assert_array_equal(motion.gripped, slab.top[3:4, 3])
