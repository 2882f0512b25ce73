"""A press that began and ended at unknown instants: the delayed motion, its derivatives, what is left to know of θ."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.motion import PressMotion, about_tissue
from palpate.observations.base import JointLikelihood
from palpate.observations.point import PointObservation
from palpate.physics.identifiability import box_information, covariance
from palpate.physics.load import Press, held
from palpate.physics.mechanics import RECOMMENDED, Mechanics
from palpate.physics.msd.simulation import simulate
from tests.estimators.direct import test_estimator as presses
from tests.estimators.direct.test_estimator import LOAD, MECHANICS, MESH, NOISE, REGIMES, STEPS, contact_of

STEP = MECHANICS.time_step
WITHIN = 0.02


def point_problem(
    contact: Interaction, mechanics: Mechanics = MECHANICS, noise: float = NOISE, within: float = WITHIN
) -> JointLikelihood:
    return JointLikelihood([PointObservation(contact, noise)], partial(PressMotion, contact, mechanics, within=within))


def problem_of(theta: tuple[float, float, float]) -> JointLikelihood:
    return point_problem(contact_of(theta))


def path_of(problem: JointLikelihood, values: np.ndarray) -> np.ndarray:
    """Motion at the observations, shape [N, 3]."""
    return problem.motion.at(values)[0][:, 0]


def values_of(theta: tuple[float, float, float], *delays: float) -> np.ndarray:
    """All parameters, the delays in seconds."""
    return np.concatenate([np.log(np.abs(theta)), np.array(delays) / WITHIN])


def moved(theta: tuple[float, float, float], began: int, ended: int, released: bool = True) -> np.ndarray:
    """Motion at STEPS of a press that began and ended so many steps after its stamps, at rest before, shape [M, 3]."""
    steps = int(STEPS.max()) + 10
    press = Press.at(presses.VERTEX, presses.DIRECTION, held(LOAD + ended - began if released else steps, steps))
    path = simulate(np.array(theta), MESH, press, MECHANICS, dtype=np.float64)
    since = STEPS - began
    return np.where((since >= 0)[:, None], path[np.maximum(since, 0)], 0)


@pytest.mark.parametrize("theta", REGIMES.values(), ids=REGIMES)
def test_without_delays_it_is_the_plain_problem(theta: tuple[float, float, float]) -> None:
    plain, delayed = point_problem(contact_of(theta), within=0.0), problem_of(theta)
    values = values_of(theta, 0.0, 0.0) + 0.1 * np.array([1.0, -1.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(delayed.residual(values), plain.residual(values[:3]), atol=1e-6)
    np.testing.assert_allclose(delayed.jacobian(values)[:, :3], plain.jacobian(values[:3]), atol=1e-5)


@pytest.mark.parametrize(("began", "ended"), [(-4, -4), (3, 3), (8, -2), (-3, 5)])
def test_delays_of_whole_steps_shift_load_and_release(began: int, ended: int) -> None:
    theta = REGIMES["under-damped"]
    found = path_of(problem_of(theta), values_of(theta, began * STEP, ended * STEP))
    np.testing.assert_allclose(found, moved(theta, began, ended), atol=1e-7)


@pytest.mark.parametrize(("fps", "load_frames"), [(25.0, 3), (24.0, 3), (60.0, 9)])
def test_the_coarse_motion_is_off_by_less_than_the_noise(fps: float, load_frames: int) -> None:
    """Also where frames, and the release, lie between its steps."""
    mechanics = MECHANICS.matched(1 / fps)
    frame = round(1 / fps / mechanics.time_step)
    contact = contact_of(REGIMES["under-damped"])
    observation = dataclasses.replace(contact.observation, times=np.arange(1, len(STEPS) + 1) / fps)
    load = dataclasses.replace(contact.load, factor=held(frame * load_frames, mechanics.steps))
    contact = Interaction(contact.mesh, load, {"point": observation}, mechanics.time_step)
    problem = point_problem(contact, mechanics, 1e-3, 1 / fps)
    for delays in ((0.0, 0.0), (0.37, -0.61), (-0.9, 0.2)):
        values = np.concatenate([np.log(np.abs(REGIMES["under-damped"])), delays])
        apart = problem.motion.coarse(values)[:, 0] - path_of(problem, values)
        assert np.abs(apart).max() < 0.3e-3


def test_a_press_that_was_not_seen_to_end_goes_on() -> None:
    """Begun earlier than its stamp it has lasted longer; when it ends is no parameter."""
    theta = REGIMES["critical"]
    contact = contact_of(theta)
    load = dataclasses.replace(contact.load, factor=np.ones(MECHANICS.steps))
    problem = point_problem(dataclasses.replace(contact, load=load))
    assert problem.motion.box(RECOMMENDED.log_box).shape == (2, 4)
    found = path_of(problem, values_of(theta, -WITHIN))
    np.testing.assert_allclose(found, moved(theta, -round(WITHIN / STEP), 0, released=False), atol=1e-7)
    assert problem.jacobian(values_of(theta, -WITHIN)).shape == (3 * len(STEPS), 4)


def test_a_release_in_the_last_frame_was_seen() -> None:
    theta, under = REGIMES["critical"], STEPS < LOAD
    problem = point_problem(contact_of(theta).observed(under))
    values = values_of(theta, -3 * STEP, -3 * STEP)
    np.testing.assert_allclose(path_of(problem, values), moved(theta, -3, -3)[under], atol=1e-7)


def test_what_other_unknowns_leave_is_the_block_of_the_covariance() -> None:
    generator = np.random.default_rng(0)
    slopes = generator.normal(size=(20, 5))
    ends = np.array([1.0, 2.0, 1.0, 0.5, 0.5])
    information, prior = slopes.T @ slopes, box_information(np.array([-ends, ends]))
    weighed = information.copy()
    weighed[3:, 3:] += prior[3:, 3:]
    np.testing.assert_allclose(covariance(about_tissue(information, prior)), np.linalg.inv(weighed)[:3, :3], rtol=1e-9)
    np.testing.assert_array_equal(about_tissue(information[:3, :3], prior[:3, :3]), information[:3, :3])
