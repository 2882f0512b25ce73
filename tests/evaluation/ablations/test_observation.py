"""What an observation's row sees, its shared material, and that a row learns."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from data.contact.features import FEATURES, SLOTS
from data.synthetic.contacts import SimulatedContact, draw_contacts
from data.synthetic.settings import SceneSettings
from estimators.network.fits import BOUNDS, MECHANICS, SCENES, draw_observed
from evaluation.ablations.observation import Material, around_truth, label_loss, seen_slots, train_row
from models.posterior import ContactPosterior
from physics.mechanics import theta_of
from physics.msd.simulation import simulate

LOADED = (np.arange(SLOTS) < np.array([[7], [0], [SLOTS]])).astype(float)


@pytest.fixture(scope="module")
def contacts() -> list[SimulatedContact]:
    settings = SceneSettings(width=214, height=120, regime="critical")
    return [contact for seed in (1, 2) for contact in draw_contacts(settings, seed, 4, MECHANICS.time_step)]


@pytest.mark.parametrize("frames", [1, 2, 4, 8, 16, 25])
def test_a_number_sees_the_first_frames(frames: int) -> None:
    known = seen_slots(str(frames), LOADED)
    assert known.shape == LOADED.shape
    assert known.sum(axis=1).tolist() == [frames] * 3
    assert known[:, :frames].all()


def test_release_sees_the_last_frame_under_load_and_final_the_last_of_all() -> None:
    release, final = seen_slots("release", LOADED), seen_slots("final", LOADED)
    assert release.argmax(axis=1).tolist() == [6, 0, SLOTS - 1]
    assert final.argmax(axis=1).tolist() == [SLOTS - 1] * 3
    assert release.sum(axis=1).tolist() == final.sum(axis=1).tolist() == [1.0] * 3


def test_the_supervised_row_sees_all_frames() -> None:
    np.testing.assert_array_equal(seen_slots("supervised", LOADED), np.ones_like(LOADED))


def test_the_supervised_loss_is_the_normal_density_of_the_truth(contacts: list[SimulatedContact]) -> None:
    torch.manual_seed(0)
    drawn = draw_observed(around_truth(contacts), 16, np.random.default_rng(0))
    posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box), width=16, blocks=1)
    mean, factor = (values.detach().double().numpy() for values in posterior(torch.from_numpy(drawn.features)))
    densities = [
        multivariate_normal.logpdf(logs, at, lower @ lower.T)
        for logs, at, lower in zip(drawn.logs, mean, factor, strict=True)
    ]
    expected = -np.mean(densities) - 1.5 * np.log(2 * np.pi)
    assert float(label_loss(posterior, drawn).detach()) == pytest.approx(expected, abs=1e-5)


@pytest.mark.slow
def test_the_supervised_row_alone_is_told_the_truth(contacts: list[SimulatedContact]) -> None:
    """Labels of other tissue, k_s half as stiff again, move what it answers, and no other row's numbers."""
    right = around_truth(contacts)
    wrong = dataclasses.replace(right, logs=right.logs + np.log([1.5, 1.0, 1.0]))
    (taught, misled), (blind, same) = (
        [train_row(row, Material(right, labels, right), 80, 0) for labels in (right, wrong)]
        for row in ("supervised", "25")
    )
    assert blind == same
    assert taught["over_bound_stiffness"] < misled["over_bound_stiffness"]
    assert taught["constant_over_bound_stiffness"] == blind["constant_over_bound_stiffness"]


def test_slopes_around_the_truth_are_the_simulator_s(contacts: list[SimulatedContact]) -> None:
    """Against central differences in log θ, in float64."""
    held, contact, step = around_truth(contacts[:1]), contacts[0].interaction, 1e-4

    def pressed(logs: np.ndarray) -> np.ndarray:
        path = simulate(theta_of(logs), contact.mesh, contact.load, MECHANICS, dtype=np.float64)
        return -(path[contact.observation.steps(MECHANICS.time_step)] @ contact.direction)

    for column, offset in enumerate(step * np.eye(3)):
        slope = (pressed(held.logs[0] + offset) - pressed(held.logs[0] - offset)) / (2 * step)
        np.testing.assert_allclose(held.slopes[0, :, column], slope, atol=1e-5)
    np.testing.assert_allclose(pressed(held.logs[0]), held.motion[0], atol=2e-4)
    assert held.loaded.sum() == round(contact.load_seconds * SCENES.fps)


def test_features_and_likelihood_know_the_seen_slots_alone(contacts: list[SimulatedContact]) -> None:
    fits = around_truth(contacts)
    drawn = draw_observed(fits, 64, np.random.default_rng(0), lambda loaded: seen_slots("4", loaded))
    assert not drawn.features[:, 4:SLOTS].any()
    assert drawn.features[:, 2 * SLOTS : 3 * SLOTS].sum(axis=1).tolist() == [4.0] * 64
    one = draw_observed(fits, 64, np.random.default_rng(0), lambda loaded: seen_slots("final", loaded))
    values = np.linalg.eigvalsh(one.information)
    assert (values[:, 1] < 1e-9 * values[:, 2]).all()  # one number tells one direction


def test_seeing_more_frames_leaves_a_smaller_error(contacts: list[SimulatedContact]) -> None:
    """On eight contacts, a row learns what its frames tell, and the same seed gives the same numbers."""
    material = Material(*[around_truth(contacts)] * 3)
    many, few = (train_row(row, material, 60, 0) for row in ("25", "1"))
    assert many["judged"] == few["judged"] > 0
    assert many["rms_force_damping"] < few["rms_force_damping"]
    assert many["constant_over_bound_damping"] == few["constant_over_bound_damping"]
    assert train_row("1", material, 60, 0) == few
