"""What surrounds the best fit of a slab: its valley, and a finer mesh."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from palpate.data.contact.depth_sequence import SequenceNoise
from palpate.estimators.direct.slab_motion import SlabMotion
from palpate.estimators.direct.slab_posterior import follow_valley, moved_by_mesh
from tests.estimators.direct.slabs import FINE, LOGS, TIMES, VISCOUS, empty_problem, shows
from tests.estimators.direct.test_field import MESH, SIGMA


def test_the_valley_is_as_long_as_inertia_leaves_it() -> None:
    problem = empty_problem()
    for logs, telling in ((VISCOUS, False), (LOGS, True)):
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
    problem = empty_problem(FINE)
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
