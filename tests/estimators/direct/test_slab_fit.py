"""A slab beneath a film: its derivatives, and what a fit says of a slab, of another damping, and of no slab."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from data.contact.film import DentFilm, FilmNoise
from data.contact.interaction import Interaction
from data.contact.patches import Patches
from estimators.direct import estimator, slab_fit, slab_motion
from estimators.direct.contact_fit import LARGEST_MISFIT
from estimators.direct.estimator import DirectEstimator
from estimators.direct.slab_fit import BLIND, MODEL_ERROR, UNLIKE, SlabProblem, descend, find_tip, fit_slab, slab_start
from estimators.direct.slab_motion import DENSITY, PATCH, SlabMotion
from estimators.estimate import NINETY, Estimate, NoEstimate
from estimators.onset import BETWEEN
from physics.fem import Inertia, Material, find_equilibrium, simulate
from physics.fem.slab import Slab, slab_beneath
from physics.load import Press, held
from physics.observation import Observation
from tests.estimators.direct.test_field import FRAME, MESH, SIDE, SIGMA, SIZE
from tests.estimators.sessions import clip_info

COARSE = (4, 4, 2)
THICKNESS = 0.05
TIMES = FRAME * np.arange(1, 11)
LOAD = 5 * FRAME
VERTEX = int(np.flatnonzero((MESH.pixels == (16, 17)).all(axis=1))[0])
VERTEX_PLACE = (17.0, 16.0)
NORMAL = np.array([0.0, 0.0, -1.0])
THETA = (200.0, 6e4, -0.15)
"""E, d, F."""
LOGS = np.log(np.abs(THETA))
RELAXING = np.array([math.log(200.0), 0.0, math.log(0.3), math.log(0.1)])


def contact_of(released: bool = True) -> Interaction:
    press = Press.at(VERTEX, NORMAL, held(LOAD / 0.005 if released else math.inf, 100))
    return Interaction(MESH, press, Observation.of_point(VERTEX, TIMES, np.zeros((10, 3)), SIGMA), 0.005)


def slab_of(cells: tuple[int, int, int] = COARSE) -> Slab:
    return slab_beneath(MESH, VERTEX, NORMAL, THICKNESS, cells)


def motion_of(released: bool = True, times: np.ndarray = TIMES, **options) -> SlabMotion:
    pixels = MESH.pixels[[VERTEX, VERTEX + 3, VERTEX + 40]]
    return SlabMotion(contact_of(released), slab_of(), pixels, times, **options)


def seen(logs: np.ndarray, seed: int, cells: tuple[int, int, int], relaxing: bool = False) -> Interaction:
    """A contact whose film shows a slab with these parameters, with noise."""
    contact = contact_of()
    patches = Patches(MESH, VERTEX, SIZE)
    motion = SlabMotion(contact, slab_of(cells), MESH.pixels[patches.vertices], TIMES, relaxing=relaxing)
    moved = motion.at(logs)[0]
    assert np.abs(moved).max() > 5 * SIGMA
    change = patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(-1, SIDE, SIDE)
    change = change + np.random.default_rng(seed).normal(0, SIGMA, change.shape)
    return dataclasses.replace(contact, film=DentFilm(TIMES, change.astype(np.float32), FilmNoise(SIGMA, 0.0), SIZE))


def test_the_motion_is_the_bodys_at_the_places() -> None:
    motion, slab = motion_of(), slab_of()
    found = motion.at(LOGS)[0]
    shares = slab.patch(PATCH)
    nodes = np.flatnonzero(shares)
    load = Press(nodes, shares[nodes], NORMAL, held(LOAD / 0.02, 20))
    inertia = Inertia(DENSITY, THETA[1] / DENSITY)
    body = simulate(
        slab.solid, Material("stable_neo_hookean", THETA[0], 0.45), slab.held, load, 0.02, inertia=inertia,
        force=THETA[2],
    )  # fmt: skip
    middle = slab.top[2, 2]
    np.testing.assert_allclose(found[:, 0], body.displacement[2::2, middle], atol=1e-4 * np.abs(found).max())
    assert found[4, 0, 2] > 5 * SIGMA  # it is pressed away from the camera


@pytest.mark.parametrize(("released", "within", "relaxing"), [(True, FRAME, False), (False, 0.0, True)])
def test_derivatives_equal_finite_differences(
    released: bool, within: float, relaxing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slab_motion, "TOLERANCE", 1e-11)
    logs = np.concatenate([RELAXING if relaxing else LOGS, [-0.21, 0.37] if within else []])
    motion = motion_of(released, TIMES[:7], within=within, relaxing=relaxing)
    assert motion.box.shape == (2, len(logs))
    slopes = motion.at(logs)[1]
    for index in range(len(logs)):
        step = 1e-4 * np.eye(len(logs))[index]
        expected = (motion.at(logs + step)[0] - motion.at(logs - step)[0]) / 2e-4
        assert np.abs(slopes[..., index] - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("relaxing", [False, True])
def test_small_motions_are_those_of_the_fine_elements_and_so_are_their_derivatives(relaxing: bool) -> None:
    fine = slab_beneath(MESH, VERTEX, NORMAL, THICKNESS, COARSE, order=2)
    logs = np.concatenate([RELAXING if relaxing else LOGS, [-0.21, 0.37]])
    logs[2] -= 6.0
    motion = motion_of(times=TIMES[:7], within=FRAME, relaxing=relaxing, fine=fine)
    alone = SlabMotion(motion.contact, fine, MESH.pixels[[VERTEX, VERTEX + 3, VERTEX + 40]], TIMES[:7], FRAME, relaxing)
    found, slopes = motion.at(logs)
    expected = alone.linear(logs)
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=2e-3 * size)
    assert np.abs(motion_of(times=TIMES[:7], within=FRAME, relaxing=relaxing).at(logs)[0] - expected).max() > 0.1 * size
    for index in range(len(logs)):
        step = 0.01 * np.eye(len(logs))[index]
        slope = (alone.linear(logs + step) - alone.linear(logs - step)) / 0.02
        assert np.abs(slopes[..., index] - slope).max() < 0.01 * size


def test_the_tips_middle_is_found() -> None:
    """The film of a tip that presses beside the contact's vertex."""
    place = (VERTEX_PLACE[0] + 1.3, VERTEX_PLACE[1] - 0.8)
    contact, slab = contact_of(), slab_of()
    empty = DentFilm(TIMES, np.zeros((10, SIDE, SIDE), np.float32), FilmNoise(SIGMA, 0.0), SIZE)
    contact = dataclasses.replace(contact, film=empty)

    def problem_of(tried: tuple[float, float]) -> SlabProblem:
        def motion(vertices: np.ndarray, times: np.ndarray) -> SlabMotion:
            return SlabMotion(contact, slab, MESH.pixels[vertices], times, place=tried)

        found = SlabProblem(contact, motion)
        moved = SlabMotion(contact, slab, MESH.pixels[found.patches.vertices], TIMES, place=place).at(LOGS)[0]
        found.observed = found.patches.shown(found.patches.sunk(moved), found.patches.covering(moved))
        return found

    found = find_tip(problem_of, VERTEX_PLACE)
    np.testing.assert_allclose(found, place, atol=0.4)
    np.testing.assert_allclose(find_tip(problem_of, found), place, atol=0.15)


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


def coarsely(monkeypatch: pytest.MonkeyPatch, contact: Interaction, cells: tuple[int, int, int]) -> Estimate:
    """A fit by a slab of few elements."""
    monkeypatch.setattr(slab_fit, "slab_beneath", lambda *told, **_: slab_beneath(*told[:4], cells))
    return fit_slab(contact, THICKNESS)[0]


@pytest.mark.slow
def test_a_fit_recovers_what_made_the_film_and_a_start_is_near(monkeypatch: pytest.MonkeyPatch) -> None:
    contact = seen(LOGS, 1, COARSE)
    found = coarsely(monkeypatch, contact, COARSE)
    assert found.explained
    assert not found.refuted
    assert 0.8 < found.misfit < 1.2
    # Besides what the film tells, law and tip are not the tissue's.
    assert np.linalg.eigvalsh(found.covariance - UNLIKE).min() > 0
    low, high = (found.numbers()[f"force_over_stiffness_{end}"] for end in ("low", "high"))
    assert math.log(high / low) / (2 * NINETY) == pytest.approx(0.12, abs=0.02)
    assert (np.abs(np.log(np.abs(found.theta)) - LOGS) < 2 * NINETY * found.log_sd).all()
    ratios = found.numbers()
    assert ratios["damping_over_stiffness"] == pytest.approx(THETA[1] / THETA[0], rel=0.1)
    assert ratios["force_over_stiffness"] == pytest.approx(-THETA[2] / THETA[0], rel=0.05)
    problem = SlabProblem(contact, lambda vertices, times: SlabMotion(contact, slab_of(), MESH.pixels[vertices], times))
    start = slab_start(problem)
    assert np.abs(start - LOGS).max() < 1.0
    far = LOGS + 0.5 * np.eye(3)[0]
    problem.look(far)
    before = np.square(problem.residual(far)).sum()
    assert np.square(problem.residual(descend(problem, far, problem.motion.box, 1.0))).sum() < before - 20


@pytest.mark.slow
def test_a_slab_that_relaxes_is_no_slab_damped_by_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slab_fit, "REFUTED", 1.0)  # its misfit is large as well
    found = coarsely(monkeypatch, seen(RELAXING, 2, COARSE, relaxing=True), COARSE)
    assert found.misfit > LARGEST_MISFIT
    assert found.refuted.startswith("The motion relaxes: a standard linear solid")
    assert not found.explained
    assert (found.verdict, found.determined) == ("undetermined", ())


def test_the_slabs_own_error_is_a_share_of_its_motion_in_rings_and_parts_of_the_time() -> None:
    contact = dataclasses.replace(
        contact_of(), film=DentFilm(TIMES, np.zeros((10, SIDE, SIDE), np.float32), FilmNoise(SIGMA, 0.0), SIZE)
    )
    problem = SlabProblem(contact, lambda vertices, times: SlabMotion(contact, slab_of(), MESH.pixels[vertices], times))
    sunk = np.random.default_rng(1).normal(size=(10, SIDE * SIDE))
    columns = problem.model_errors(sunk)
    assert columns.shape == (SIDE * SIDE, 10, 12)  # three rings, early, held, released and later
    np.testing.assert_allclose(columns.sum(axis=2), MODEL_ERROR * sunk.T)
    assert ((columns != 0).sum(axis=2) == 1).all()
    middle = columns[(SIDE * SIDE) // 2]
    np.testing.assert_array_equal(np.argmax(middle != 0, axis=1), [0, 0, 1, 1, 1, 2, 2, 3, 3, 3])
    # It costs what a scale of everything would tell, and little of what differs from pixel to pixel.
    problem.look(LOGS)
    moved = problem.patches.shown(problem.patches.sunk(problem.motion.at(LOGS)[0]), problem.covering)
    told = float(np.square(problem.whitened(moved)).sum())
    parts = len(np.unique(np.flatnonzero(np.abs(columns).sum(axis=(0, 1)))))
    assert told < parts / MODEL_ERROR**2
    assert told > 0.5 / MODEL_ERROR**2


@pytest.mark.slow
def test_tissue_under_the_tip_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    contact = seen(LOGS, 1, COARSE)
    assert contact.film is not None
    rows, columns = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    near = np.hypot(rows, columns) < BLIND
    other = contact.film.change + np.where(near, np.float32(0.02), np.float32(0))
    spoiled = dataclasses.replace(contact, film=dataclasses.replace(contact.film, change=other))
    one, two = (coarsely(monkeypatch, each, COARSE) for each in (contact, spoiled))
    np.testing.assert_array_equal(one.theta, two.theta)


def test_the_estimator_fits_a_slab_where_a_thickness_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    film = DentFilm(TIMES, np.zeros((10, SIDE, SIDE), np.float32), FilmNoise(SIGMA, 0.0), SIZE)
    contact, asked = dataclasses.replace(contact_of(), film=film), []
    told = Estimate(np.array(THETA), np.eye(3)), (TIMES, TIMES)
    monkeypatch.setattr(estimator, "fit_slab", lambda *given: asked.append(given) or told)
    session = DirectEstimator(BETWEEN, noise=0.002, thickness=THICKNESS).start(clip_info(25.0))
    assert session.fit(contact) is told
    assert asked == [(contact, THICKNESS, 0.04, 0.002)]
    for blind in (contact_of(), dataclasses.replace(contact, film=film.chosen(np.arange(2)))):
        with pytest.raises(NoEstimate, match="A slab needs the depth around the contact"):
            session.fit(blind)
    for wrong in ({"thickness": 0.0}, {"thickness": math.inf}, {"thickness": 0.1, "observation": "contact"}):
        with pytest.raises(ValueError, match=r"give a positive length|leave --observation contact out"):
            DirectEstimator(BETWEEN, **wrong)


def test_a_slab_that_folds_is_refused_in_a_sentence() -> None:
    contact = seen(LOGS, 1, COARSE)
    sideways = dataclasses.replace(contact.load, direction=np.array([1.0, 0.0, 0.0]))
    with pytest.raises(NoEstimate, match="No slab fits under the tissue: below this surface a slab of"):
        fit_slab(dataclasses.replace(contact, load=sideways), THICKNESS)
