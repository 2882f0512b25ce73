"""A slab beneath places of a surface: its motion, its derivatives, what modes and firm regions make of it."""

import math

import numpy as np
import pytest

from palpate.estimators.direct import slab_motion
from palpate.estimators.direct.slab_motion import DENSITY, PATCH, FirmRegion, SlabMotion
from palpate.physics.fem import Inertia, Material, find_equilibrium, simulate
from palpate.physics.fem.slab import slab_beneath
from palpate.physics.load import Press, held
from tests.estimators.direct import slabs
from tests.estimators.direct.slabs import LOGS, NORMAL, THETA, TIMES, VERTEX, contact_of, motion_of, slab_of
from tests.estimators.direct.test_field import FRAME, MESH, SIGMA, central_differences


def test_the_motion_is_the_bodys_at_the_places() -> None:
    motion, slab = motion_of(), slab_of()
    found = motion.at(LOGS)[0]
    shares = slab.patch(PATCH)
    nodes = np.flatnonzero(shares)
    load = Press(nodes, shares[nodes], NORMAL, held(slabs.LOAD / 0.02, 20))
    known = {"inertia": Inertia(DENSITY, THETA[1] / DENSITY), "force": THETA[2]}
    body = simulate(slab.solid, Material("stable_neo_hookean", THETA[0], 0.45), slab.held, load, 0.02, **known)
    middle = slab.top[2, 2]
    np.testing.assert_allclose(found[:, 0], body.displacement[2::2, middle], atol=1e-4 * np.abs(found).max())
    assert found[4, 0, 2] > 5 * SIGMA  # it is pressed away from the camera


@pytest.mark.parametrize(("released", "within", "relaxing"), [(True, FRAME, False), (False, 0.0, True)])
def test_derivatives_equal_finite_differences(released, within, relaxing, monkeypatch) -> None:
    monkeypatch.setattr(slab_motion, "TOLERANCE", 1e-11)
    logs = np.concatenate([slabs.RELAXING if relaxing else LOGS, [-0.21, 0.37] if within else []])
    motion = motion_of(released, TIMES[:7], within=within, relaxing=relaxing)
    assert motion.box.shape == (2, len(logs))
    expected = central_differences(lambda values: motion.at(values)[0], logs, 1e-4).reshape(-1, len(logs))
    off = np.abs(motion.at(logs)[1].reshape(expected.shape) - expected).max(axis=0)
    assert (off < 1e-5 * np.abs(expected).max(axis=0)).all()


@pytest.mark.parametrize("relaxing", [False, True])
def test_small_motions_are_those_of_the_fine_elements_and_so_are_their_derivatives(relaxing: bool) -> None:
    fine = slab_beneath(MESH, VERTEX, NORMAL, slabs.THICKNESS, slabs.COARSE, order=2)
    logs = np.concatenate([slabs.RELAXING if relaxing else LOGS, [-0.21, 0.37]])
    logs[2] -= 6.0
    motion = motion_of(times=TIMES[:7], within=FRAME, relaxing=relaxing, fine=fine)
    alone = SlabMotion(motion.contact, fine, MESH.pixels[[VERTEX, VERTEX + 3, VERTEX + 40]], TIMES[:7], FRAME, relaxing)
    found, slopes = motion.at(logs)
    expected = alone.linear(logs)
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=2e-3 * size)
    assert np.abs(motion_of(times=TIMES[:7], within=FRAME, relaxing=relaxing).at(logs)[0] - expected).max() > 0.1 * size
    assert np.abs(slopes - central_differences(alone.linear, logs, 0.01)).max() < 0.01 * size


def test_slow_presses_end_where_the_body_rests() -> None:
    slab = slab_of()
    contact = contact_of(released=False)
    motion = SlabMotion(contact, slab, MESH.pixels[[VERTEX]], 5.0 * TIMES)
    logs = LOGS - [0, 0, math.log(3)]
    forces = THETA[2] / 3 * slab.patch(PATCH)[:, None] * NORMAL
    rest = find_equilibrium(slab.solid, Material("stable_neo_hookean", THETA[0], 0.45), slab.held, forces=forces)
    np.testing.assert_allclose(motion.at(logs)[0][-1, 0], rest.displacement[slab.top[2, 2]], rtol=0.02, atol=1e-5)


def test_what_cannot_be_followed_is_not_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise slab_motion.NoEquilibrium("no equilibrium.")

    motion = motion_of()
    monkeypatch.setattr(slab_motion, "simulate", fails)
    moved, slopes = motion.at(LOGS)
    assert np.isnan(moved).all()
    assert np.isnan(slopes).all()
    assert slopes.shape == (10, 3, 3, 3)


def test_modes_and_steps_agree_on_small_motions() -> None:
    region = FirmRegion(MESH.vertices[VERTEX].astype(np.float64), 0.05, math.log(3.0))
    for options in ({}, {"within": FRAME}, {"released": False}, {"region": region}):
        motion = motion_of(**options)
        logs = np.concatenate([LOGS, [-0.21, 0.37][: motion.box.shape[1] - 3]])
        expected = motion.linear(logs, motion.region)
        np.testing.assert_allclose(motion.by_modes(logs), expected, atol=1e-9 * np.abs(expected).max())


def test_a_firm_region_is_stiffer_within_its_radius() -> None:
    solid = slab_of((8, 8, 3)).solid
    centre = solid.rest[solid.elements[:, :4]].mean(axis=1)[100]
    factor = FirmRegion(centre, 0.02, math.log(3.0)).stiffer(solid)
    apart = np.linalg.norm(solid.rest[solid.elements[:, :4]].mean(axis=1) - centre, axis=1)
    assert factor[100] == pytest.approx(3.0, rel=2e-3)
    np.testing.assert_allclose(factor[apart > 0.04], 1.0, atol=3e-3)
    assert (np.diff(factor[np.argsort(apart)]) <= 0).all()


def test_a_region_that_holds_the_whole_body_is_another_stiffness() -> None:
    motion, logs = motion_of(), LOGS + np.array([math.log(2.0), 0.0, 0.0])
    whole = FirmRegion(motion.slab.solid.rest.mean(axis=0), 1e3, math.log(2.0))
    small, large = motion.linear(LOGS, whole), motion_of(region=whole).at(LOGS)[0]
    for found, expected in ((small, motion.linear(logs)), (large, motion.at(logs)[0])):
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
