"""Newtons by one scale: closed forms, and intervals that hold as often as they say."""

import dataclasses
import math

import numpy as np
import pytest

from palpate.estimators import force_scale as module
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.force_scale import ClipLength, PressedRun, scale_by_force, scale_by_stiffness
from palpate.estimators.known_force import KnownForce
from tests.estimators.estimates import GOOD, NONE

UNKNOWN = ClipLength(1.0)
METRIC = ClipLength(0.2, 0.2)
SPREAD = np.array([[0.04, 0.01, 0.02], [0.01, 0.02, 0.0], [0.02, 0.0, 0.03]])


def run(frame: int, theta: tuple[float, float, float], spread: np.ndarray | None = SPREAD, **changes) -> PressedRun:
    begin = 0.04 * frame
    pressed = PressedRun(frame, begin, begin + 0.4, np.log(np.abs(theta)), spread, spread, True)
    return dataclasses.replace(pressed, **changes)


KNOWN, OTHER = run(10, (0.5, 0.1, -0.2)), run(40, (0.8, 0.05, -0.05))


def test_what_is_kept_of_a_run_is_its_estimate_and_when_it_pressed() -> None:
    kept = PressedRun.of(GOOD)
    assert np.exp(kept.logs) == pytest.approx([0.5, 0.06, 0.1])
    np.testing.assert_allclose(kept.expected, kept.covariance, rtol=1e-12)
    assert (kept.begin, kept.end, kept.explained) == (0.28, pytest.approx(0.44), True)
    assert kept.pressing(np.array([0.27, 0.28, 0.43, 0.44])).tolist() == [False, True, True, False]
    assert PressedRun.of(NONE) is None


def test_one_known_force_tells_the_other_contacts_by_the_mass_that_they_share() -> None:
    """0.2 units are 4 N, so every unit is 20 N, and 16 N/m are 0.8 units where a unit of length is a metre."""
    scale = scale_by_force([KNOWN, OTHER], [(10, 4.0, 0.05)], "a force")
    told = scale.of(OTHER, UNKNOWN)
    assert np.exp(told.logs) == pytest.approx([16.0, 1.0, 1.0])
    np.testing.assert_allclose(told.covariance, SPREAD + 0.05**2 + SPREAD[2, 2], rtol=1e-12)
    assert told.determined == ("stiffness", "damping", "force")
    own = scale.of(KNOWN, UNKNOWN)
    assert np.exp(own.logs[2]) == pytest.approx(4.0)
    assert own.covariance[2, 2] == pytest.approx(0.05**2)  # of the measured force alone
    ratio = SPREAD[0, 0] + SPREAD[2, 2] - 2 * SPREAD[0, 2]  # k_s = F·(k_s/F)
    assert own.covariance[0, 0] == pytest.approx(ratio + 0.05**2)
    metric = scale.of(OTHER, METRIC)
    assert np.exp(metric.logs) == pytest.approx([16 / 0.2, 1 / 0.2, 1.0])
    assert (metric.metric, told.metric) == (True, False)


def test_a_force_that_is_known_with_the_stiffness_alone_tells_no_scale() -> None:
    """To a factor e each, to a tenth over each other."""
    loose = np.ones((3, 3)) + np.diag([0.0, 0.0, 0.01])
    known, other = (dataclasses.replace(each, covariance=loose, expected=loose) for each in (KNOWN, OTHER))
    with pytest.raises(NoEstimate, match="force of the run at frame 10, whose force is known, is not determined"):
        scale_by_force([known, other], [(10, 4.0, 0.0)], "a force")


def test_several_known_forces_count_by_how_well_they_are_known() -> None:
    exact, loose = run(10, (1, 1, -1), 0.01 * np.eye(3)), run(20, (1, 1, -1), 0.04 * np.eye(3))
    scale = scale_by_force([exact, loose], [(10, 2.0, 0.0), (20, 4.0, 0.0)], "forces")
    assert scale.used == pytest.approx({10: 0.8, 20: 0.2})
    assert scale.log == pytest.approx(0.8 * math.log(2) + 0.2 * math.log(4))
    assert scale.variance == pytest.approx(0.008)
    assert scale_by_force([exact], [(10, 2.0, 0.0), (99, 9.0, 0.0)], "").used == {10: 1.0}


def test_a_stiffness_in_newtons_a_metre_needs_a_length_and_carries_its_error_once() -> None:
    with pytest.raises(NoEstimate, match="give metres_per_depth"):
        scale_by_stiffness(80.0, 0.1, UNKNOWN, "a stiffness")
    length = ClipLength(0.2, 0.2, log_sd=0.3)
    told = scale_by_stiffness(80.0, 0.1, length, "a stiffness").of(OTHER, length)
    assert np.exp(told.logs) == pytest.approx([80.0, 80 * 0.05 / 0.8, 80 * 0.2 * 0.05 / 0.8])
    assert told.covariance[0, 0] == pytest.approx(0.1**2)  # as it was given, whatever the length
    over = SPREAD[0, 0] + SPREAD[2, 2] - 2 * SPREAD[0, 2]
    assert told.covariance[2, 2] == pytest.approx(0.1**2 + over + 0.3**2)


def test_a_run_that_the_model_does_not_explain_or_that_has_no_estimate_tells_no_scale() -> None:
    with pytest.raises(NoEstimate, match="does not explain the motion of the run at frame 10"):
        scale_by_force([dataclasses.replace(KNOWN, explained=False)], [(10, 1.0, 0.0)], "")
    with pytest.raises(NoEstimate, match="no press was estimated"):
        scale_by_force([OTHER], [(10, 1.0, 0.0)], "")


def test_an_estimator_without_uncertainty_gives_numbers_alone() -> None:
    bare = run(10, (0.5, 0.1, -0.2), None)
    told = scale_by_force([bare], [(10, 4.0, 0.1)], "").of(bare, UNKNOWN)
    assert np.exp(told.logs) == pytest.approx([10.0, 2.0, 4.0])
    assert (told.log_sd, told.determined) == (None, ())


def test_measured_forces_of_a_run_are_its_mean_within_what_is_known() -> None:
    times = np.arange(0, 2, 0.05)
    force = np.where(times < 1, -3.0, -5.0) + 0.1 * (-1.0) ** np.arange(len(times))
    (found,) = module.measured_presses([KNOWN, OTHER], KnownForce(times[:30], force[:30]))
    assert found[:2] == (10, pytest.approx(3.0, abs=0.03))
    assert 0 < found[2] < 0.03
    assert module.measured_presses([KNOWN], KnownForce(times[14:], force[14:])) == []  # two forces are too few


def test_intervals_of_forces_hold_as_often_as_they_say() -> None:
    chance, inside = np.random.default_rng(3), 0
    for _ in range(400):
        off = chance.multivariate_normal(np.zeros(3), SPREAD, 2)
        known = dataclasses.replace(KNOWN, logs=KNOWN.logs + off[0])
        other = dataclasses.replace(OTHER, logs=OTHER.logs + off[1])
        measured = 4.0 * math.exp(chance.normal(0, 0.05))
        told = scale_by_force([known, other], [(10, measured, 0.05)], "").of(other, UNKNOWN)
        inside += abs(told.logs[2] - math.log(1.0)) < 1.645 * told.log_sd[2]
    assert inside / 400 == pytest.approx(0.9, abs=0.04)


def test_a_sheet_of_the_mesh_s_springs_is_four_thirds_of_their_stiffness_stiff() -> None:
    """Two sides and a diagonal a square: energy of strains in all directions against that of an isotropic sheet."""
    ways = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])

    def energy(strain: np.ndarray) -> float:
        return sum(0.5 * ((way @ strain @ way) / np.linalg.norm(way)) ** 2 for way in ways)

    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in angles]
    area = energy(np.eye(2)) / 2  # W = 2K e² of e·1
    shear = np.mean([energy(turn @ np.diag([1.0, -1.0]) @ turn.T) for turn in turns]) / 2  # W = 2μ e²
    assert pytest.approx(4 * area * shear / (area + shear)) == 1 / module.SHEET_FACTOR
