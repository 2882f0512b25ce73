"""What surrounds the best fit of a slab: its valley, a finer mesh, firm regions."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from data.contact.film import DentFilm, FilmNoise
from estimators.direct.slab_fit import SlabProblem, descend, with_firm_regions
from estimators.direct.slab_motion import FirmRegion, SlabMotion
from estimators.direct.slab_posterior import WAYS, Firm, averaged, firm_regions, follow_valley, moved_by_mesh
from tests.estimators.direct.test_field import FRAME, MESH, SIDE, SIGMA, SIZE
from tests.estimators.direct.test_slab_fit import LOGS, THICKNESS, TIMES, VERTEX, contact_of, motion_of, slab_of

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
    motion = motion_of()
    logs = LOGS + np.array([math.log(2.0), 0.0, 0.0])
    whole = FirmRegion(motion.slab.solid.rest.mean(axis=0), 1e3, math.log(2.0))
    for found, expected in (
        (motion.linear(LOGS, whole), motion.linear(logs)),
        (motion_of(region=whole).at(LOGS)[0], motion.at(logs)[0]),
    ):
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


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
def test_a_firm_region_is_noticed_where_it_lies_and_taken_into_account() -> None:
    problem = problem_of(FINE)
    moved = problem.motion.at(LOGS)[0]
    shows(problem, moved)
    problem.look(LOGS)
    regions = [region for region, _ in firm_regions(problem, LOGS, THICKNESS, 1.0)]
    assert len({tuple(region.centre) for region in regions}) == 2 * WAYS

    def with_regions(beginnings: list[tuple[FirmRegion, np.ndarray]], alike: np.ndarray) -> list[Firm]:
        contact, slab, pixels = problem.contact, problem.motion.slab, MESH.pixels

        def problem_with(region: FirmRegion) -> SlabProblem:
            found = SlabProblem(contact, lambda v, times: SlabMotion(contact, slab, pixels[v], times, region=region))
            found.observed = problem.observed
            return found

        return [Firm(*fit) for fit in with_firm_regions(problem, alike, beginnings, problem_with)]

    assert averaged(with_regions(firm_regions(problem, LOGS, THICKNESS, 1.0), LOGS))[0] < 0.5
    true = regions[0]
    firm = SlabMotion(problem.contact, problem.motion.slab, MESH.pixels[problem.patches.vertices], TIMES, region=true)
    shows(problem, firm.at(LOGS)[0], moved)
    problem.look(LOGS)
    alike = descend(problem, LOGS, problem.motion.box, 0.01)
    problem.look(alike)
    found = firm_regions(problem, alike, THICKNESS, 1.0)
    beside = np.linalg.norm(found[0][0].centre - true.centre)
    assert beside < true.radius  # how far aside it lies hardly shows
    sure, shift, covariance = averaged(with_regions(found, alike))
    assert sure > 0.9
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    # What it makes of the ratios goes, mostly.
    for ratio in ([-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]):
        before = float((alike - LOGS) @ ratio)
        assert abs(before + shift @ ratio) < 0.5 * abs(before)


def test_posteriors_are_averaged_by_their_evidence() -> None:
    shift = np.array([-0.2, 0.1, 0.3])
    # A half beforehand for none, a quarter for each fit: 1/2 to 3/4.
    sure, mean, covariance = averaged([Firm(math.log(3.0), shift), Firm(-math.inf, 9 * shift)])
    assert sure == pytest.approx(0.6)
    np.testing.assert_allclose(mean, 0.6 * shift)
    np.testing.assert_allclose(covariance, 0.24 * np.outer(shift, shift))
    assert averaged([])[0] == 0.0
    np.testing.assert_array_equal(averaged([])[1], 0.0)
