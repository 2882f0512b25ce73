"""Material of the last training stages: contacts as arrays, the problem without noise, and the motion's slopes."""

from functools import partial

import numpy as np
import pytest

from palpate.data.contact.features import SLOTS, contact_surroundings
from palpate.data.synthetic.contacts import SimulatedContact, draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.network.fits import (
    MECHANICS,
    NOMINAL_NOISE,
    PARAMETERS,
    Fits,
    Fitted,
    motion_slopes,
    point_problem,
)
from palpate.observations.base import JointLikelihood
from palpate.physics.mechanics import theta_of
from palpate.physics.msd.simulation import simulate
from tests.estimators.direct.test_field import central_differences


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


def exact(contact: SimulatedContact) -> JointLikelihood:
    return point_problem(contact.interaction)


def test_fits_hold_what_they_are_made_of(contacts: list[SimulatedContact]) -> None:
    pressed = [contact.interaction for contact in contacts]
    around = [contact_surroundings(each) for each in pressed]
    parts = {name: [np.full((SLOTS, PARAMETERS), value) for value in (0.1, 0.2)] for name in Fitted._fields}
    fits = Fits.of(pressed, [Fitted(*values) for values in zip(*parts.values(), strict=True)], [0.0, 0.04])
    for name in set(parts) - {"rms"}:
        np.testing.assert_array_equal(getattr(fits, name), parts[name])
    np.testing.assert_array_equal(fits.spacing, [item.spacing for item in around])
    np.testing.assert_array_equal(fits.within, [0.0, 0.04])
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
    problem, path = exact(contact), simulated(contact, logs)
    residual = (path - contact.interaction.moved) / NOMINAL_NOISE
    np.testing.assert_allclose(problem.residual(logs).reshape(-1, 3), residual, atol=1e-6)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.2)])
def test_slopes_are_those_of_the_simulated_motion(contacts, offset) -> None:
    """Against central differences in φ, in float64, also away from what explains the motion."""
    for contact in contacts:
        logs = np.log(np.abs(contact.theta)) + offset
        found = motion_slopes(exact(contact), logs)
        assert found.shape == (SLOTS, 3)
        expected = central_differences(partial(simulated, contact), logs, 1e-4)
        np.testing.assert_allclose(found, -np.einsum("tap,a->tp", expected, contact.interaction.direction), atol=1e-6)
        assert (np.abs(found).max(axis=0) > 1e-3).all()
