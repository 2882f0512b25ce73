"""Fits of whole dents recover what made them, and say how well they can know it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct import contact_fit
from palpate.estimators.direct.contact_fit import field_optima, field_starts, first_draws, raced, sampled
from palpate.estimators.direct.problem import APART, Optimum, dent_problem
from palpate.estimators.direct.sampling import sample_posterior
from palpate.estimators.estimate import PressResult
from palpate.physics.depth import REACH
from palpate.physics.identifiability import box_information, covariance
from palpate.physics.mechanics import RECOMMENDED, Bounds
from tests.estimators.direct import test_field as dents
from tests.estimators.direct.test_field import MECHANICS, REGIMES, WITHIN, contact_of, errors_of, logs_of, noisy

BOX = Bounds((0.1, 1.0), (0.008, 0.2), (-0.2, -0.02), initial=(0.3, 0.05, -0.05)).log_box


def fit(contact: Interaction, within: float = 0.0) -> PressResult:
    problem = dent_problem(contact, MECHANICS, within)
    return sampled(problem, field_optima(problem, BOX), BOX)


def starts_of(contact: Interaction) -> np.ndarray:
    return field_starts(dent_problem(contact, MECHANICS), BOX)


def errors(estimate: PressResult, theta: tuple[float, float, float]) -> np.ndarray:
    """Errors of log θ, in the estimate's own standard deviations."""
    return np.log(estimate.theta / theta) / estimate.log_sd


def test_starts_are_the_candidates_that_explain_the_sequence_best() -> None:
    theta = REGIMES["critical"]
    problem, starts = dent_problem(contact_of(theta), MECHANICS), starts_of(contact_of(theta))
    assert 1 <= len(starts) <= problem.motion.starts
    assert ((starts >= BOX[0]) & (starts <= BOX[1])).all()
    for index, start in enumerate(starts):
        apart = np.abs(starts[:index] - start)[:, :2] / (BOX[1] - BOX[0])[:2]
        assert (apart.max(axis=1, initial=0) > APART).all() or index == 0
    # Of a sequence that is told to the last digit, the best is nearest to the truth where it matters: one is near.
    assert np.abs(starts[0] - logs_of(theta)).max() < 0.7
    costs = []
    for start in starts:
        problem.look(start)
        costs.append(np.square(problem.residual(start)).sum())
    assert costs[0] < 0.1 * np.square(problem.first.whitened(problem.first.observed)).sum()


def test_starts_have_the_delay_that_suits_them() -> None:
    theta, delay = REGIMES["under-damped"], 0.5
    problem = dent_problem(contact_of(theta, delay, delay), MECHANICS, WITHIN)
    starts = field_starts(problem, problem.motion.box(BOX))
    assert starts.shape[1] == 5
    np.testing.assert_array_equal(starts[:, 3], starts[:, 4])
    assert np.abs(starts[:, 3] - delay).min() < 0.3


def test_hidden_pixels_and_a_hole_in_the_tissue_do_not_change_the_starts() -> None:
    """A depth-change sequence shows all pixels that tissue was known in at rest, up to the hole."""
    contact, usual = contact_of(), starts_of(contact_of())
    spoiled = errors_of(0, 0.0)
    spoiled[:, 0, :2] = np.nan
    np.testing.assert_allclose(starts_of(noisy(contact, spoiled)), usual, atol=0.02)
    change = contact.sequence.change.copy()
    change[:, REACH - 4, REACH - 4] = np.nan
    holed = dents.with_change(contact_of(mesh=dents.curved_mesh((12, 13))), change)
    np.testing.assert_allclose(starts_of(holed)[0], usual[0], atol=0.1)


class Basins:
    """An optimum at every whole number n, of cost (3n)²/2; at `hidden` a hundred values come out of sight."""

    def __init__(self, hidden: int | None = None) -> None:
        self.hidden, self.looks, self.seen = hidden, [], np.ones(200, bool)
        self.first = self

    def look(self, logs: np.ndarray) -> None:
        self.looks.append(float(logs[0]))
        self.seen = np.arange(200) >= (100 if np.rint(logs[0]) == self.hidden else 0)

    def residual(self, logs: np.ndarray) -> np.ndarray:
        whole = np.rint(logs[0])
        return np.array([logs[0] - whole, 3 * whole])

    def jacobian(self, logs: np.ndarray) -> np.ndarray:
        return np.array([[1.0], [0.0]])


def test_of_many_starts_the_better_half_is_led_on() -> None:
    box, starts = np.array([[-10.0], [10.0]]), np.array([[5.3], [1.2], [0.3], [7.3], [2.3], [6.3], [3.3], [4.2]])
    problem = Basins()
    np.testing.assert_allclose(raced(problem, starts, box), [[0.0], [1.0]], atol=1e-4)
    np.testing.assert_allclose(problem.looks, [*starts.ravel(), 0, 1, 2, 3], atol=1e-4)
    # Not where they explain less because less is seen.
    np.testing.assert_allclose(raced(Basins(hidden=0), starts, box), [[1.0], [2.0]], atol=1e-4)


def test_a_few_starts_stay_where_they_are() -> None:
    starts, problem = np.linspace(0.1, 0.4, contact_fit.FITS)[:, None], Basins()
    np.testing.assert_array_equal(raced(problem, starts, np.array([[-1.0], [1.0]])), starts)
    assert not problem.looks


def test_an_exact_sequence_gives_the_parameters_back() -> None:
    theta = REGIMES["critical"]
    estimate = fit(contact_of(theta))
    assert (np.abs(errors(estimate, theta)) < 0.3).all()
    # No more than what the finer steps, with which the fit ends, move it.
    assert (np.abs(np.log(estimate.theta / theta)) < 0.03).all()
    assert estimate.misfit < 0.3
    assert not estimate.at_bound.any()
    assert estimate.noise == dents.SIGMA
    expected = dents.problem_of(contact_of(theta)).information(logs_of(theta))
    np.testing.assert_allclose(np.sqrt(np.diag(covariance(expected))), estimate.log_sd, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "size"), [("under-damped", dents.LARGER), ("critical", dents.SIZE), ("over-damped", dents.LARGER)]
)
def test_exact_sequences_made_with_fine_steps_give_the_parameters_back(name: str, size: tuple[int, int]) -> None:
    """The steps' own error is taken off, so that even small noise finds the truth."""
    theta = REGIMES[name]
    contact = contact_of(theta, size=size, mechanics=dents.FINER)
    estimate = fit(dataclasses.replace(contact, load=contact_of(theta).load, time_step=MECHANICS.time_step))
    # A posterior that is not narrow has its mean next to its mode.
    assert (np.abs(errors(estimate, theta)) < (0.1 if estimate.log_sd.max() < contact_fit.NARROW else 0.35)).all()
    assert estimate.misfit < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("name", "delays"), [("under-damped", (-0.4, 0.3)), ("over-damped", (0.5, 0.1))])
def test_delays_are_found_as_well(name: str, delays: tuple[float, float]) -> None:
    theta = REGIMES[name]
    estimate = fit(contact_of(theta, *delays), WITHIN)
    assert (np.abs(errors(estimate, theta)) < 0.6).all()
    np.testing.assert_allclose(estimate.course.delays, WITHIN * np.array(delays), atol=0.1 * WITHIN)
    assert not estimate.course.at_end
    # Who knows the instants knows more.
    known = fit(contact_of(theta, 0.0, 0.0))
    assert (estimate.log_sd > known.log_sd).all()


@pytest.mark.parametrize(("seen", "known"), [(1.9, 0.5), (1.6, 0.35), (1.0, 0.1)])
def test_the_first_draws_reach_a_long_tail_towards_firm_tissue(seen: float, known: float) -> None:
    """Inertia over scale is seen with an even error, both ratios exactly: the posterior by quadrature.

    Args:
        seen: of inertia over scale, over that in tissue in the middle of the box.
        known: its standard deviation.
    """
    box, ratio = RECOMMENDED.log_box, 0.02
    middle, prior = box.mean(axis=0), box_information(box)
    mix = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]]) / ratio

    def log_likelihood(logs: np.ndarray) -> np.ndarray:
        apart = logs - middle
        left = (np.exp(-apart[:, 0]) - seen) / known
        return -0.5 * (left**2 + np.square(apart @ mix.T).sum(axis=1))

    best = middle - np.log(seen)
    slopes = np.vstack([[-seen / known, 0.0, 0.0], mix])
    start = first_draws([Optimum(best, 0.0, slopes.T @ slopes)], 1.0, prior)
    draws = sample_posterior(log_likelihood, box, start)
    half = 0.5 * (box[1] - box[0]).min()
    scales = np.linspace(-half, half, 20_001)
    weights = np.exp(-0.5 * np.square((np.exp(-scales) - seen) / known))
    weights /= weights.sum()
    mean = weights @ scales
    sd = np.sqrt(weights @ np.square(scales - mean))
    assert (draws.mean[0] - middle[0] - mean) / sd == pytest.approx(0, abs=0.12)
    assert np.sqrt(draws.covariance[0, 0]) == pytest.approx(sd, rel=0.1)


@pytest.mark.acceptance
def test_errors_are_as_large_as_the_estimate_says() -> None:
    theta = REGIMES["critical"]
    squares, misfits = [], []
    for seed in range(10):
        estimate = fit(noisy(contact_of(theta), errors_of(seed)))
        apart = np.log(estimate.theta / theta)
        squares.append(apart @ np.linalg.solve(estimate.covariance, apart) / 3)
        misfits.append(estimate.misfit)
    assert 0.4 < np.mean(squares) < 1.9
    assert np.mean(misfits) == pytest.approx(1, abs=0.1)


@pytest.mark.slow
def test_what_the_model_does_not_explain_widens_the_estimate() -> None:
    """One half of the dent sinks by half more, the other by half less."""
    contact = contact_of(REGIMES["critical"])
    more = 0.5 * contact.sequence.change * np.sign(np.arange(-REACH, REACH + 1))
    plain, spoiled = fit(contact), fit(noisy(contact, more))
    assert spoiled.misfit > 1.5
    assert (spoiled.log_sd > 1.3 * plain.log_sd).all()


@pytest.mark.slow
def test_a_refuted_fit_gets_the_covariance_of_one_further_error_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    contact = contact_of(REGIMES["critical"])
    more = 0.5 * contact.sequence.change * np.sign(np.arange(-REACH, REACH + 1))
    problem = dent_problem(noisy(contact, more), MECHANICS)
    optima = field_optima(problem, BOX)
    found = sampled(problem, optima, BOX)
    assert contact_fit.refutes(found.misfit, problem)
    monkeypatch.setattr(contact_fit, "refutes", lambda *_: False)
    plain = sampled(problem, optima, BOX)
    frame = problem.first.counted / len(contact.sequence.times)
    square = found.misfit**2 + (found.misfit**2 - 1) * frame
    added = np.linalg.inv(plain.information / square + box_information(BOX))
    np.testing.assert_allclose(found.covariance - plain.covariance, added, rtol=1e-6)


@pytest.mark.parametrize(
    ("counted", "misfit", "refuted"),
    [(200, 1.22, False), (200, 1.23, True), (5000, 1.09, False), (5000, 1.11, True), (8, 2.0, True), (2, 2.0, False)],
)
def test_a_misfit_refutes_by_its_size_and_by_how_many_values_it_is_of(counted, misfit, refuted) -> None:
    """The square of a misfit of N values spreads by the root of 2/N."""
    problem = SimpleNamespace(first=SimpleNamespace(counted=float(counted)))
    assert contact_fit.refutes(misfit, problem) is refuted
