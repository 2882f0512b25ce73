"""Presses of any shape: what their parameters mean, derivatives by them, and when they take the place of a step."""

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import fit_press
from palpate.estimators.direct.motion import PressMotion
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.direct.problem import dent_problem
from palpate.physics.depth import DepthSequence, SequenceNoise
from palpate.physics.load import Press, PressShape
from palpate.physics.mechanics import RECOMMENDED
from palpate.physics.msd.simulation import simulate
from palpate.physics.patches import Patches
from tests.estimators.direct import test_field as dents
from tests.estimators.direct.test_field import MECHANICS, MESH, SIDE, THETA, TIMES, WITHIN, contact_of, logs_of

SHAPE = PressShape(2.7, (0.6, -0.4), 0.05, 0.07, (0.1, -0.2))
CONTACT = contact_of()


def motion_of(within: float = 0.0, contact: Interaction = CONTACT) -> PatchMotion:
    vertices = contact.vertex + np.array([0, 1, -1, 35, 72])
    return PatchMotion(contact, MECHANICS, vertices, TIMES, within)


def pressed(shape: PressShape, theta=THETA, watch: np.ndarray | None = None, late: float = 0.0) -> np.ndarray:
    """Motion at TIMES under a load of a shape that begins so late [s], shape [N, M, 3]."""
    load = shape.press(MESH, CONTACT.vertex, CONTACT.direction, dents.LOAD, MECHANICS.time_step, MECHANICS.steps)
    watch = motion_of().vertices if watch is None else watch
    path = simulate(np.array(theta), MESH, load, MECHANICS, watch=watch, dtype=np.float64)
    return path[np.rint((TIMES - late) / MECHANICS.time_step).astype(int) - 1]


def sequence_of(shape: PressShape, theta=THETA, size: tuple[int, int] = dents.LARGER) -> Interaction:
    """A contact whose depth-change sequence is exactly that of a press of a shape."""
    patches = Patches(MESH, CONTACT.vertex, size)
    moved = pressed(shape, theta=theta, watch=patches.vertices)
    change = patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(-1, SIDE, SIDE)
    sequence = DepthSequence(TIMES, change.astype(np.float32), SequenceNoise(dents.SIGMA, 0.0), size)
    return CONTACT.having(depth=sequence)


@pytest.mark.parametrize("delays", [(), (0.3, -0.2)])
def test_a_shape_survives_its_parameters(delays: tuple[float, ...]) -> None:
    motion = motion_of(WITHIN if delays else 0.0)
    logs = motion.parameters(logs_of(THETA, *delays), SHAPE)
    assert motion.box(RECOMMENDED.log_box).shape == (2, len(logs))
    found, wanted = (np.hstack(dataclasses.astuple(shape)) for shape in (motion.shape(logs), SHAPE))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    seconds = dents.LOAD + WITHIN * (delays[1] - delays[0]) if delays else dents.LOAD
    assert motion.loaded(logs) == pytest.approx(seconds)


def test_the_smallest_shape_moves_as_a_step_on_a_vertex() -> None:
    motion = motion_of()
    plain = PressMotion(CONTACT, MECHANICS, motion.vertices, TIMES)
    values = motion.parameters(logs_of(), PressShape(1.0))
    np.testing.assert_allclose(motion.at(values)[0], plain.at(logs_of())[0], atol=1e-12)
    np.testing.assert_allclose(motion.at(values)[1][..., :3], plain.at(logs_of())[1], atol=1e-12)
    # Which has no shape, and the load that the contact says.
    assert plain.shape(logs_of()) is None
    load = plain.load(logs_of(), MECHANICS.time_step, MECHANICS.steps)
    assert isinstance(load, Press)
    np.testing.assert_allclose(load.factor, CONTACT.load.factor)


@pytest.mark.parametrize(("delays", "late", "off"), [((), 0.0, 1e-9), ((0.5, 0.5), 0.5 * dents.FRAME, 1e-7)])
def test_the_motion_is_that_of_the_shapes_load_and_delayed_the_same_later(delays, late: float, off: float) -> None:
    """Both delays of half a frame, which is a whole number of steps."""
    motion = motion_of(WITHIN if delays else 0.0)
    found = motion.at(motion.parameters(logs_of(THETA, *delays), SHAPE))[0]
    np.testing.assert_allclose(found, pressed(SHAPE, late=late), atol=off)


@pytest.mark.parametrize("delays", [(), (0.31, -0.22)])
def test_derivatives_are_those_of_the_motion(delays: tuple[float, ...]) -> None:
    motion = motion_of(WITHIN if delays else 0.0)
    values = motion.parameters(logs_of(THETA, *delays), SHAPE)
    slopes = motion.at(values)[1]
    assert slopes.shape == (len(TIMES), len(motion.vertices), 3, len(values))
    for column in range(len(values)):
        step = (1e-4 if column < 3 else 0.02) * np.eye(len(values))[column]
        wanted = (motion.at(values + step)[0] - motion.at(values - step)[0]) / (2 * step[column])
        # Differences to one side, by steps of the size of a vertex's share of a patch.
        np.testing.assert_allclose(slopes[..., column], wanted, atol=0.12 * np.abs(wanted).max())


def test_without_a_release_there_is_no_fall() -> None:
    motion = motion_of(contact=contact_of(released=False))
    values = motion.parameters(logs_of(), PressShape(2.0, rise=0.1))
    assert len(values) == 9 == motion.box(RECOMMENDED.log_box).shape[1]
    load = motion.load(values, MECHANICS.time_step, MECHANICS.steps)
    rise = round(0.1 / MECHANICS.time_step)
    np.testing.assert_allclose(load.factor[:rise], (np.arange(rise) + 0.5) / rise)
    assert (load.factor[rise:] == 1).all()
    assert motion.at(values)[1].shape[-1] == 9


def test_a_step_is_fitted_as_one() -> None:
    found = fit_press(contact_of(dents.REGIMES["under-damped"]), MECHANICS, 0.0, None, RECOMMENDED.log_box)
    assert found.course.shape is None


@pytest.mark.acceptance
def test_a_press_of_any_shape_is_found_with_its_tissue() -> None:
    theta = dents.REGIMES["over-damped"]
    found = fit_press(sequence_of(SHAPE, theta), MECHANICS, 0.0, None, RECOMMENDED.log_box)
    assert found.misfit < 0.3
    assert (np.abs(np.log(found.theta / theta)) < 0.5 * found.log_sd).all()
    assert found.course.shape.radius == pytest.approx(SHAPE.radius, rel=0.03)
    np.testing.assert_allclose(found.course.shape.offset, SHAPE.offset, atol=0.05)
    np.testing.assert_allclose(found.course.shape.lean, SHAPE.lean, atol=0.05)
    np.testing.assert_allclose([found.course.shape.rise, found.course.shape.fall], [SHAPE.rise, SHAPE.fall], atol=0.01)


def test_whole_dents_may_lie_aside_and_be_too_deep() -> None:
    """Compared with drawn random errors of that kind; where a pixel of the grid is one of the picture nothing is."""
    random, frames = np.random.default_rng(3), len(TIMES)
    problem = dent_problem(sequence_of(SHAPE), MECHANICS, kind=PatchMotion)
    rows, columns = np.mgrid[:SIDE, :SIDE]
    depth = 0.02 * np.exp(-((rows - 6.5) ** 2 + (columns - 8.0) ** 2) / 18)
    sunk = np.linspace(0.2, 1, frames)[:, None, None] * depth
    found = problem.first._model_errors(sunk.reshape(frames, -1)).transpose(1, 0, 2).reshape(frames * SIDE**2, -1)
    down, across = np.gradient(sunk, axis=(1, 2))
    share = np.sqrt(0.5)
    drawn = np.zeros((4000, frames, SIDE, SIDE))
    for size, shape in ((PatchMotion.astray, down), (PatchMotion.astray, across), (PatchMotion.uneven, sunk)):
        amount = random.normal(0, share, (4000, frames)) + random.normal(0, share, (4000, 1))
        drawn += size * amount[..., None, None] * shape
    deep = int(np.argmax(depth)) + np.array([0, 1, SIDE, 2 * SIDE + 2])
    places = np.concatenate([deep + (frames - 1) * SIDE**2, deep + 3 * SIDE**2])
    expected = np.cov(drawn.reshape(4000, -1)[:, places].T)
    np.testing.assert_allclose(found[places] @ found[places].T, expected, atol=0.1 * np.diag(expected).max())
    coarse = dent_problem(sequence_of(SHAPE, size=dents.SIZE), MECHANICS, kind=PatchMotion)
    assert coarse.first._model_errors(sunk.reshape(frames, -1)).shape[2] == 0
    assert dent_problem(sequence_of(SHAPE), MECHANICS).first._model_errors(sunk.reshape(frames, -1)).shape[2] == 0
