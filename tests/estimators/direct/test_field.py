"""The residuals of a whole dent: what errors are expected, how they are weighed, and derivatives by all parameters."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, maximum_filter

from palpate.data.contact.interaction import Interaction
from palpate.data.source.camera import Camera, back_project
from palpate.estimators.direct.contact_fit import recentred
from palpate.estimators.direct.motion import PressMotion
from palpate.estimators.direct.problem import Optimum, dent_problem, find_optimum
from palpate.observations.base import JointLikelihood
from palpate.physics.depth import (
    OUTLIER,
    PARTIAL,
    REACH,
    STILL_NEW,
    WALL,
    DepthSequence,
    SequenceNoise,
    rounding_covariance,
    smooth_errors,
)
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh, contact_normal, grid_mesh
from palpate.physics.observation import Observation
from palpate.physics.patches import Patches

MECHANICS = Mechanics(time_step=0.0025, steps=160, scheme="dkd")
FINER = dataclasses.replace(MECHANICS, time_step=MECHANICS.time_step / 4, steps=4 * MECHANICS.steps)
FRAME = 0.04
TIMES = FRAME * np.arange(1, 9)
LOAD = 4 * FRAME
SIGMA = 1e-3
WITHIN = 0.04
HEIGHT, WIDTH = 33, 35
SIZE, LARGER = (WIDTH, HEIGHT), (3 * WIDTH + 4, 3 * HEIGHT + 4)
"""Sizes of pictures that are the grid, and that are brought to it."""
SIDE = 2 * REACH + 1
PIXELS = SIDE * SIDE
REGIMES = {"under-damped": (0.4, 0.015, -0.05), "critical": (0.3, 0.035, -0.06), "over-damped": (0.2, 0.06, -0.06)}
THETA = REGIMES["critical"]
ENDS = [-3.0, -5.0, -4.0], [0.0, -2.0, -1.0]
"""Ends of what fits may find, in log θ."""


def curved_mesh(hole: tuple[int, int] | None = None) -> Mesh:
    """Tissue that bulges towards the camera, with a spacing near that of real clips, all of it but for one pixel."""
    camera = Camera(fx=185.0, fy=185.0, cx=17.0, cy=16.0, width=WIDTH, height=HEIGHT)
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    depth = 0.5 + 3e-5 * (np.square(row - 16.0) + np.square(column - 17.0)) + 0.002 * np.cos((column - 17) / 6)
    valid = np.ones(depth.shape, bool)
    if hole is not None:
        valid[hole] = False
    return grid_mesh(back_project(depth, camera), valid)


MESH = curved_mesh()


def logs_of(theta: tuple[float, float, float] = THETA, *delays: float) -> np.ndarray:
    """All parameters, the delays in units of WITHIN."""
    return np.concatenate([np.log(np.abs(theta)), delays])


def contact_of(
    theta: tuple[float, float, float] = THETA,
    *delays: float,
    noise: SequenceNoise | None = None,
    size: tuple[int, int] = SIZE,
    released: bool = True,
    mechanics: Mechanics = MECHANICS,
    mesh: Mesh = MESH,
) -> Interaction:
    """A contact whose sequence is exactly what the simulator with these parameters shows; its point doesn't move."""
    factor = held(LOAD / mechanics.time_step if released else mechanics.steps, mechanics.steps)
    vertex = int(np.flatnonzero((mesh.pixels == (16, 17)).all(axis=1))[0])
    press = Press.at(vertex, contact_normal(mesh, vertex), factor)
    seen = Observation.of_point(vertex, TIMES, np.zeros((len(TIMES), 3)), SIGMA)
    still = Interaction(mesh, press, {"point": seen}, mechanics.time_step)
    patches = Patches(mesh, vertex, size)
    moved = PressMotion(still, mechanics, patches.vertices, TIMES, WITHIN if delays else 0.0)
    moved, _ = moved.at(logs_of(theta, *delays))
    change = patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(-1, SIDE, SIDE)
    sequence = DepthSequence(TIMES, change.astype(np.float32), noise or SequenceNoise(SIGMA, 0.0), size)
    return still.having(depth=sequence)


def with_change(contact: Interaction, change: np.ndarray) -> Interaction:
    """Contact with another depth-change sequence [N, S, S] (or [N, P])."""
    change = np.asarray(change, np.float32).reshape(contact.sequence.change.shape)
    return contact.having(depth=dataclasses.replace(contact.sequence, change=change))


def errors_of(seed: int, sigma: float = SIGMA) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, (len(TIMES), SIDE, SIDE))


def noisy(contact: Interaction, errors: np.ndarray) -> Interaction:
    return with_change(contact, contact.sequence.change + errors)


def shorter(contact: Interaction, frames: int = 5) -> Interaction:
    """Its depth-change sequence's first frames: all pixels' covariance is large."""
    return contact.having(depth=contact.sequence.chosen(np.arange(frames)))


def problem_of(
    contact: Interaction, logs: np.ndarray | None = None, *, within: float = 0.0, noise: float | None = None, **look
) -> JointLikelihood:
    """A problem that was looked at."""
    problem = dent_problem(contact, MECHANICS, within, noise)
    problem.look(logs_of() if logs is None else logs, **look)
    return problem


def central_differences(function, logs: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Derivatives of a function of the parameters, the last axis theirs."""
    columns = [(function(logs + change) - function(logs - change)) / (2 * step) for change in step * np.eye(len(logs))]
    return np.stack(columns, axis=-1)


def expected_covariance(
    problem: JointLikelihood, change: np.ndarray, weight: np.ndarray, walls: np.ndarray
) -> np.ndarray:
    """Covariance of all seen pixels' errors, frame by frame, brute force, shape [seen, seen].

    Args:
        problem: looked at.
        change, weight, walls: what the pixels show, how much they count, and their walls, shape [N, P] each.
    """
    noise, (frames, pixels) = problem.first.noise, change.shape
    frame, pixel = (part.ravel() for part in np.indices((frames, pixels)))
    same, alike = pixel[:, None] == pixel, frame[:, None] == frame
    new = noise.correlated_in_time * noise.in_time**2 + noise.total**2 * (1 / weight.ravel() - 1)
    covariance = np.diag(new)
    walls = walls.ravel()
    covariance += 0.5 * same * walls[:, None] * walls + 0.5 * np.diag(walls**2)
    if noise.in_place:
        if noise.in_time < 0.5 * noise.in_place:
            kernel = rounding_covariance(change.T / noise.in_place)
            part = np.sqrt(noise.correlated_in_place) * kernel[pixel[:, None], frame[:, None], frame[None]]
        else:
            part = noise.correlated_in_place * (1 + STILL_NEW * alike)
        covariance += noise.in_place**2 * part * same
    smooth = noise.total * smooth_errors()[pixel]
    blurs = problem.first.patches.blurs(problem.motion.at(logs_of())[0], problem.first.covering).swapaxes(0, 1)
    blurs = blurs.reshape(frames * pixels, -1)
    covariance += smooth @ smooth.T + blurs @ blurs.T
    seen = problem.first.seen.ravel()
    return covariance[np.ix_(seen, seen)]


NOISES = {
    "new": SequenceNoise(SIGMA, 0.0),
    "blurred": SequenceNoise(SIGMA, 0.0, 3.0),
    "still": SequenceNoise(0.8 * SIGMA, 0.6 * SIGMA, 2.0, 4.0),
    "rounded": SequenceNoise(0.1 * SIGMA, SIGMA, 1.0, 2.5),
}


CASES = ("new", LARGER), ("blurred", SIZE), ("still", LARGER), ("rounded", SIZE), ("rounded", LARGER)


@pytest.mark.parametrize(("name", "size"), CASES)
def test_whitened_products_are_those_of_the_inverse_covariance(name: str, size: tuple[int, int]) -> None:
    """Also where a third of the pixels is hidden, and where outliers count less."""
    contact = shorter(contact_of(noise=NOISES[name], size=size))
    generator = np.random.default_rng(0)
    change = contact.sequence.change.reshape(-1, PIXELS).copy()
    change += generator.normal(0, SIGMA, change.shape)
    change[generator.random(change.shape) < 1 / 3] = np.nan
    change[2, 40:60] += 0.02
    contact = with_change(contact, change)
    problem = problem_of(contact, outliers=True)
    shown = problem.first.change(problem.motion.at(logs_of())[0], logs_of())
    steep = problem.first.patches.steepness(problem.motion.at(logs_of())[0])
    assert (steep.max() > 1e-3) == (size == LARGER)
    beside = maximum_filter(np.isnan(contact.sequence.change), (1, 3, 3)).reshape(steep.shape)
    walls = np.where(beside, PARTIAL, WALL) * steep
    apart = np.abs(np.where(problem.first.seen, shown - problem.first.observed, 0))
    apart = apart / np.sqrt(problem.first.noise.total**2 + walls**2)
    weight = np.where(apart > OUTLIER, (OUTLIER / np.maximum(apart, 1e-9)) ** 2, 1.0)
    assert 5 < (weight < 1).sum() < 30
    inverse = np.linalg.inv(expected_covariance(problem, shown, weight, walls))
    values = generator.normal(size=(*shown.shape, 3))
    found = problem.first.whitened(values)
    known = values[problem.first.seen]
    expected = known.T @ inverse @ known
    np.testing.assert_allclose(found.T @ found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(problem.first.whitened(values[..., 1]), found[:, 1], rtol=1e-9, atol=1e-9)


def test_what_is_hidden_does_not_count() -> None:
    contact = contact_of()
    change = contact.sequence.change + errors_of(1)
    change[:3, :, REACH:] = np.nan
    problem = problem_of(with_change(contact, change))
    np.testing.assert_array_equal(problem.first.seen, np.isfinite(change).reshape(len(TIMES), -1))
    residual, information = problem.residual(logs_of()), problem.information(logs_of())
    assert np.isfinite(residual).all()
    values = np.random.default_rng(0).normal(size=change.shape).reshape(len(TIMES), -1)
    other = np.where(problem.first.seen, values, 123.0)
    np.testing.assert_allclose(problem.first.whitened(other), problem.first.whitened(values), atol=1e-9)
    assert residual.shape == problem.first.whitened(values).shape
    whole = problem_of(contact).information(logs_of())
    assert (np.linalg.eigvalsh(whole - information) > 0).all()


def test_an_error_of_the_rest_surface_costs_little() -> None:
    """It costs as much as its normal numbers, where noise of its size in every frame would cost far more."""
    problem = problem_of(contact_of())
    factors = np.random.default_rng(3).normal(size=smooth_errors().shape[1])
    error = np.tile(SIGMA * smooth_errors() @ factors, (len(TIMES), 1))
    costs = np.square(problem.first.whitened(5 * error)).sum()
    assert costs < 25 * factors @ factors
    assert costs < 0.25 * np.square(5 * error / SIGMA).sum()
    turned = 5 * error * np.where(np.arange(len(TIMES)) % 2, 1, -1)[:, None]
    assert np.square(problem.first.whitened(turned)).sum() == pytest.approx(np.square(turned / SIGMA).sum(), rel=1e-6)


@pytest.mark.parametrize(
    ("theta", "noise", "size"),
    [
        (REGIMES["under-damped"], NOISES["new"], SIZE),
        (REGIMES["critical"], NOISES["rounded"], LARGER),
        pytest.param(REGIMES["over-damped"], NOISES["new"], LARGER, marks=pytest.mark.slow),
        pytest.param(REGIMES["over-damped"], NOISES["rounded"], SIZE, marks=pytest.mark.slow),
    ],
)
def test_derivatives_of_motion_and_residual_are_those_of_central_differences(theta, noise, size) -> None:
    """What the pixels show is kept; in larger pictures it turns as at the look."""
    logs = logs_of(theta)
    problem = problem_of(noisy(contact_of(theta, noise=noise, size=size), errors_of(4)), logs, outliers=True)
    for at in (logs, logs + np.array([0.03, -0.04, 0.05])):
        moved, slopes = problem.motion.at(at)
        assert moved.dtype == slopes.dtype == np.float64
        expected = central_differences(lambda values: problem.motion.at(values)[0], at)
        np.testing.assert_allclose(slopes, expected, atol=1e-6 * np.abs(expected).max())
        expected = central_differences(problem.residual, at)
        np.testing.assert_allclose(problem.jacobian(at), expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(problem.information(logs), problem.jacobian(logs).T @ problem.jacobian(logs))


@pytest.mark.parametrize(
    ("theta", "delays"),
    [
        (REGIMES["under-damped"], (-0.29, 0.13)),
        pytest.param(REGIMES["critical"], (-0.29, 0.13), marks=pytest.mark.slow),
        pytest.param(REGIMES["under-damped"], (0.36, -0.57), marks=pytest.mark.slow),
        (REGIMES["over-damped"], (0.36, -0.57)),
    ],
)
def test_derivatives_by_delays_are_those_of_central_differences(theta, delays) -> None:
    """Those by the load's duration come from a difference over half a step: springs that stretch so far bend them."""
    logs = logs_of(theta, *delays)
    problem = problem_of(contact_of(theta), logs, within=WITHIN)
    slopes, expected = problem.motion.at(logs)[1], central_differences(lambda each: problem.motion.at(each)[0], logs)
    for found, wanted in ((slopes, expected), (problem.jacobian(logs), central_differences(problem.residual, logs))):
        assert found.shape[-1] == 5
        apart = np.abs(found - wanted).reshape(-1, 5) / np.abs(wanted).reshape(-1, 5).max(axis=0)
        assert apart[:, :3].max() < 1e-6
        assert apart[:, 3:].max() < 0.06
        assert np.sqrt(np.square(apart[:, 3:]).mean()) < 0.005
    # Until the force ends they are exact.
    under = LOAD + WITHIN * delays[1] - MECHANICS.time_step > TIMES
    np.testing.assert_allclose(slopes[under], expected[under], atol=1e-6 * np.abs(expected[under]).max())


def test_a_release_that_was_not_seen_is_no_parameter() -> None:
    logs = logs_of(THETA, 0.3)
    problem = problem_of(contact_of(THETA, 0.3, released=False), logs, within=WITHIN)
    np.testing.assert_allclose(problem.residual(logs), 0, atol=1e-3)
    expected = central_differences(problem.residual, logs)
    assert expected.shape[1] == 4
    np.testing.assert_allclose(problem.jacobian(logs), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("size", [SIZE, LARGER])
def test_an_exact_sequence_leaves_nothing(size: tuple[int, int]) -> None:
    problem = problem_of(contact_of(size=size))
    np.testing.assert_allclose(problem.residual(logs_of()), 0, atol=1e-4)
    assert problem.misfit(logs_of()) < 1e-4
    # In it, what moves clearly is what sinks by more than three standard deviations at any time.
    largest = np.abs(contact_of(size=size).sequence.change).reshape(len(TIMES), -1).max(axis=0)
    np.testing.assert_array_equal(problem.first.moving, largest > 3 * SIGMA)
    assert 20 < problem.first.moving.sum() < PIXELS


def test_the_misfit_is_that_of_pixels_that_move() -> None:
    contact = noisy(contact_of(), 2 * errors_of(5))
    problem = problem_of(contact)
    seen, exact = contact.sequence.change, contact_of().sequence.change.astype(np.float64)
    moving = (np.abs(exact).max(axis=0) > 3 * SIGMA) | ((np.abs(seen) > 3 * SIGMA).sum(axis=0) >= 3)
    left = (seen - exact)[:, moving]
    assert problem.misfit(logs_of()) == pytest.approx(np.sqrt(np.square(left / SIGMA).mean()), rel=1e-4)
    assert problem.misfit(logs_of()) == pytest.approx(2, rel=0.1)
    assert problem_of(contact, noise=4 * SIGMA).first.noise == SequenceNoise(4 * SIGMA, 0.0)


def test_a_model_that_moves_nothing_does_not_explain_a_dent() -> None:
    contact = contact_of()
    nothing = logs_of() - np.array([0.0, 0.0, 9.0])
    problem = problem_of(contact, nothing)
    seen = contact.sequence.change.reshape(len(TIMES), -1).astype(np.float64)
    moving = (np.abs(seen) > 3 * SIGMA).sum(axis=0) >= 3
    assert moving.any()
    np.testing.assert_array_equal(problem.first.moving, moving)
    assert problem.misfit(nothing) == pytest.approx(np.sqrt(np.square(seen[:, moving] / SIGMA).mean()), rel=0.01)
    assert problem.misfit(nothing) > 3
    # Noise alone is no motion, nor are outliers in a frame or two.
    still = errors_of(5)
    for outliers, moves in ((0, 0), (2, 0), (3, 1)):
        still[2 : 2 + outliers, 0, 0] = 20 * SIGMA
        assert problem_of(with_change(contact, still), nothing).first.moving.sum() == moves


def test_the_error_of_the_steps_is_taken_off() -> None:
    """Depth-change sequences that were made with a quarter of the step are explained by the true parameters."""
    theta = REGIMES["under-damped"]
    logs = logs_of(theta)
    problem = problem_of(contact_of(theta, mechanics=FINER), logs, noise=1e-5)
    assert np.abs(problem.residual(logs)).max() > 0.5
    problem.look(logs, finer=True)
    np.testing.assert_allclose(problem.residual(logs), 0, atol=0.02)
    np.testing.assert_array_equal(problem.offset, problem.motion.finer(logs) - problem.motion.at(logs)[0])


@pytest.mark.parametrize("place", ["middle", *(pytest.param(name, marks=pytest.mark.slow) for name in ("wall", "far"))])
def test_an_outlier_does_not_move_the_fit(place: str) -> None:
    pixel = {"middle": (REACH, REACH), "wall": (REACH + 1, REACH - 2), "far": (1, 12)}[place]
    plain, spoiled, hidden = (errors_of(6) for _ in range(3))
    spoiled[3, *pixel] += 100 * SIGMA
    hidden[3, *pixel] = np.nan

    def fitted(errors: np.ndarray, outliers: bool = True) -> Optimum:
        problem = problem_of(noisy(contact_of(), errors), outliers=outliers)
        return find_optimum(problem, logs_of(), np.array(ENDS))

    found = fitted(spoiled)
    sd = np.sqrt(np.diag(np.linalg.inv(found.information)))
    # It is as if nothing had been observed there.
    assert (np.abs(found.logs - fitted(hidden).logs) < 0.2 * sd).all()
    assert (np.abs(found.logs - fitted(plain).logs) < 0.6 * sd).all()
    if place != "far":
        assert (np.abs(fitted(spoiled, outliers=False).logs - found.logs) > sd).any()


@pytest.mark.slow
def test_fits_are_off_as_their_information_says() -> None:
    """Where noise is blurred, and its size and likeness are told, by less: what is narrow suffers less from it."""
    blurred = SequenceNoise(SIGMA, 0.0, 4 * np.pi)
    for noise, blur, low, high in ((NOISES["new"], 0.0, 0.5, 1.7), (blurred, 1.0, 0.1, 1.3)):
        contact, found = contact_of(noise=noise), []
        for seed in range(16):
            errors = errors_of(100 + seed)
            if blur:
                errors = gaussian_filter(errors, (0, blur, blur), mode="wrap") * np.sqrt(4 * np.pi) * blur
            optimum = find_optimum(problem_of(noisy(contact, errors)), logs_of(), np.array(ENDS))
            apart = optimum.logs - logs_of()
            found.append(apart @ optimum.information @ apart / 3)
        assert low < np.mean(found) < high


def test_linearising_is_remembered() -> None:
    problem = problem_of(contact_of())
    first = problem.linearise(logs_of())
    assert problem.linearise(logs_of()) is first
    problem.look(logs_of() + 0.1)
    assert problem.linearise(logs_of()) is not first


def test_a_contact_is_moved_to_where_its_dent_lies() -> None:
    contact = contact_of()
    assert contact.sequence is not None
    change = np.roll(contact.sequence.change, (1, -2), (1, 2))
    change[:, 0], change[:, :, -2:] = np.nan, np.nan
    astray = contact.having(depth=dataclasses.replace(contact.sequence, change=change))
    problem = dent_problem(astray, MECHANICS)
    problem.look(logs_of())
    found, aside = recentred(problem, logs_of())
    assert aside == (1, -2)
    np.testing.assert_array_equal(MESH.pixels[found.vertex] - MESH.pixels[contact.vertex], aside)
    inner = np.s_[:, :-1, 2:]
    np.testing.assert_array_equal(found.sequence.change[inner], contact.sequence.change[inner])


def test_a_dent_far_from_its_contact_is_found_in_what_is_kept_around() -> None:
    contact, change = contact_of(), contact_of().sequence.change
    around = np.roll(np.pad(change, ((0, 0), (6, 6), (6, 6))), (5, -4), (1, 2))
    astray = dataclasses.replace(contact.sequence, change=around[:, 6:-6, 6:-6], around=around)
    problem = dent_problem(contact.having(depth=astray), MECHANICS)
    problem.look(logs_of())
    found, aside = recentred(problem, logs_of())
    assert aside == (5, -4)
    np.testing.assert_array_equal(MESH.pixels[found.vertex] - MESH.pixels[contact.vertex], aside)
    np.testing.assert_array_equal(found.sequence.change, change)
