"""The constant-θ fit recovers a constant, beats a grid over the box, and says what it spent."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.paper.baselines import (
    ConstantThetaSettings,
    _to_theta,
    _to_unit,
    amplification,
    fit_constant_theta,
    no_motion_error,
    reference_theta,
    simulate_contacts,
)
from physics.mechanics import Bounds, Mechanics
from tests.evaluation.simple_contacts import BOUNDS, MECHANICS, STEPS, contact, observing

TRUE = np.array([0.6, 0.05, -0.08])
QUICK = ConstantThetaSettings(contacts=3, starts=4, refined=2, iterations=40)


def test_simulated_error_by_hand():
    exact = contact(TRUE)
    displacement = exact.moved + np.float32(0.01)
    displacement[2] = np.nan  # not seen
    off = observing(exact, displacement)
    trajectories, errors = simulate_contacts(TRUE, [off], MECHANICS)
    squared = np.square(trajectories[0][STEPS] - off.moved).sum(axis=1)
    assert errors[0] == pytest.approx(squared[[0, 1, 3, 4]].mean(), rel=1e-5)
    assert errors[0] == pytest.approx(3 * 0.01**2, rel=1e-3)


def test_contacts_of_different_lengths_are_simulated_as_if_alone():
    short = observing(contact(TRUE), contact(TRUE).moved + np.float32(0.02)).observed(np.arange(2))
    contacts = [contact(TRUE, vertex=15, load_steps=10), short, contact(TRUE * 2)]
    together = simulate_contacts(TRUE, contacts, MECHANICS, batch_size=3)[1]
    alone = [simulate_contacts(TRUE, [one], MECHANICS)[1][0] for one in contacts]
    np.testing.assert_allclose(together, alone, rtol=1e-4, atol=1e-12)


def test_no_motion_error_is_the_simulation_without_force():
    seen = contact(TRUE)
    _, errors = simulate_contacts(np.array([0.6, 0.05, 0.0]), [seen], MECHANICS)
    assert no_motion_error(seen.observation) == pytest.approx(errors[0], rel=1e-5)
    once = np.full((5, 3), np.nan)
    once[0] = 0.1, 0.2, 0.2
    assert no_motion_error(observing(seen, once).observation) == pytest.approx(0.09)
    assert no_motion_error(observing(seen, np.full((5, 3), np.nan)).observation) == 0


def test_reference_keeps_the_force():
    np.testing.assert_array_equal(reference_theta(TRUE[None]), [[5.34, 0.127, -0.08]])


def test_fit_explains_contacts_that_share_one_theta():
    contacts = [contact(TRUE, vertex=vertex) for vertex in (14, 15, 20)]
    fitted = fit_constant_theta(contacts, BOUNDS, MECHANICS, QUICK)
    scale = np.mean([no_motion_error(one.observation) for one in contacts])
    assert fitted.training_error < 1e-3 * scale
    # The damped response determines k_d and F well; k_s resists only through the sheet's geometry.
    assert fitted.theta[1] == pytest.approx(0.05, rel=0.2)
    assert fitted.theta[2] / fitted.theta[1] == pytest.approx(-0.08 / 0.05, rel=0.2)
    assert (fitted.contacts_used, fitted.contacts_available, fitted.not_finite) == (3, 3, 0)


def test_fit_is_no_worse_than_a_grid_and_reports_its_true_error():
    rng = np.random.default_rng(0)
    contacts = [contact(TRUE * np.exp(rng.normal(0, 0.5, 3)), vertex=14 + i, noise=1e-3, seed=i) for i in range(3)]
    fitted = fit_constant_theta(contacts, BOUNDS, MECHANICS, QUICK)
    error = simulate_contacts(np.array(fitted.theta), contacts, MECHANICS)[1].mean()
    assert error == pytest.approx(fitted.training_error, rel=1e-3)
    axes = [np.geomspace(0.1, 1.9, 3), np.geomspace(0.01, 0.2, 3), -np.geomspace(0.01, 0.4, 5)]
    grid = min(simulate_contacts(np.array(theta), contacts, MECHANICS)[1].mean() for theta in itertools.product(*axes))
    assert error <= grid * 1.001


def test_fit_uses_a_bounded_evenly_spaced_subset_and_repeats_itself():
    contacts = [contact(TRUE * (1 + 0.1 * i)) for i in range(5)]
    settings = ConstantThetaSettings(contacts=2, starts=2, refined=1, iterations=3)
    first = fit_constant_theta(contacts, BOUNDS, MECHANICS, settings)
    assert (first.contacts_used, first.contacts_available) == (2, 5)
    assert first == fit_constant_theta(contacts, BOUNDS, MECHANICS, settings)
    ends = fit_constant_theta([contacts[0], contacts[4]], BOUNDS, MECHANICS, settings)
    assert first.theta == ends.theta
    assert first.evaluations <= 2 + 6 + 1


def test_no_contacts_give_no_constant():
    assert fit_constant_theta([], BOUNDS, MECHANICS) is None


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="constant-θ setting starts is 0"):
        ConstantThetaSettings(starts=0)


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.floats(0, 1)] * 3), st.booleans())
def test_search_coordinates_stay_in_the_box_and_invert(unit, signed):
    bounds = Bounds(force=(-3, 7), initial=(0.5, 0.5, 1)) if signed else BOUNDS
    theta, slope = _to_theta(np.array(unit), bounds)
    assert (np.array(bounds.lower) - 1e-12 <= theta).all()
    assert (theta <= np.array(bounds.upper) + 1e-12).all()
    np.testing.assert_allclose(_to_unit(theta, bounds), unit, atol=1e-9)
    shifted, _ = _to_theta(np.array(unit) + 1e-6, bounds)
    np.testing.assert_allclose((shifted - theta) / 1e-6, slope, rtol=1e-4)


def test_regular_motion_is_not_amplified_and_no_motion_is_zero():
    gain = amplification(np.array([TRUE, [0.6, 0.05, 0.0]]), [contact(TRUE)] * 2, MECHANICS)
    # The sheet's answer to F is close to a power of F, so the relative change is of the order of 1.
    assert 0.3 < gain[0] < 3
    assert gain[1] == 0


def test_a_simulation_that_is_not_finite_is_infinitely_amplified():
    explicit = Mechanics(steps=40, load_steps=20, damping="explicit")
    assert np.isinf(amplification(np.array([[1.0, 50.0, -5.0]]), [contact(TRUE)], explicit)[0])
