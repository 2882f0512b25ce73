"""Training the contact posterior: fits, drawn errors, and that the last stage learns what a fit would say."""

from __future__ import annotations

import numpy as np
import pytest

from data.contact_features import SLOTS
from data.simulated_contacts import SimulatedContact, draw_contacts
from data.synthetic_settings import SceneSettings
from estimators.contact_fits import BOUNDS, LEVEL, MECHANICS, NOISE, REST_SHARE, Fits, draw_errors, draw_known, fit_motion
from estimators.contact_training import Trainer, evaluate, widened


@pytest.fixture(scope="module")
def contacts() -> list[SimulatedContact]:
    """A few contacts of two scenes."""
    settings = SceneSettings(width=214, height=120, regime="critical")
    return [contact for seed in (1, 2) for contact in draw_contacts(settings, seed, 4, MECHANICS.time_step)]


def test_a_fit_explains_its_motion(contacts: list[SimulatedContact]) -> None:
    """From a poor start: θ within the integrators' difference, and slopes that predict the effect of another θ."""
    contact = contacts[0]
    logs, slopes, rms = fit_motion((contact.case, BOUNDS.log_box.mean(axis=0)))
    assert rms < 1e-4
    np.testing.assert_allclose(logs, np.log(np.abs(contact.theta)), atol=0.05)
    assert slopes.shape == (SLOTS, 3)
    assert (slopes[:, 2] > 0).all()  # more force, more motion


def test_drawn_errors_are_as_large_as_said() -> None:
    generator = np.random.default_rng(0)
    motion = np.linspace(0, 0.05, SLOTS)[None].repeat(4000, axis=0)
    error, noise = draw_errors(motion, generator)
    assert (noise.min(), noise.max()) == (pytest.approx(NOISE[0], rel=0.1), pytest.approx(NOISE[1], rel=0.1))
    rounded = noise == LEVEL / np.sqrt(12)
    assert 0.2 < rounded.mean() < 0.3
    scaled = error / noise[:, None]
    for kind in (rounded, ~rounded):
        assert np.sqrt(np.square(scaled[kind]).mean()) == pytest.approx(np.sqrt(1 + REST_SHARE**2), rel=0.02)
    # What a clip's frames share is the error of the rest position, and rounding stays within half a step of it.
    assert scaled[~rounded].mean(axis=1).std() == pytest.approx(np.hypot(REST_SHARE, 1 / np.sqrt(SLOTS)), rel=0.05)
    assert np.abs(error[rounded]).max() < LEVEL / 2 + 5 * REST_SHARE * LEVEL / np.sqrt(12)


def test_windows_are_cut_at_their_end() -> None:
    known = draw_known(2000, np.random.default_rng(0))
    lengths = known.sum(axis=1)
    assert lengths.min() == 2
    assert 0.65 < (lengths == SLOTS).mean() < 0.75
    assert (np.diff(known, axis=1) <= 0).all()


def test_a_wider_noise_level_tells_less(contacts: list[SimulatedContact]) -> None:
    logs = np.log(np.abs(contacts[0].theta))
    case = contacts[0].case
    narrow, wide = (widened(case, logs, blur) for blur in (0.1, 0.2))
    np.testing.assert_allclose(narrow.information, 4 * wide.information, rtol=1e-6)


def test_the_last_stage_learns(contacts: list[SimulatedContact]) -> None:
    """On eight contacts, a hundred steps bring the estimates nearer to what explains the motions."""
    trainer = Trainer(contacts, 0)
    found = [fit_motion((contact.case, np.log(np.abs(contact.theta)))) for contact in contacts]
    logs, slopes, _ = zip(*found, strict=True)
    fits = Fits.of([contact.case for contact in contacts], trainer.surroundings, logs, slopes)
    before = evaluate(trainer.posterior.eval(), contacts, 1e-3, 0)
    trainer.posterior.train()
    trainer.fine(fits, 100, 64, 2e-3, lambda step, loss: None)
    after = evaluate(trainer.posterior.eval(), contacts, 1e-3, 0)
    assert np.mean(after["rmse"]) < 0.5 * np.mean(before["rmse"])
