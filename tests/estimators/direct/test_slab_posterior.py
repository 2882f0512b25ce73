"""Where a fit of a slab begins, that it goes down, and what surrounds its end: its valley, and a finer mesh."""

import dataclasses
import math

import numpy as np
import pytest

from palpate.data.contact.depth_sequence import SequenceNoise
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_fit import descend, find_tip, follow_valley, moved_by_mesh, slab_start
from palpate.estimators.direct.slab_motion import SlabMotion
from tests.estimators.direct import slabs
from tests.estimators.direct.slabs import COARSE, LOGS, TIMES, VERTEX_PLACE, empty_problem, problem_of, shows, slab_of
from tests.estimators.direct.test_field import MESH, SIGMA


def test_the_tips_middle_is_found() -> None:
    """The depth-change sequence of a tip that presses beside the contact's vertex."""
    place = (VERTEX_PLACE[0] + 1.3, VERTEX_PLACE[1] - 0.8)
    contact, slab = slabs.showing(slabs.contact_of()), slab_of()
    moved = problem_of(contact, slab, place=place).motion.at(LOGS)[0]

    def tried(at: tuple[float, float]) -> SequenceProblem[SlabMotion]:
        found = problem_of(contact, slab, place=at)
        shows(found, moved)
        return found

    found = find_tip(tried, VERTEX_PLACE)
    np.testing.assert_allclose(found, place, atol=0.4)
    np.testing.assert_allclose(find_tip(tried, found), place, atol=0.15)


@pytest.mark.slow
def test_a_start_is_near_and_a_descent_goes_down() -> None:
    problem = problem_of(slabs.seen(LOGS, 1, COARSE), slab_of())
    start = slab_start(problem)
    assert np.abs(start - LOGS).max() < 1.0
    far = LOGS + 0.5 * np.eye(3)[0]
    problem.look(far)
    before = np.square(problem.residual(far)).sum()
    assert np.square(problem.residual(descend(problem, far, problem.motion.box, 1.0))).sum() < before - 20


def test_the_valley_is_as_long_as_inertia_leaves_it() -> None:
    problem = empty_problem()
    for logs, telling in ((slabs.VISCOUS, False), (LOGS, True)):
        shows(problem, problem.motion.at(logs)[0])
        problem.look(logs)
        found = follow_valley(problem, logs, problem.motion.box, 1.0)
        spread = np.sqrt(np.diag(found.covariance))
        assert (spread[0] < 0.5) == telling
        assert abs(found.mean[0] - logs[0]) < 1.5 * spread[0]
        assert found.fall < 0.1
        ratio = np.array([-1.0, 1.0, 0.0])
        assert math.sqrt(ratio @ found.covariance @ ratio) < 0.2  # d/E is known all the same
        # From beside it leads back.
        beside = logs + 0.2
        problem.look(beside)
        again = follow_valley(problem, beside, problem.motion.box, 1.0)
        assert np.abs(again.best - logs)[0] < max(0.1, spread[0])
        assert again.fall > -1e-9


def test_where_chi_square_is_nearly_quadratic_the_valley_is_the_normal_distribution() -> None:
    problem = empty_problem()
    problem.sequence = dataclasses.replace(problem.sequence, noise=SequenceNoise(SIGMA / 30, 0.0))
    problem.model_errors = lambda sunk: np.zeros((*sunk.T.shape, 0))  # ty: ignore[invalid-assignment]  none here
    shows(problem, problem.motion.at(LOGS)[0])
    problem.look(LOGS)
    found = follow_valley(problem, LOGS, problem.motion.box, 1.0)
    normal = np.linalg.inv(problem.information(LOGS))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(normal)), rtol=0.4)


def test_a_finer_mesh_changes_a_fit_by_what_it_shows() -> None:
    problem = empty_problem(slabs.FINE)
    small = LOGS - np.array([0.0, 0.0, 4.0])
    problem.sequence = dataclasses.replace(problem.sequence, noise=SequenceNoise(SIGMA / 50, 0.0))
    shows(problem, problem.motion.at(small)[0])
    problem.look(small)
    np.testing.assert_array_equal(moved_by_mesh(problem, problem.motion, small), 0.0)
    # A mesh that shows what this one shows at other parameters is off by these.
    other = SlabMotion(problem.contact, problem.motion.slab, MESH.pixels[problem.patches.vertices], TIMES)
    step = np.array([0.02, -0.01, 0.015])
    other.by_modes = lambda logs: problem.motion.by_modes(logs - step)  # ty: ignore[invalid-assignment]
    np.testing.assert_allclose(moved_by_mesh(problem, other, small), step, atol=3e-3)
