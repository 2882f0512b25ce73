"""Direct fits recover what made the motion, and say how well they can know it."""

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.data.prepared import PreparedFrame
from palpate.estimators.direct import contact_fit, error_model
from palpate.estimators.direct import problem as contact_problem
from palpate.estimators.direct.contact_fit import trusted_information
from palpate.estimators.direct.error_model import log_likelihoods
from palpate.estimators.direct.estimator import WHOLE, DirectEstimator
from palpate.estimators.direct.problem import ContactProblem, Optimum, combine, count_modes
from palpate.estimators.direct.sampling import Draws, sample_posterior
from palpate.estimators.estimate import Estimate, NoEstimate
from palpate.estimators.oblique import HIDDEN_ERROR
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.estimators.runs import NOT_FOLLOWED
from palpate.physics.identifiability import bounds, covariance
from palpate.physics.likelihood import Likelihood
from palpate.physics.load import Press, held
from palpate.physics.mechanics import RECOMMENDED, Bounds, Mechanics, theta_of
from palpate.physics.mesh import Mesh, contact_normal
from palpate.physics.msd.simulation import simulate
from palpate.physics.observation import Observation
from tests.estimators.sessions import clip_info, follow, prepared_frame, touched
from tests.physics.sheets import sheet

MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd")
STEPS = 16 * np.arange(1, 16) - 1
"""Frames at 25 Hz for 0.6 s."""
LOAD = 128
VERTEX = 4 * 9 + 4


def facing_sheet() -> tuple[Mesh, np.ndarray]:
    """A sheet that lies so that its normal at the contact is the line of sight, and that normal."""
    mesh = sheet(9, 9)
    normal = contact_normal(mesh, VERTEX)
    vertices = (mesh.vertices - mesh.vertices[VERTEX] - 0.5 * normal).astype(np.float32)
    return dataclasses.replace(mesh, vertices=vertices), normal


MESH, DIRECTION = facing_sheet()
NOISE = 2e-4
NARROW = Bounds((0.1, 0.5), (0.01, 0.15), (-0.1, -0.02), initial=(0.3, 0.05, -0.05))
REGIMES = {"under-damped": (0.4, 0.015, -0.05), "critical": (0.3, 0.035, -0.05), "over-damped": (0.2, 0.06, -0.06)}


def contact_of(
    theta: tuple[float, float, float], noise: float = NOISE, seed: int | None = None, delays: tuple[int, int] = (0, 0)
) -> Interaction:
    """A contact that moved as the simulator says, with noise where there is a seed.

    Its load began, and ended, `delays` steps later than it says.
    """
    began, ended = delays
    press = Press.at(VERTEX, DIRECTION, held(LOAD + ended - began, int(STEPS.max()) + 1 + max(-began, 0)))
    moved = simulate(np.array(theta), MESH, press, MECHANICS, dtype=np.float64)
    path = np.where((began <= STEPS)[:, None], moved[np.maximum(STEPS - began, 0)], 0)
    if seed is not None:
        path = path + np.random.default_rng(seed).normal(0, noise, path.shape)
    times = MECHANICS.time_step * (STEPS + 1)
    press = Press.at(VERTEX, DIRECTION.astype(np.float32), held(LOAD, MECHANICS.steps))
    return Interaction(MESH, press, Observation.of_point(VERTEX, times, path, noise), MECHANICS.time_step)


def later(contact: Interaction, seconds: float) -> Interaction:
    """The same motion, seen so much later after the beginning of the load."""
    observation = dataclasses.replace(contact.observation, times=contact.observation.times + seconds)
    return dataclasses.replace(contact, observation=observation)


def told(contact: Interaction, noise: float) -> Interaction:
    """The same motion, said to have another noise."""
    return dataclasses.replace(contact, observation=contact.observation.moved(contact.moved, noise))


def fit(contact: Interaction, within: float = 0.0, **options) -> Estimate:
    """An estimate of a press that began at its time stamp, or within so many seconds of it."""
    estimator = DirectEstimator(BETWEEN if within else STAMP, mechanics=MECHANICS, **options)
    session = estimator.start(clip_info(1 / (within or 0.04)))
    assert session.mechanics == MECHANICS
    return session.fit(contact)[0]


def expected_information(theta: tuple[float, float, float]) -> np.ndarray:
    """Fisher information of the motion without noise."""
    contact = contact_of(theta)
    likelihood = Likelihood(contact.mesh, contact.load, contact.observation, MECHANICS)
    return likelihood.information(np.log(np.abs(theta)))


@pytest.mark.parametrize("theta", REGIMES.values(), ids=REGIMES)
def test_exact_motion_gives_the_parameters_back(theta: tuple[float, float, float]) -> None:
    estimate = fit(contact_of(theta))
    # The posterior is not quite symmetric, so its mean lies a little next to its mode.
    assert (np.abs(np.log(estimate.theta / theta)) < 0.25 * estimate.log_sd).all()
    assert estimate.misfit < 0.01
    assert not estimate.at_bound.any()
    assert estimate.noise == NOISE


def test_the_covariance_is_near_the_inverse_information_where_little_is_unknown(monkeypatch) -> None:
    """The rest position and rounding are unknown besides, a tenth or two of the variance; sampling adds as much."""
    monkeypatch.setattr(error_model, "SIGMA_FREEDOM", 1e9)
    theta = REGIMES["critical"]
    estimate = fit(contact_of(theta))
    expected = expected_information(theta)
    np.testing.assert_allclose(estimate.covariance, covariance(expected), rtol=0.3)
    np.testing.assert_allclose(estimate.log_sd, np.sqrt(np.diag(estimate.covariance)))
    np.testing.assert_allclose(bounds(estimate.information), bounds(expected), rtol=0.05)
    # Twice the noise, twice the uncertainty.
    wider = fit(contact_of(theta), noise=2 * NOISE)
    np.testing.assert_allclose(wider.log_sd, 2 * estimate.log_sd, rtol=0.15)
    assert wider.noise == 2 * NOISE


def test_the_delay_of_a_press_is_fitted_beside_its_parameters() -> None:
    """Half a frame of 0.02 s late: as if it had begun at its stamp it is far off, and surer of that than it may be."""
    true, within = np.array(REGIMES["critical"]), 0.02
    contact = contact_of(REGIMES["critical"])
    late = later(contact, 0.01)
    stamp, known = fit(late), fit(contact)
    found = fit(late, within=within)
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
    assert (bounds(found.expected_information) > bounds(known.expected_information)).all()


def test_a_motion_that_the_model_cannot_explain_widens_the_posterior() -> None:
    """Noise eight times as large as it is said to be."""
    theta = REGIMES["critical"]
    good, bad = (fit(contact_of(theta, noise, seed=2)).log_sd for noise in (NOISE, 8 * NOISE))
    unsuspecting = fit(contact_of(theta, 8 * NOISE, seed=2), noise=NOISE)
    assert unsuspecting.misfit > 5
    assert (unsuspecting.log_sd > 1.9 * good).all()
    assert (unsuspecting.log_sd < 1.5 * bad).all()


def test_a_press_aslant_to_the_line_of_sight_widens_the_posterior() -> None:
    """The same motion of the same sheet, moved aside: its dent could hide its own bottom."""
    theta = REGIMES["critical"]
    contact = contact_of(theta)
    aside = 0.5 * np.tan(np.deg2rad(12)) * np.linalg.svd(DIRECTION[None])[2][1]
    aslant = dataclasses.replace(MESH, vertices=(MESH.vertices + aside).astype(np.float32))
    facing, found = (fit(each) for each in (contact, dataclasses.replace(contact, mesh=aslant)))
    assert facing.view_angle < 0.01
    assert found.view_angle == pytest.approx(12, abs=0.01)
    assert (facing.verdict, found.verdict) == ("determined", "undetermined")
    np.testing.assert_allclose(np.log(found.theta / facing.theta), 0, atol=0.01)
    low, high = RECOMMENDED.log_box
    scaled = found.information * (NOISE / HIDDEN_ERROR) ** 2
    added = np.linalg.inv(scaled + np.diag(12 / (high - low) ** 2))
    np.testing.assert_allclose(found.covariance, facing.covariance + added, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("within", [0.0, 0.02])
def test_errors_are_as_large_as_claimed(within: float) -> None:
    """θ and delays from their priors, noise of the assumed kind: the mean square of error over standard deviation is 1.

    16 contacts with three parameters that hang together: known to about √(2/16) = 35 %.
    """
    low, high = NARROW.log_box
    steps = round(within / MECHANICS.time_step)
    generator = np.random.default_rng(6 if within else 5)
    ratios, misfits = [], []
    for seed in range(16):
        logs = generator.uniform(low, high)
        began, ended = generator.integers(-steps, steps + 1, 2)
        estimate = fit(contact_of(tuple(theta_of(logs)), 1e-3, seed, (began, ended)), within, bounds=NARROW)
        ratios.append((np.log(np.abs(estimate.theta)) - logs) / estimate.log_sd)
        misfits.append(estimate.misfit)
    squares = np.square(ratios).mean(axis=0)
    assert (squares > 0.35).all()
    assert (squares < 1.9).all()
    # The noise is drawn in all three coordinates, the misfit counts the one along the force, and three are fitted.
    assert within or np.mean(misfits) == pytest.approx(np.sqrt(1 - 3 / len(STEPS)), rel=0.1)


def test_mean_and_covariance_are_those_of_the_posterior_on_a_grid() -> None:
    """An over-damped contact whose ridge the box cuts off, against 16³ rollouts."""
    small = Bounds((0.1, 0.4), (0.03, 0.12), (-0.12, -0.03), initial=(0.2, 0.06, -0.06))
    contact = contact_of(REGIMES["over-damped"], 4e-3, seed=7)
    estimate = fit(contact, bounds=small)
    low, high = small.log_box
    problem = ContactProblem(contact, MECHANICS, contact.noise)
    axes = [low[axis] + (np.arange(16) + 0.5) / 16 * (high[axis] - low[axis]) for axis in range(3)]
    logs = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    along = problem.coarse_paths(logs) @ DIRECTION / contact.noise
    values, evidences = log_likelihoods(contact.moved @ DIRECTION / contact.noise, along)
    shares = np.exp(evidences - evidences.max()).sum(axis=0)
    weights = np.exp(values - values.max(axis=0))
    weights = weights / weights.sum(axis=0) @ (shares / shares.sum())
    assert 1 / np.square(weights).sum() > 50  # the grid resolves it
    mean = weights @ logs
    sd = np.sqrt(weights @ np.square(logs - mean))
    np.testing.assert_allclose((np.log(np.abs(estimate.theta)) - mean) / sd, 0, atol=0.2)
    np.testing.assert_allclose(estimate.log_sd, sd, rtol=0.15)
    assert sd[0] < 0.8 * fit(contact).log_sd[0]  # cut off indeed


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

    monkeypatch.setattr(contact_fit, "sample_posterior", first_fails)
    monkeypatch.setattr(ContactProblem, "best_starts", lambda *_: np.log([[0.06, 0.4, 0.02]]))
    monkeypatch.setattr(contact_problem, "MOST_EVALUATIONS", 2)
    estimate = fit(contact_of(tuple(theta)))
    assert len(known) == 2
    assert np.abs(known[0] - truth).max(axis=1).min() > 0.5
    assert np.abs(known[1] - truth).max(axis=1).min() < 0.01
    assert (np.abs(np.log(estimate.theta / theta)) < 0.25 * estimate.log_sd).all()


def test_where_sampling_fails_the_optima_speak(monkeypatch: pytest.MonkeyPatch) -> None:
    theta = REGIMES["critical"]
    monkeypatch.setattr(contact_fit, "sample_posterior", lambda *_: lone(np.zeros(3), np.log(np.abs(theta))))
    estimate = fit(contact_of(theta))
    np.testing.assert_allclose(estimate.theta, theta, rtol=1e-3)
    expected = expected_information(theta)
    np.testing.assert_allclose(estimate.covariance, covariance(expected), rtol=0.02)


def test_most_draws_must_agree_that_a_contact_determines_its_parameters() -> None:
    """Two thirds: seven of ten."""
    draws = [scale * np.diag([100.0, 200.0, 300.0]) for scale in (1, 2, 3, 4, 5, 6, 7, 8, 9, 10)]
    np.testing.assert_array_equal(trusted_information(draws[::-1]), draws[3])
    np.testing.assert_array_equal(trusted_information(draws[:1]), draws[0])


def test_parameters_outside_the_ranges_are_said_to_be_at_their_end() -> None:
    narrow = dataclasses.replace(RECOMMENDED, stiffness=(0.05, 0.3), initial=(0.2, 0.08, -0.1))
    estimate = fit(contact_of(REGIMES["under-damped"]), bounds=narrow)
    assert estimate.theta[0] == pytest.approx(0.3, rel=0.02)
    assert estimate.theta[0] < 0.3
    assert estimate.at_bound.tolist() == [True, False, False]
    assert estimate.misfit > 1.5


def test_without_a_noise_there_is_no_estimate_and_it_says_why() -> None:
    contact = contact_of(REGIMES["critical"])
    unknown = told(contact, float("nan"))
    with pytest.raises(NoEstimate, match="noise isn't known; set geometry"):
        fit(unknown)
    # One that is given is as good, and the same fit gives the same estimate.
    one, two = fit(contact), fit(unknown, noise=NOISE)
    for name in ("theta", "covariance", "information", "misfit"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"bounds": Bounds()}, r"bounds\.stiffness starts at 0\.0 .* give a positive lower bound"),
        ({"bounds": dataclasses.replace(RECOMMENDED, force=(-0.3, 0.0))}, r"bounds\.force ends at 0\.0"),
        ({"noise": 0.0}, "give a length of 3e-05 or more"),
        ({"noise": 2.9e-5}, "noise is 2.9e-05; give a length of 3e-05 or more"),
        ({"noise": float("inf")}, "noise is inf"),
    ],
)
def test_impossible_settings_are_refused(wrong: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DirectEstimator(STAMP, **wrong)


def frames_of(contact: Interaction, followed: int) -> list[PreparedFrame]:
    """A clip that begins with a contact of eight frames, its tissue followed over so many frames after the first."""
    rest = contact.mesh.vertices[contact.vertex]
    positions = rest + np.concatenate([np.zeros((1, 3)), contact.moved])
    positions[followed + 1 :] = np.nan
    found = "ok", touched(contact.mesh, contact.vertex, contact.direction, contact.noise)
    frames = []
    for index, position in enumerate(positions):
        known = {"consecutive": index < len(positions) - 1, "track_start": 0, "track_position": position}
        frames.append(prepared_frame(index, *(found if index < 8 else ("no_contact",)), **known))
    return frames


FEW = "followed over 2 frames after its onset; 3 are needed"


@pytest.mark.parametrize(("followed", "words"), [(len(STEPS), ""), (2, FEW), (0, NOT_FOLLOWED)])
def test_a_clips_contacts_are_fitted_when_they_have_ended(followed: int, words: str) -> None:
    contact = contact_of(REGIMES["critical"])
    session = DirectEstimator(STAMP, mechanics=MECHANICS).start(clip_info())
    frames, (found,) = follow(session, frames_of(contact, followed))
    assert (found.onset, found.onset_frame, found.load_s) == (0, 0, pytest.approx(0.32))
    assert [frame.detail for frame in frames] == [WHOLE] * 8 + [""] * (len(frames) - 8)
    assert words in found.detail
    if not words:
        np.testing.assert_allclose(found.estimate.theta, REGIMES["critical"], rtol=0.01)
        seen = np.interp(contact.observation.times, *found.simulated)
        np.testing.assert_allclose(seen, contact.along, atol=NOISE)
    else:
        assert found.estimate is None


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


def test_modes_hold_some_evidence_and_lie_apart_of_their_own_widths() -> None:
    """Of two fits with standard deviations of 0.1 each the difference has one of 0.141: three of these are 0.424."""
    first, prior = Optimum(np.zeros(3), 5.0, 100 * np.eye(3)), np.zeros((3, 3))
    for distance, cost, expected in ((0.43, 5.0, 2), (0.42, 5.0, 1), (0.43, 7.9, 2), (0.43, 8.1, 1)):
        other = Optimum(np.array([0.0, distance, 0.0]), cost, 100 * np.eye(3))
        assert count_modes([first, other], prior) == expected, (distance, cost)
        assert count_modes([other, first], prior) == expected, (distance, cost)
    third = Optimum(np.array([0.0, 0.9, 0.0]), 5.0, 100 * np.eye(3))
    assert count_modes([first, third, third._replace(logs=np.array([0.0, 0.5, 0.8]))], prior) == 3
