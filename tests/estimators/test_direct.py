"""Direct fits recover what made the motion, and say how well they can know it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from data.collected import CollectedClip
from data.samples import ContactCase
from estimators.direct import DirectSettings, Optimum, combine, fit_clip, fit_contact
from estimators.estimate import NoEstimate
from physics.identifiability import bounds, contact_information, covariance
from physics.mechanics import Mechanics
from physics.mesh import contact_normal
from physics.msd_kernel import simulate
from tests.physics.sheets import sheet

MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd")
SETTINGS = DirectSettings(mechanics=MECHANICS)
STEPS = 16 * np.arange(1, 16) - 1
"""Frames at 25 Hz for 0.6 s."""
LOAD = 128
MESH = sheet(13, 13)
VERTEX = 6 * 13 + 6
DIRECTION = contact_normal(MESH, VERTEX)
NOISE = 2e-4
REGIMES = {
    "under-damped": (0.4, 0.015, -0.05),
    "critical": (0.3, 0.035, -0.05),
    "over-damped": (0.2, 0.06, -0.06),
}


def case_of(theta: tuple[float, float, float], noise: float = NOISE, seed: int | None = None) -> ContactCase:
    """A contact that moved as the simulator says, with noise along the force where there is a seed."""
    mechanics = dataclasses.replace(MECHANICS, steps=int(STEPS.max()) + 1, load_steps=0)
    path = simulate(np.array(theta), MESH, VERTEX, DIRECTION, mechanics, load_steps=LOAD, dtype=np.float64)[STEPS]
    if seed is not None:
        path = path + np.random.default_rng(seed).normal(0, noise, path.shape)
    return ContactCase(
        mesh=MESH,
        vertex=VERTEX,
        direction=DIRECTION.astype(np.float32),
        load_steps=LOAD,
        steps=STEPS,
        displacement=path.astype(np.float32),
        weight=np.ones(len(STEPS), np.float32),
        noise=noise,
    )


@pytest.mark.parametrize("theta", REGIMES.values(), ids=REGIMES)
def test_exact_motion_gives_the_parameters_back(theta: tuple[float, float, float]) -> None:
    estimate = fit_contact(case_of(theta), SETTINGS)
    np.testing.assert_allclose(estimate.theta, theta, rtol=1e-3)
    assert estimate.misfit < 0.01
    assert not estimate.at_bound.any()
    assert estimate.noise == NOISE


def test_the_covariance_is_the_inverse_information_at_the_estimate() -> None:
    theta = REGIMES["critical"]
    estimate = fit_contact(case_of(theta), SETTINGS)
    expected = contact_information(np.array(theta), MESH, VERTEX, DIRECTION, MECHANICS, STEPS, NOISE, load_steps=LOAD)
    np.testing.assert_allclose(estimate.covariance, covariance(expected), rtol=0.02)
    # The verdict's information is that of the least informative point within one standard deviation.
    assert bounds(estimate.information).max() >= bounds(expected).max() * 0.999
    np.testing.assert_allclose(estimate.log_sd, np.sqrt(np.diag(estimate.covariance)))
    # Twice the noise, twice the uncertainty, the same parameters.
    wider = fit_contact(case_of(theta), dataclasses.replace(SETTINGS, noise=2 * NOISE))
    np.testing.assert_allclose(wider.theta, estimate.theta, rtol=1e-3)
    np.testing.assert_allclose(wider.log_sd, 2 * estimate.log_sd, rtol=0.01)
    assert wider.noise == 2 * NOISE


def test_the_covariance_is_the_spread_of_repeated_fits() -> None:
    """16 fits: a standard deviation is known to 1/√32 = 18 %, so a factor of 1.8 is four of those away."""
    theta = np.array(REGIMES["under-damped"])
    estimates = [fit_contact(case_of(tuple(theta), seed=seed), SETTINGS) for seed in range(16)]
    errors = np.log(np.array([estimate.theta for estimate in estimates]) / theta)
    claimed = np.mean([estimate.log_sd for estimate in estimates], axis=0)
    spread = np.sqrt(np.square(errors).mean(axis=0))
    assert (spread < 1.8 * claimed).all()
    assert (spread > claimed / 1.8).all()
    # The noise is drawn in all three coordinates, and the misfit counts their sum.
    assert np.mean([estimate.misfit for estimate in estimates]) == pytest.approx(np.sqrt(3), rel=0.1)


def test_parameters_outside_the_ranges_are_said_to_be_at_their_end() -> None:
    narrow = dataclasses.replace(SETTINGS, stiffness=(0.05, 0.3))
    estimate = fit_contact(case_of(REGIMES["under-damped"]), narrow)
    assert estimate.theta[0] == pytest.approx(0.3, rel=2e-3)
    assert estimate.at_bound.tolist() == [True, False, False]
    assert estimate.misfit > 1.5


def test_no_estimate_says_why() -> None:
    case = case_of(REGIMES["critical"])
    with pytest.raises(NoEstimate, match="noise isn't known; set geometry"):
        fit_contact(dataclasses.replace(case, noise=float("nan")), SETTINGS)
    assert fit_contact(
        dataclasses.replace(case, noise=float("nan")), dataclasses.replace(SETTINGS, noise=NOISE)
    ).misfit == pytest.approx(0, abs=0.01)
    short = dataclasses.replace(case, steps=case.steps[:2], displacement=case.displacement[:2])
    with pytest.raises(NoEstimate, match="followed over 2 frames after its onset; 3 are needed"):
        fit_contact(short, SETTINGS)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"stiffness": (0.0, 1.0)}, "stiffness is .0.0, 1.0.; give two positive numbers"),
        ({"damping": (0.5, 0.1)}, "the lower one first"),
        ({"force": (0.1, float("inf"))}, "force is"),
        ({"noise": 0.0}, "give a positive length"),
    ],
)
def test_impossible_settings_are_refused(wrong: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DirectSettings(**wrong)


class Recorded(CollectedClip):
    """A clip of which only the contact's track is known."""

    def __init__(self, case: ContactCase, followed: int) -> None:
        super().__init__("recorded", 25.0, [])
        frames = len(case.steps) + 1
        self._meshes = [case.mesh] + [None] * (frames - 1)
        self.times = 0.04 * np.arange(frames)
        self.track_start = np.zeros(frames, int)
        self.contact = np.arange(frames) < 8
        self.consecutive = np.arange(frames) < frames - 1
        self.vertex, self.noise = np.full(frames, case.vertex), np.full(frames, case.noise)
        self.normal = np.tile(case.direction, (frames, 1))
        moved = np.concatenate([np.zeros((1, 3)), case.displacement])
        self.track_position = case.mesh.vertices[case.vertex] + moved
        self.track_position[followed + 1 :] = np.nan


def test_a_clips_contacts_are_fitted_by_their_onset() -> None:
    theta = REGIMES["critical"]
    case = case_of(theta)
    found = fit_clip(Recorded(case, len(STEPS)), SETTINGS)
    assert list(found) == [0]
    np.testing.assert_allclose(found[0].theta, theta, rtol=2e-3)
    short = fit_clip(Recorded(case, 2), SETTINGS)
    assert isinstance(short[0], NoEstimate)
    assert fit_clip(Recorded(case, 0), SETTINGS) == {}


def test_optima_are_weighed_by_their_evidence() -> None:
    """Two equally good fits, one eight times as wide in every direction: 512 times as much φ explains the data."""
    narrow = Optimum(np.array([0.0, 0.0, 0.0]), 5.0, 6400 * np.eye(3))
    wide = Optimum(np.array([1.0, 0.0, 0.0]), 5.0, 100 * np.eye(3))
    mean, spread, likeliest = combine([narrow, wide], np.zeros((3, 3)))
    share = 512 / 513
    np.testing.assert_allclose(mean, [share, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(spread[0, 0], share / 100 + (1 - share) / 6400 + share * (1 - share), rtol=1e-6)
    assert likeliest is wide
    mean, spread, likeliest = combine([narrow, wide._replace(cost=30.0)], np.zeros((3, 3)))  # e⁻²⁵·512 is nothing
    np.testing.assert_array_equal(mean, narrow.logs)
    np.testing.assert_allclose(spread, np.eye(3) / 6400)
    assert likeliest is narrow
