"""Direct fits recover what made the motion, and say how well they can know it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from data.collected import CollectedClip
from data.samples import ContactCase
from estimators import contact_optima, direct, tracking_noise
from estimators.contact_optima import Optimum, combine
from estimators.direct import ContactProblem, DirectSettings, cautious, fit_clip, fit_contact
from estimators.estimate import NoEstimate
from estimators.oblique import HIDDEN_ERROR
from estimators.posterior_sampling import Draws, sample_posterior
from estimators.tracking_noise import log_likelihoods
from physics.identifiability import bounds, contact_information, covariance
from physics.mechanics import Mechanics
from physics.mesh import Mesh, contact_normal
from physics.msd_kernel import simulate
from tests.physics.sheets import sheet

MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd")
SETTINGS = DirectSettings(mechanics=MECHANICS)
STEPS = 16 * np.arange(1, 16) - 1
"""Frames at 25 Hz for 0.6 s."""
LOAD = 128
VERTEX = 6 * 13 + 6


def facing_sheet() -> tuple[Mesh, np.ndarray]:
    """A sheet that lies so that its normal at the contact is the line of sight, and that normal."""
    mesh = sheet(13, 13)
    normal = contact_normal(mesh, VERTEX)
    vertices = (mesh.vertices - mesh.vertices[VERTEX] - 0.5 * normal).astype(np.float32)
    return dataclasses.replace(mesh, vertices=vertices), normal


MESH, DIRECTION = facing_sheet()
NOISE = 2e-4
REGIMES = {
    "under-damped": (0.4, 0.015, -0.05),
    "critical": (0.3, 0.035, -0.05),
    "over-damped": (0.2, 0.06, -0.06),
}


def case_of(
    theta: tuple[float, float, float],
    noise: float = NOISE,
    seed: int | None = None,
    delays: tuple[int, int] = (0, 0),
) -> ContactCase:
    """A contact that moved as the simulator says, with noise where there is a seed.

    Its load began, and ended, `delays` steps later than it says.
    """
    began, ended = delays
    mechanics = dataclasses.replace(MECHANICS, steps=int(STEPS.max()) + 1 + max(-began, 0), load_steps=0)
    load = LOAD + ended - began
    moved = simulate(np.array(theta), MESH, VERTEX, DIRECTION, mechanics, load_steps=load, dtype=np.float64)
    path = np.where((began <= STEPS)[:, None], moved[np.maximum(STEPS - began, 0)], 0)
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
    # The posterior is not quite symmetric, so its mean lies a little beside its mode.
    assert (np.abs(np.log(estimate.theta / theta)) < 0.25 * estimate.log_sd).all()
    assert estimate.misfit < 0.01
    assert not estimate.at_bound.any()
    assert estimate.noise == NOISE


def test_the_covariance_is_near_the_inverse_information_where_little_is_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rest position and rounding are unknown besides, a tenth or two of the variance; sampling adds as much."""
    monkeypatch.setattr(tracking_noise, "SIGMA_FREEDOM", 1e9)
    theta = REGIMES["critical"]
    estimate = fit_contact(case_of(theta), SETTINGS)
    expected = contact_information(np.array(theta), MESH, VERTEX, DIRECTION, MECHANICS, STEPS, NOISE, load_steps=LOAD)
    np.testing.assert_allclose(estimate.covariance, covariance(expected), rtol=0.3)
    np.testing.assert_allclose(estimate.log_sd, np.sqrt(np.diag(estimate.covariance)))
    np.testing.assert_allclose(bounds(estimate.information), bounds(expected), rtol=0.05)
    # Twice the noise, twice the uncertainty.
    wider = fit_contact(case_of(theta), dataclasses.replace(SETTINGS, noise=2 * NOISE))
    np.testing.assert_allclose(wider.log_sd, 2 * estimate.log_sd, rtol=0.15)
    assert wider.noise == 2 * NOISE


def test_the_delay_of_a_press_is_fitted_beside_its_parameters() -> None:
    """Half a frame of 0.02 s late: as if it had begun at its stamp it is far off, and surer of that than it may be."""
    true, within = np.array(REGIMES["critical"]), 0.02
    case = case_of(REGIMES["critical"])
    late = dataclasses.replace(case, steps=case.steps + round(0.01 / SETTINGS.mechanics.time_step))
    stamp, known = fit_contact(late, SETTINGS), fit_contact(case, SETTINGS)
    found = fit_contact(late, dataclasses.replace(SETTINGS, onset_within=within))
    assert found.misfit < 0.1 < stamp.misfit
    errors = [np.abs(np.log(item.theta / true)) / item.log_sd for item in (stamp, found)]
    assert (errors[0] > 3).any()
    assert (errors[1] < 1).all()
    # Less is known of it than if the beginning were, and its bounds are what there would be then.
    assert (found.log_sd > known.log_sd).all()
    np.testing.assert_allclose(bounds(found.information), bounds(known.information), rtol=0.1)
    assert found.covariance.shape == (3, 3)
    assert (stamp.delays, found.delays) == ((), pytest.approx((0.01, 0.01), abs=1.5e-3))
    assert not found.delays_at_end
    assert (bounds(found.decisive) > bounds(known.decisive)).all()


def test_a_motion_that_the_model_cannot_explain_widens_the_posterior() -> None:
    """Noise eight times as large as it is said to be."""
    theta = REGIMES["critical"]
    good, bad = (fit_contact(case_of(theta, noise, seed=2), SETTINGS).log_sd for noise in (NOISE, 8 * NOISE))
    told = dataclasses.replace(SETTINGS, noise=NOISE)
    unsuspecting = fit_contact(case_of(theta, 8 * NOISE, seed=2), told)
    assert unsuspecting.misfit > 5
    assert (unsuspecting.log_sd > 1.9 * good).all()
    assert (unsuspecting.log_sd < 1.5 * bad).all()


def test_a_press_aslant_to_the_line_of_sight_widens_the_posterior() -> None:
    """The same motion of the same sheet, moved aside: its dent could hide its own bottom."""
    theta = REGIMES["critical"]
    case = case_of(theta)
    aside = 0.5 * np.tan(np.deg2rad(12)) * np.linalg.svd(DIRECTION[None])[2][1]
    aslant = dataclasses.replace(MESH, vertices=(MESH.vertices + aside).astype(np.float32))
    facing, found = (fit_contact(each, SETTINGS) for each in (case, dataclasses.replace(case, mesh=aslant)))
    assert facing.view_angle < 0.01
    assert found.view_angle == pytest.approx(12, abs=0.01)
    assert (facing.verdict, found.verdict) == ("determined", "undetermined")
    np.testing.assert_allclose(np.log(found.theta / facing.theta), 0, atol=0.01)
    low, high = SETTINGS.box
    scaled = found.information * (NOISE / HIDDEN_ERROR) ** 2
    added = np.linalg.inv(scaled + np.diag(12 / (high - low) ** 2))
    np.testing.assert_allclose(found.covariance, facing.covariance + added, atol=1e-3)


def test_errors_are_as_large_as_claimed() -> None:
    """θ from the prior, noise of the assumed kind: the mean square of error over standard deviation is 1.

    16 contacts with three parameters that hang together: known to about √(2/16) = 35 %.
    """
    settings = dataclasses.replace(SETTINGS, stiffness=(0.1, 0.5), damping=(0.01, 0.15), force=(0.02, 0.1))
    low, high = settings.box
    generator = np.random.default_rng(5)
    ratios, misfits = [], []
    for seed in range(16):
        logs = generator.uniform(low, high)
        noise = 1e-3
        estimate = fit_contact(case_of(tuple(ContactProblem.theta(logs)), noise, seed=seed), settings)
        ratios.append((np.log(np.abs(estimate.theta)) - logs) / estimate.log_sd)
        misfits.append(estimate.misfit)
    squares = np.square(ratios).mean(axis=0)
    assert (squares > 0.35).all()
    assert (squares < 1.9).all()
    # The noise is drawn in all three coordinates, the misfit counts the one along the force, and three are fitted.
    assert np.mean(misfits) == pytest.approx(np.sqrt(1 - 3 / len(STEPS)), rel=0.1)


@pytest.mark.slow
def test_errors_are_as_large_as_claimed_where_the_instants_are_unknown() -> None:
    """θ and both delays from their priors: 16 contacts, as above."""
    within, step = 0.02, SETTINGS.mechanics.time_step
    settings = dataclasses.replace(
        SETTINGS, stiffness=(0.1, 0.5), damping=(0.01, 0.15), force=(0.02, 0.1), onset_within=within
    )
    low, high = settings.box
    generator = np.random.default_rng(6)
    ratios = []
    for seed in range(16):
        logs = generator.uniform(low, high)
        began, ended = generator.integers(-round(within / step), round(within / step) + 1, 2)
        case = case_of(tuple(ContactProblem.theta(logs)), 1e-3, seed=seed, delays=(began, ended))
        estimate = fit_contact(case, settings)
        ratios.append((np.log(np.abs(estimate.theta)) - logs) / estimate.log_sd)
    squares = np.square(ratios).mean(axis=0)
    assert (squares > 0.35).all()
    assert (squares < 1.9).all()


def test_mean_and_covariance_are_those_of_the_posterior_on_a_grid() -> None:
    """An over-damped contact whose ridge the box cuts off, against 16³ rollouts."""
    settings = dataclasses.replace(SETTINGS, stiffness=(0.1, 0.4), damping=(0.03, 0.12), force=(0.03, 0.12))
    case = case_of(REGIMES["over-damped"], 4e-3, seed=7)
    estimate = fit_contact(case, settings)
    low, high = settings.box
    problem = ContactProblem(case, MECHANICS, case.noise)
    axes = [low[axis] + (np.arange(16) + 0.5) / 16 * (high[axis] - low[axis]) for axis in range(3)]
    logs = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    along = problem.coarse_paths(logs) @ DIRECTION / case.noise
    values, evidences = log_likelihoods(case.displacement @ DIRECTION / case.noise, along)
    shares = np.exp(evidences - evidences.max()).sum(axis=0)
    weights = np.exp(values - values.max(axis=0))
    weights = weights / weights.sum(axis=0) @ (shares / shares.sum())
    assert 1 / np.square(weights).sum() > 50  # the grid resolves it
    mean = weights @ logs
    sd = np.sqrt(weights @ np.square(logs - mean))
    np.testing.assert_allclose((np.log(np.abs(estimate.theta)) - mean) / sd, 0, atol=0.2)
    np.testing.assert_allclose(estimate.log_sd, sd, rtol=0.15)
    assert sd[0] < 0.8 * estimate_free(case)  # cut off indeed


def estimate_free(case: ContactCase) -> float:
    """Standard deviation of log k_s in the whole box."""
    return float(fit_contact(case, SETTINGS).log_sd[0])


def test_the_same_contact_gives_the_same_estimate() -> None:
    first, second = (fit_contact(case_of(REGIMES["critical"], 1e-3, seed=1), SETTINGS) for _ in range(2))
    np.testing.assert_array_equal(first.theta, second.theta)
    np.testing.assert_array_equal(first.covariance, second.covariance)
    np.testing.assert_array_equal(first.information, second.information)


def lone(logs: np.ndarray, likeliest: np.ndarray) -> Draws:
    """A sample of which one point has all the weight."""
    return Draws(np.array([logs, logs + 1]), np.array([1.0, 0.0]), likeliest)


def test_an_optimum_that_the_starts_missed_is_found_from_the_likeliest_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    theta = np.array(REGIMES["under-damped"])
    truth = np.log(np.abs(theta))
    known = []

    def first_fails(log_likelihoods, box, start, candidates) -> Draws:
        known.append(start.means)
        if len(known) == 1:
            return lone(truth, truth + 0.02)
        return sample_posterior(log_likelihoods, box, start, candidates)

    monkeypatch.setattr(direct, "sample_posterior", first_fails)
    monkeypatch.setattr(ContactProblem, "best_starts", lambda *_: np.log([[0.06, 0.4, 0.02]]))
    monkeypatch.setattr(contact_optima, "MOST_EVALUATIONS", 2)
    estimate = fit_contact(case_of(tuple(theta)), SETTINGS)
    assert len(known) == 2
    assert np.abs(known[0] - truth).max(axis=1).min() > 0.5
    assert np.abs(known[1] - truth).max(axis=1).min() < 0.01
    assert (np.abs(np.log(estimate.theta / theta)) < 0.25 * estimate.log_sd).all()


def test_where_sampling_fails_the_optima_speak(monkeypatch: pytest.MonkeyPatch) -> None:
    theta = REGIMES["critical"]
    monkeypatch.setattr(direct, "sample_posterior", lambda *_: lone(np.zeros(3), np.log(np.abs(theta))))
    estimate = fit_contact(case_of(theta), SETTINGS)
    np.testing.assert_allclose(estimate.theta, theta, rtol=1e-3)
    expected = contact_information(np.array(theta), MESH, VERTEX, DIRECTION, MECHANICS, STEPS, NOISE, load_steps=LOAD)
    np.testing.assert_allclose(estimate.covariance, covariance(expected), rtol=0.02)


def test_most_draws_must_agree_that_a_contact_determines_its_parameters() -> None:
    """Two thirds: seven of ten."""
    draws = [scale * np.diag([100.0, 200.0, 300.0]) for scale in (1, 2, 3, 4, 5, 6, 7, 8, 9, 10)]
    np.testing.assert_array_equal(cautious(draws[::-1]), draws[3])
    np.testing.assert_array_equal(cautious(draws[:1]), draws[0])


def test_parameters_outside_the_ranges_are_said_to_be_at_their_end() -> None:
    narrow = dataclasses.replace(SETTINGS, stiffness=(0.05, 0.3))
    estimate = fit_contact(case_of(REGIMES["under-damped"]), narrow)
    assert estimate.theta[0] == pytest.approx(0.3, rel=0.02)
    assert estimate.theta[0] < 0.3
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
        ({"noise": 0.0}, "give a length of 3e-05 or more"),
        ({"noise": 2.9e-5}, "noise is 2.9e-05; give a length of 3e-05 or more"),
        ({"noise": float("inf")}, "noise is inf"),
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
        self.status = np.where(self.contact, "ok", "no_contact").tolist()
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
    np.testing.assert_allclose(found[0].theta, theta, rtol=0.01)
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
