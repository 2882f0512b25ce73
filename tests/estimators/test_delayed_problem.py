"""A press that began at an unknown instant: the delayed motion, its derivatives, and what is left to know of θ."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from estimators.contact_problem import ContactProblem
from estimators.delayed_problem import DelayedProblem, about_tissue
from physics.identifiability import box_information, covariance
from physics.msd_kernel import simulate
from tests.estimators.test_direct import DIRECTION, LOAD, MECHANICS, MESH, NOISE, REGIMES, STEPS, VERTEX, case_of

STEP = MECHANICS.time_step
WITHIN = 0.02


def problem_of(theta: tuple[float, float, float], within: float = WITHIN) -> DelayedProblem:
    return DelayedProblem(case_of(theta), MECHANICS, NOISE, within)


def logs_of(theta: tuple[float, float, float], delay: float) -> np.ndarray:
    return np.append(np.log(np.abs(theta)), delay)


@pytest.mark.parametrize("theta", REGIMES.values(), ids=REGIMES)
def test_without_a_delay_it_is_the_plain_problem(theta: tuple[float, float, float]) -> None:
    plain, delayed = ContactProblem(case_of(theta), MECHANICS, NOISE), problem_of(theta)
    logs = logs_of(theta, 0.0) + 0.1 * np.array([1.0, -1.0, 1.0, 0.0])
    np.testing.assert_allclose(delayed.residual(logs), plain.residual(logs[:3]), atol=1e-6)
    np.testing.assert_allclose(delayed.jacobian(logs)[:, :3], plain.jacobian(logs[:3]), atol=1e-5)
    np.testing.assert_array_equal(delayed.theta(logs), plain.theta(logs[:3]))
    np.testing.assert_allclose(delayed.coarse_paths(logs[None]), plain.coarse_paths(logs[None, :3]), atol=0.1 * NOISE)


@pytest.mark.parametrize("shift", [-4, 3, 8])
def test_a_delay_of_whole_steps_shifts_the_motion(shift: int) -> None:
    """Against the simulator at the shifted steps: at rest before the press, and load and release are both delayed."""
    theta = REGIMES["under-damped"]
    mechanics = dataclasses.replace(MECHANICS, steps=int(STEPS.max()) + 10, load_steps=0)
    path = simulate(np.array(theta), MESH, VERTEX, DIRECTION, mechanics, load_steps=LOAD, dtype=np.float64)
    since = STEPS - shift
    expected = np.where((since >= 0)[:, None], path[np.maximum(since, 0)], 0)
    found = problem_of(theta).path(logs_of(theta, shift * STEP))
    np.testing.assert_allclose(found, expected, atol=1e-7)


@pytest.mark.parametrize("delay", [-0.0113, 0.0071])
def test_derivatives_are_those_of_the_residual(delay: float) -> None:
    problem, logs = problem_of(REGIMES["critical"]), logs_of(REGIMES["critical"], delay)
    for column, size in enumerate((1e-4, 1e-4, 1e-4, 1e-6)):
        step = size * np.eye(4)[column]
        slope = (problem.residual(logs + step) - problem.residual(logs - step)) / (2 * size)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(problem.jacobian(logs)[:, column], slope, atol=2e-3 * scale)


def test_a_press_that_was_not_seen_to_end_goes_on() -> None:
    """Begun earlier than its stamp it has lasted longer; the load is no part of what was seen."""
    theta = REGIMES["critical"]
    case = case_of(theta)
    under = case.steps < LOAD
    parts = {name: getattr(case, name)[under] for name in ("steps", "displacement", "weight")}
    pressed = dataclasses.replace(case, **parts, load_steps=int(case.steps[under].max()) + 1)
    earlier = DelayedProblem(pressed, MECHANICS, NOISE, WITHIN).path(logs_of(theta, -WITHIN))
    mechanics = dataclasses.replace(MECHANICS, steps=int(pressed.steps.max()) + 10, load_steps=0)
    path = simulate(np.array(theta), MESH, VERTEX, DIRECTION, mechanics, load_steps=mechanics.steps, dtype=np.float64)
    np.testing.assert_allclose(earlier, path[pressed.steps + round(WITHIN / STEP)], atol=1e-7)


def test_starts_are_at_the_delays_that_suit_them() -> None:
    theta, delay = REGIMES["under-damped"], 0.01
    case = case_of(theta)
    late = dataclasses.replace(case, steps=case.steps + round(delay / STEP))
    problem = DelayedProblem(late, MECHANICS, NOISE, WITHIN)
    candidates = np.array([logs_of(theta, 0.0), logs_of((0.06, 0.3, -0.05), 0.0)])
    low, high = candidates.min(axis=0) - 1, candidates.max(axis=0) + 1
    best = problem.best_starts(candidates, problem.coarse_paths(candidates), low, high)[0]
    np.testing.assert_allclose(best, logs_of(theta, delay), atol=2e-3)


def test_what_another_unknown_leaves_is_the_block_of_the_covariance() -> None:
    generator = np.random.default_rng(0)
    slopes = generator.normal(size=(20, 4))
    information, prior = slopes.T @ slopes, box_information(np.array([[-1.0, -2, -1, -0.5], [1, 2, 1, 0.5]]))
    weighed = information.copy()
    weighed[3, 3] += prior[3, 3]
    np.testing.assert_allclose(covariance(about_tissue(information, prior)), np.linalg.inv(weighed)[:3, :3], rtol=1e-9)
    np.testing.assert_array_equal(about_tissue(information[:3, :3], prior[:3, :3]), information[:3, :3])
