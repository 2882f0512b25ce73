"""How far a contact lies from the simulated motion: points and fine pictures, instants known and unknown."""

import dataclasses
import functools

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import motion_in_sequence
from palpate.data.synthetic.contacts import draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.network.fits import MECHANICS
from palpate.estimators.network.misfit import LARGEST_MISFIT, TAIL_PROBABILITY, compared, largest_misfit
from palpate.physics.depth import SequenceNoise
from palpate.physics.load import held
from palpate.physics.mechanics import theta_of
from palpate.physics.msd.simulation import simulate

NOISE = 5e-4
SURE = 1e-8 * np.eye(3)


@functools.cache
def contact_of(within: float) -> tuple[Interaction, np.ndarray]:
    """A contact in a fine picture with noise, and its φ; its press begins and ends so long from the time stamps [s]."""
    settings = SceneSettings(width=214, height=120, regime="critical")
    for seed in range(20):
        drawn = draw_contacts(settings, seed, 1, MECHANICS.time_step, within, sequence=True)
        if drawn and drawn[0].interaction.sequence.size == (854, 480):
            break
    contact, generator = drawn[0].interaction, np.random.default_rng(0)
    change = contact.sequence.change + generator.normal(0, NOISE, contact.sequence.change.shape).astype(np.float32)
    sequence = dataclasses.replace(contact.sequence, change=change, noise=SequenceNoise(NOISE, 0.0))
    observation = contact.observation.moved(contact.moved, NOISE)
    return contact.having(depth=sequence, point=observation), np.log(np.abs(drawn[0].theta))


@pytest.mark.parametrize("within", [0.0, 0.04])
def test_a_fine_picture_is_explained_by_what_its_pixels_show(within: float) -> None:
    """The bottom of the dent, which is narrower than a pixel of the grid, is not visible at its depth."""
    contact, logs = contact_of(within)
    misfit, information, _ = compared(contact, MECHANICS, logs, SURE, within)
    assert 0.5 < misfit < 1.3
    off = np.array([0.0, 0.0, 0.4])
    assert compared(contact, MECHANICS, logs + off, SURE, within)[0] > 2 * misfit
    # What the posterior allows is no misfit.
    assert compared(contact, MECHANICS, logs + off / 4, np.outer(off, off) + SURE, within)[0] < 1.1 * misfit
    # Delays that other tissue within it needs are not those that this tissue's mean suggests.
    other = np.array([0.3, -0.3, 0.3])
    assert compared(contact, MECHANICS, logs + other, np.outer(other, other) + SURE, within)[0] < 1.6 * misfit
    shown = contact.observation.moved(motion_in_sequence(contact), NOISE)
    point = contact.having(point=shown, depth=None)
    unlike, same, _ = compared(point, MECHANICS, logs, SURE, within)
    assert unlike > 1.5 * misfit
    np.testing.assert_allclose(information, same, rtol=1e-5)


@pytest.mark.parametrize(("began", "ended", "left"), [(4, 4, 0.02), (-6, -6, 0.02), (4, 2, 0.25), (0, 5, 0.25)])
def test_a_press_at_other_instants_is_explained_where_they_are_unknown(began: int, ended: int, left: float) -> None:
    """Both delays in steps."""
    contact = contact_of(0.0)[0].having(depth=None)
    logs, steps = np.log([0.4, 0.03, 0.05]), contact.observation.steps(MECHANICS.time_step)
    loaded = round(contact.load_seconds / MECHANICS.time_step) + ended - began
    press = dataclasses.replace(contact.load, factor=held(loaded, MECHANICS.steps + 6))
    path = simulate(theta_of(logs), contact.mesh, press, MECHANICS)
    since = steps - began
    moved = np.where((since >= 0)[:, None], path[np.maximum(since, 0)], 0)
    late = contact.having(point=contact.observation.moved(moved, 0.001))
    stamp, information, _ = compared(late, MECHANICS, logs, SURE, 0.0)
    between, same, _ = compared(late, MECHANICS, logs, SURE, 0.04)
    assert stamp > 1
    assert between < left * stamp
    # What it would tell of a press whose instants are known.
    np.testing.assert_array_equal(information, same)


def test_few_observations_may_lie_farther_from_the_motion_by_chance() -> None:
    """They do as rarely as 25 lie beyond 1.5 σ."""
    assert largest_misfit(25) == pytest.approx(LARGEST_MISFIT, abs=0.005)
    assert largest_misfit(40) == LARGEST_MISFIT
    misfits = np.sqrt(np.square(np.random.default_rng(0).normal(size=(400_000, 5))).mean(axis=1))
    assert np.mean(misfits > largest_misfit(5)) == pytest.approx(TAIL_PROBABILITY, rel=0.25)
