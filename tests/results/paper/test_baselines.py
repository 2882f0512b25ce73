"""The constant-θ fit recovers a constant and beats a grid over the box."""

import itertools

import numpy as np
import pytest

from palpate.results.paper import simulated
from tests.results.paper.simple_contacts import BOUNDS, MECHANICS, STEPS, contact, observing

TRUE = np.array([0.6, 0.05, -0.08])


def test_simulated_error_by_hand():
    exact = contact(TRUE)
    displacement = exact.moved + np.float32(0.01)
    displacement[2] = np.nan  # not seen
    off = observing(exact, displacement)
    trajectories, errors = simulated.simulate_contacts(TRUE, [off], MECHANICS)
    squared = np.square(trajectories[0][STEPS] - off.moved).sum(axis=1)
    assert errors[0] == pytest.approx(squared[[0, 1, 3, 4]].mean(), rel=1e-5)
    assert errors[0] == pytest.approx(3 * 0.01**2, rel=1e-3)


def test_contacts_of_different_lengths_are_simulated_as_if_alone():
    short = observing(contact(TRUE), contact(TRUE).moved + np.float32(0.02)).observed(np.arange(2))
    contacts = [contact(TRUE, vertex=15, load_steps=10), short, contact(TRUE * 2)]
    together = simulated.simulate_contacts(TRUE, contacts, MECHANICS)[1]
    alone = [simulated.simulate_contacts(TRUE, [one], MECHANICS)[1][0] for one in contacts]
    np.testing.assert_allclose(together, alone, rtol=1e-4, atol=1e-12)


def test_no_motion_error_is_the_simulation_without_force():
    seen = contact(TRUE)
    once = np.full((5, 3), np.nan)
    once[0] = 0.1, 0.2, 0.2
    contacts = [seen, observing(seen, once), observing(seen, np.full((5, 3), np.nan))]
    _, errors = simulated.simulate_contacts(np.array([0.6, 0.05, 0.0]), contacts, MECHANICS)
    assert simulated.no_motion_errors(contacts, MECHANICS) == pytest.approx(errors, rel=1e-5)
    assert errors[1:] == pytest.approx([0.09, 0])


def test_fit_explains_contacts_that_share_one_theta(monkeypatch):
    monkeypatch.setattr(simulated, "MAX_ITERATIONS", 40)
    contacts = [contact(TRUE, vertex=vertex) for vertex in (14, 15, 20)]
    theta, error = simulated.fit_constant_theta(contacts, BOUNDS, MECHANICS)
    assert error < 1e-3 * simulated.no_motion_errors(contacts, MECHANICS).mean()
    # The damped response determines k_d and F well; k_s resists only through the sheet's geometry.
    assert theta[1] == pytest.approx(0.05, rel=0.2)
    assert theta[2] / theta[1] == pytest.approx(-0.08 / 0.05, rel=0.2)


def test_fit_is_no_worse_than_a_grid_and_reports_its_true_error():
    rng = np.random.default_rng(0)
    contacts = [contact(TRUE * np.exp(rng.normal(0, 0.5, 3)), vertex=14 + i, noise=1e-3, seed=i) for i in range(3)]
    theta, reported = simulated.fit_constant_theta(contacts, BOUNDS, MECHANICS)
    error = simulated.simulate_contacts(theta, contacts, MECHANICS)[1].mean()
    assert error == pytest.approx(reported, rel=1e-3)
    axes = [np.geomspace(0.1, 1.9, 3), np.geomspace(0.01, 0.2, 3), -np.geomspace(0.01, 0.4, 5)]
    grid = min(
        simulated.simulate_contacts(np.array(theta), contacts, MECHANICS)[1].mean()
        for theta in itertools.product(*axes)
    )
    assert error <= grid * 1.001
