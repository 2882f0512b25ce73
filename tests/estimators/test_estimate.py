"""What an estimate says: values, intervals and verdict of parameters and ratios, and the record of a frame."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from palpate.estimators.estimate import COMBINATIONS, REPORTED, SYMBOLS, PressResult
from palpate.estimators.records import FrameEstimate, Touch
from palpate.estimators.result import values_of
from palpate.physics.identifiability import LIMIT, NINETY
from palpate.physics.mechanics import PARAMETERS

THETA = np.array([0.5, 0.06, -0.1])
CORRELATED = np.array([[0.10, 0.08, 0.05], [0.08, 0.12, 0.06], [0.05, 0.06, 0.20]])


def test_everything_unknown_is_none() -> None:
    estimate = FrameEstimate(3, 0.12, "no_tool")
    known = {"frame", "time_s", "status", "detail", "verdict"}
    assert {name for name, value in dataclasses.asdict(estimate).items() if value is not None} == known | {"touch"}
    assert values_of(estimate).keys() == known


def test_a_frames_values_are_its_estimates() -> None:
    found = PressResult(THETA, 0.01 * np.eye(3))
    values = values_of(FrameEstimate(3, 0.12, "ok", estimate=found, touch=Touch(contact_u=7.0)))
    assert values["contact_u"] == 7
    assert values["determined"] == ";".join(found.determined)
    assert values.items() >= values_of(found.numbers).items()


def test_uncertainty_is_the_log_normal_distributions() -> None:
    assert norm.cdf(NINETY) - norm.cdf(-NINETY) == pytest.approx(0.9, abs=1e-15)
    fields = values_of(PressResult(THETA, np.diag([0.04, 0.25, 1.0])).numbers)
    # sd = median·exp(s²/2)·sqrt(exp(s²) - 1); for s = 1: 0.1·1.6487·1.3108.
    assert fields["force_sd"] == pytest.approx(0.1 * 1.6487212707 * 1.3108324957)
    assert fields["stiffness_sd"] == pytest.approx(0.5 * 1.0202013400 * np.sqrt(np.expm1(0.04)))
    interval = fields["damping_low"], fields["damping_high"]
    assert interval == pytest.approx((0.06 * 0.4393641, 0.06 * 2.2760167), rel=1e-6)


def test_numbers_are_those_of_drawn_parameters() -> None:
    """Values, standard deviations and intervals of parameters and ratios, against 400,000 draws of θ."""
    numbers = values_of(PressResult(THETA, CORRELATED, information=np.linalg.inv(CORRELATED)).numbers)
    logs = np.random.default_rng(0).multivariate_normal(np.log(np.abs(THETA)), CORRELATED, 400_000)
    stiffness, damping, force = np.exp(logs).T
    drawn = dict(zip(PARAMETERS, (stiffness, damping, force), strict=True))
    drawn |= {"damping_over_stiffness": damping / stiffness, "force_over_stiffness": force / stiffness}
    assert drawn.keys() == set(REPORTED)
    for name, values in drawn.items():
        low, median, high = np.quantile(values, (0.05, 0.5, 0.95))
        expected = {"": median, "_sd": values.std(), "_low": low, "_high": high}
        assert {part: numbers[name + part] for part in expected} == pytest.approx(expected, rel=0.01)
    assert numbers["damping_over_stiffness"] == pytest.approx(0.12)  # 0.06/0.5, in s
    assert numbers["force_over_stiffness"] == pytest.approx(0.2)  # 0.1/0.5, in scene units
    assert [numbers[f"{name}_bound"] for name in PARAMETERS] == pytest.approx(np.sqrt(np.diag(CORRELATED)))
    assert (SYMBOLS["damping_over_stiffness"], SYMBOLS["force_over_stiffness"]) == ("k_d/k_s", "|F|/k_s")


def test_what_an_estimator_does_not_give_is_missing() -> None:
    numbers = values_of(PressResult(np.array([0.5, 0.06, 0.0], np.float32), given_verdict="onset_in_view").numbers)
    assert numbers.keys() == {*REPORTED}
    assert (numbers["force"], numbers["force_over_stiffness"]) == (0, 0)
    rigid = values_of(PressResult(np.array([0.0, 0.06, -0.1]), CORRELATED).numbers)
    assert not any("over_stiffness" in name for name in rigid)  # there is no ratio to nothing
    assert rigid["stiffness"] == rigid["stiffness_sd"] == 0


@pytest.mark.parametrize(
    ("covariance", "verdict", "determined"),
    [
        (0.01 * np.eye(3), "determined", tuple(COMBINATIONS)),
        (np.eye(3), "undetermined", ()),
        # Each to ±0.4, but no ratio: 0.4·√2 is over the limit of 0.5.
        (0.16 * np.eye(3), "determined", PARAMETERS),
        # The common scale is unknown, the ratios are known.
        (np.ones((3, 3)) + 0.01 * np.eye(3), "ratios", tuple(COMBINATIONS)[3:]),
        # k_d and F follow k_s, apart from each other.
        (0.3 * np.ones((3, 3)) + np.diag([0, 0.15, 0.15]), "ratios", tuple(COMBINATIONS)[3:5]),
        (np.diag([0.01, 4.0, 0.01]), "undetermined", ("stiffness", "force", "force_over_stiffness")),
    ],
)
def test_what_is_determined_goes_by_standard_deviations(covariance, verdict, determined) -> None:
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(3), covariance, 20_000)
    sampled = {name for name, row in COMBINATIONS.items() if (drawn @ row).std() < LIMIT}
    assert sampled == set(determined)
    own = PressResult(THETA, covariance)
    expected = PressResult(THETA, 1e-6 * np.eye(3), expected_information=np.linalg.inv(covariance))
    for found in (own, expected):
        assert (found.verdict, found.determined) == (verdict, determined)


@pytest.mark.parametrize("told", ["", "onset_in_view"])
def test_nothing_is_determined_by_a_model_that_does_not_explain_the_motion(told: str) -> None:
    sure = PressResult(THETA, 1e-4 * np.eye(3), misfit=1.5, largest_misfit=1.5, given_verdict=told)
    unexplained = dataclasses.replace(sure, misfit=1.501)
    assert (sure.verdict, sure.determined) == ((told, ()) if told else ("determined", tuple(COMBINATIONS)))
    assert (unexplained.verdict, unexplained.determined) == ("undetermined", ())
    # Whatever it is expected to know; a misfit that nobody knows says nothing.
    expected = dataclasses.replace(unexplained, expected_information=1e6 * np.eye(3))
    assert (expected.verdict, expected.determined) == ("undetermined", ())
    assert dataclasses.replace(sure, misfit=np.nan).verdict == sure.verdict


def test_what_nothing_is_known_of_is_not_determined() -> None:
    """Directions without any information: of all parameters, and of their common scale."""
    blind = PressResult(THETA, CORRELATED, expected_information=np.zeros((3, 3)))
    assert (blind.verdict, blind.determined) == ("undetermined", ())
    ratios = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    scaleless = PressResult(THETA, CORRELATED, expected_information=1e4 * ratios.T @ ratios)
    assert (scaleless.verdict, scaleless.determined) == ("ratios", tuple(COMBINATIONS)[3:])


def test_a_ratio_known_to_the_last_digit_has_no_width() -> None:
    """In single precision the variance of a difference of badly known logarithms may come out below 0."""
    covariance = 100 * np.ones((3, 3))
    covariance[0, 0] -= 1e-3
    numbers = values_of(PressResult(THETA, covariance, expected_information=np.eye(3)).numbers)
    assert numbers["damping_over_stiffness_sd"] == 0
    assert numbers["damping_over_stiffness_low"] == numbers["damping_over_stiffness_high"] == pytest.approx(0.12)


def test_widening_adds_covariances() -> None:
    found = PressResult(THETA, CORRELATED).widened(0.3 * np.eye(3))
    np.testing.assert_allclose(found.covariance, CORRELATED + 0.3 * np.eye(3))
    np.testing.assert_allclose(np.linalg.inv(found.expected_information), CORRELATED + 0.3 * np.eye(3))
