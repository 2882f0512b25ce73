"""Material of the last training stages: contacts as arrays, the problem without noise, and the motion's slopes."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.data.contact.features import SLOTS, contact_surroundings
from palpate.data.contact.sequence_features import SHAPES
from palpate.data.synthetic.contacts import SimulatedContact, draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.network.draws import sequence_information, smooth_share, without_delays
from palpate.estimators.network.fits import MECHANICS, NOMINAL_NOISE, Fits, motion_slopes, observed_exactly
from palpate.physics.mechanics import theta_of
from palpate.physics.msd.simulation import simulate


@pytest.fixture(scope="module")
def contacts() -> list[SimulatedContact]:
    """Two contacts of one scene."""
    settings = SceneSettings(width=214, height=120, regime="critical")
    return draw_contacts(settings, 1, 2, MECHANICS.time_step)


def simulated(contact: SimulatedContact, logs: np.ndarray) -> np.ndarray:
    """Displacement at the slots, shape [SLOTS, 3], in float64."""
    pressed = contact.interaction
    path = simulate(theta_of(logs), pressed.mesh, pressed.load, MECHANICS, dtype=np.float64)
    return path[pressed.observation.steps(MECHANICS.time_step)]


def test_fits_hold_what_they_are_made_of(contacts: list[SimulatedContact]) -> None:
    pressed = [contact.interaction for contact in contacts]
    around = [contact_surroundings(each) for each in pressed]
    logs = [np.array([-1.0, -3.0, -2.0]), np.array([-2.0, -4.0, -3.0])]
    slopes = [np.full((SLOTS, 3), 0.1), np.full((SLOTS, 3), 0.2)]
    fits = Fits.of(pressed, logs, slopes)
    np.testing.assert_array_equal(fits.logs, logs)
    np.testing.assert_array_equal(fits.slopes, slopes)
    np.testing.assert_array_equal(fits.spacing, [item.spacing for item in around])
    np.testing.assert_array_equal(fits.within, np.zeros(2))
    assert fits.sequences is None
    np.testing.assert_array_equal(Fits.of(pressed, logs, slopes, [0.0, 0.04]).within, [0.0, 0.04])
    assert (fits.motion.dtype, fits.motion.shape, fits.around.shape) == (np.float64, (2, SLOTS), (2, 40))
    for index, contact in enumerate(pressed):
        np.testing.assert_array_equal(fits.around[index], around[index].vector)
        against = -np.einsum("td,d->t", contact.moved.astype(float), contact.direction.astype(float))
        np.testing.assert_allclose(fits.motion[index], against, rtol=1e-6, atol=1e-8)
        assert fits.motion[index].max() > 0.01  # the tissue gives way
        # A slot every 8 steps of 5 ms, under load until the last of the load's steps.
        np.testing.assert_array_equal(fits.loaded[index], 8 * np.arange(1, SLOTS + 1) <= contact.load.factor.sum())
        assert 0 < fits.loaded[index].sum() < SLOTS


def test_the_problem_without_noise_counts_in_a_nominal_one(contacts: list[SimulatedContact]) -> None:
    contact = contacts[0]
    logs = np.log(np.abs(contact.theta)) + np.array([0.2, -0.1, 0.1])
    problem, path = observed_exactly(contact.interaction), simulated(contact, logs)
    assert (problem.sigma, set(problem.noise)) == (NOMINAL_NOISE, {NOMINAL_NOISE})
    residual = (path - contact.interaction.moved) / NOMINAL_NOISE
    np.testing.assert_allclose(problem.residual(logs).reshape(-1, 3), residual, atol=1e-6)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.2)])
def test_slopes_are_those_of_the_simulated_motion(
    contacts: list[SimulatedContact], offset: tuple[float, float, float]
) -> None:
    """Against central differences in φ, in float64, also away from what explains the motion."""
    step = 1e-4
    for contact in contacts:
        logs = np.log(np.abs(contact.theta)) + offset
        found = motion_slopes(observed_exactly(contact.interaction), logs)
        assert found.shape == (SLOTS, 3)
        for column, change in enumerate(step * np.eye(3)):
            difference = (simulated(contact, logs + change) - simulated(contact, logs - change)) / (2 * step)
            np.testing.assert_allclose(found[:, column], -(difference @ contact.interaction.direction), atol=1e-6)
        assert (np.abs(found).max(axis=0) > 1e-3).all()


def test_information_of_a_sequence_is_that_of_all_its_errors_together() -> None:
    """Against the covariance of every amount in every frame, in which the rest surface's error is one for all."""
    generator = np.random.default_rng(0)
    factors = np.tril(generator.normal(size=(1, SLOTS, SHAPES, SHAPES))) + 2 * np.eye(SHAPES)
    slopes, errors = generator.normal(size=(1, SLOTS, SHAPES, 5)), generator.normal(size=(1, SLOTS, SHAPES))
    noise, known = np.array([0.3]), (np.arange(SLOTS) < 9)[None].astype(float)
    information, pull = sequence_information(slopes, factors, errors, noise, known)
    common = np.tile(smooth_share(), (9, 1))
    covariance = common @ common.T
    for frame, factor in enumerate(factors[0, :9]):
        own = np.s_[frame * SHAPES : (frame + 1) * SHAPES]
        covariance[own, own] += factor @ factor.T
    covariance *= 0.3**2
    tangent, error = slopes[0, :9].reshape(-1, 5), errors[0, :9].ravel()
    np.testing.assert_allclose(information[0], tangent.T @ np.linalg.solve(covariance, tangent), rtol=1e-6)
    np.testing.assert_allclose(pull[0], tangent.T @ np.linalg.solve(covariance, error), rtol=1e-6)


def test_unknown_delays_are_left_out_of_the_parabola() -> None:
    """Its minimum over φ, and its curvature there, are those of the parabola in all parameters with the delays' prior:
    about 0, with a variance of 1/3."""
    generator = np.random.default_rng(1)
    slopes, delays = generator.normal(size=(2, 20, 5)), np.array([[0.4, -0.3], [-0.9, 0.0]])
    information, pull = np.einsum("btp,btq->bpq", slopes, slopes), generator.normal(size=(2, 5))
    left, pulled = without_delays(information, pull, delays)
    for index in range(2):
        whole = information[index] + np.diag([0.0, 0.0, 0.0, 3.0, 3.0])
        best = np.linalg.solve(whole, pull[index] - np.concatenate([np.zeros(3), 3.0 * delays[index]]))
        np.testing.assert_allclose(np.linalg.inv(left[index]), np.linalg.inv(whole)[:3, :3], rtol=1e-9)
        np.testing.assert_allclose(np.linalg.solve(left[index], pulled[index]), best[:3], rtol=1e-9)
    same = without_delays(information[:, :3, :3], pull[:, :3], delays[:, :0])
    np.testing.assert_array_equal(same[0], information[:, :3, :3])
    np.testing.assert_array_equal(same[1], pull[:, :3])
