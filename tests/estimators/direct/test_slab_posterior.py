"""What surrounds the best fit of a slab: its valley, a finer mesh, firm regions."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from data.contact.film import DentFilm, FilmNoise
from estimators.direct import slab_motion
from estimators.direct.slab_fit import SlabProblem
from estimators.direct.slab_motion import SlabMotion
from estimators.direct.slab_posterior import WAYS, Place, averaged, firm_places, follow_valley, moved_by_mesh
from tests.estimators.direct.test_field import FRAME, MESH, SIDE, SIGMA, SIZE
from tests.estimators.direct.test_slab_fit import LOGS, THICKNESS, TIMES, contact_of, motion_of, slab_of

VISCOUS = np.log([100.0, 3e5, 0.08])
FINE = (8, 8, 3)


def problem_of(cells: tuple[int, int, int] = (4, 4, 2)) -> SlabProblem:
    film = DentFilm(TIMES, np.zeros((10, SIDE, SIDE), np.float32), FilmNoise(SIGMA, 0.0), SIZE)
    contact = dataclasses.replace(contact_of(), film=film)
    slab = slab_of(cells)
    return SlabProblem(contact, lambda vertices, times: SlabMotion(contact, slab, MESH.pixels[vertices], times))


def shows(problem: SlabProblem, moved: np.ndarray, near: np.ndarray | None = None) -> None:
    """Let the film show a motion without noise; pixels show the patches that they do at a motion `near`."""
    covering = problem.patches.covering(moved if near is None else near)
    problem.observed = problem.patches.shown(problem.patches.sunk(moved), covering)


def test_modes_and_steps_agree_on_small_motions() -> None:
    for options in ({}, {"within": FRAME}, {"released": False}):
        motion = motion_of(**options)
        logs = np.concatenate([LOGS, [-0.21, 0.37][: motion.box.shape[1] - 3]])
        expected = motion.linear(logs)
        np.testing.assert_allclose(motion.by_modes(logs), expected, atol=1e-9 * np.abs(expected).max())


def test_firmer_elements_move_less() -> None:
    motion, stiffer = motion_of(), np.full(len(motion_of().slab.solid.elements), 2.0)
    logs = LOGS + np.array([math.log(2.0), 0.0, 0.0])
    np.testing.assert_allclose(motion.linear(LOGS, stiffer), motion.linear(logs), rtol=1e-9, atol=1e-15)


def test_the_valley_is_as_long_as_inertia_leaves_it() -> None:
    problem = problem_of()
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
    problem = problem_of()
    problem.film = dataclasses.replace(problem.film, noise=FilmNoise(SIGMA / 30, 0.0))
    problem.model_errors = lambda sunk: np.zeros((*sunk.T.shape, 0))  # ty: ignore[invalid-assignment]  none here
    shows(problem, problem.motion.at(LOGS)[0])
    problem.look(LOGS)
    found = follow_valley(problem, LOGS, problem.motion.box, 1.0)
    normal = np.linalg.inv(problem.information(LOGS))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(normal)), rtol=0.4)


def test_a_finer_mesh_changes_a_fit_by_what_it_shows() -> None:
    problem = problem_of(FINE)
    small = LOGS - np.array([0.0, 0.0, 4.0])
    problem.film = dataclasses.replace(problem.film, noise=FilmNoise(SIGMA / 50, 0.0))
    shows(problem, problem.motion.at(small)[0])
    problem.look(small)
    np.testing.assert_array_equal(moved_by_mesh(problem, problem.motion, small), 0.0)
    # A mesh that shows what this one shows at other parameters is off by these.
    other = SlabMotion(problem.contact, problem.motion.slab, MESH.pixels[problem.patches.vertices], TIMES)
    step = np.array([0.02, -0.01, 0.015])
    other.by_modes = lambda logs: problem.motion.by_modes(logs - step)  # ty: ignore[invalid-assignment]
    np.testing.assert_allclose(moved_by_mesh(problem, other, small), step, atol=3e-3)


@pytest.mark.slow
def test_a_firm_region_is_noticed_where_it_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(FINE)
    logs = LOGS
    moved = problem.motion.at(logs)[0]
    shows(problem, moved)
    problem.look(logs)
    alike = firm_places(problem, logs, THICKNESS, 1.0)
    assert averaged(alike)[0] < 0.5
    fields = []
    linear = slab_motion.SlabMotion.linear

    def seen(self: SlabMotion, logs: np.ndarray, stiffer: np.ndarray | float = 1.0) -> np.ndarray:
        fields.append(stiffer)
        return linear(self, logs, stiffer)

    with monkeypatch.context() as patch:
        patch.setattr(slab_motion.SlabMotion, "linear", seen)
        firm_places(problem, logs, THICKNESS, 1.0)
    place = 11
    shows(problem, moved + problem.motion.linear(logs, fields[1 + place]) - problem.motion.linear(logs), moved)
    problem.look(logs)
    found = firm_places(problem, logs, THICKNESS, 1.0)
    best = int(np.argmax([item.gain for item in found]))
    assert best % WAYS == place % WAYS  # how far aside it lies hardly shows
    assert found[best].gain < found[place].gain + 15
    np.testing.assert_allclose(found[place].shift, 0.0, atol=0.05)
    sure, shift, covariance = averaged(found)
    assert sure > averaged(alike)[0]
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    np.testing.assert_allclose(shift, 0.0, atol=0.2)


def test_posteriors_are_averaged_by_their_evidence() -> None:
    shift, more = np.array([-0.2, 0.1, 0.3]), 0.01 * np.eye(3)
    places = [Place(math.log(3.0), shift, more), Place(-math.inf, 9 * shift, more)]
    # A half beforehand for none, a quarter for each place: 1/2 to 3/4.
    sure, mean, covariance = averaged(places)
    assert sure == pytest.approx(0.6)
    np.testing.assert_allclose(mean, 0.6 * shift)
    np.testing.assert_allclose(covariance, 0.24 * np.outer(shift, shift) + 0.6 * more)
