"""The collapse check on estimates that vary, that don't, and that are too few."""

import numpy as np
import pandas as pd
import pytest

from palpate.physics.mechanics import PARAMETERS, Bounds
from palpate.results.paper.statistics import as_reported, spread_of

BOUNDS = Bounds()
SIGNED = Bounds(force=(-10, 10))


def _theta(spread, seed=0):
    noise = np.random.default_rng(seed).normal(size=(100, 3))
    noise = (noise - noise.mean(axis=0)) / noise.std(axis=0, ddof=1)
    return np.array([0.508, 0.09, -7.79]) + noise * spread


def _spread(theta, bounds=BOUNDS, contacts=100):
    return spread_of(pd.DataFrame(as_reported(theta, bounds), columns=list(PARAMETERS)), bounds, contacts)


VARIES = _spread(_theta([0.1, 0.03, 1.0]))


def test_the_papers_own_estimates_count_as_collapsed():
    spread = _spread(_theta([0.0027, 0.0162, 0.1841]))
    assert spread["verdict"].tolist() == ["constant"] * 3
    assert spread.loc["stiffness", "sd"] == pytest.approx(0.0027)
    assert spread.loc["stiffness", "sd_of_range"] == pytest.approx(0.0027)
    assert spread.loc["damping", "sd_of_mean"] == pytest.approx(0.18)
    assert spread.loc["force", "sd_of_range"] == pytest.approx(0.01841)


def test_estimates_that_vary_all_or_in_part():
    assert VARIES["verdict"].tolist() == ["varies"] * 3
    assert _spread(_theta([0.001, 0.03, 1.0]))["verdict"].tolist() == ["constant", "varies", "varies"]


def test_a_box_far_too_wide_does_not_make_a_varying_estimate_a_constant():
    # F between −0.03 and −0.09 on a range of [−10, 0]: 0.2 % of the range, but a third of the mean.
    theta = _theta([0.1, 0.03, 0.0])
    theta[:, 2] = -np.linspace(0.03, 0.09, 100)
    assert _spread(theta).loc["force", "verdict"] == "varies"


def test_force_is_a_magnitude_unless_its_range_crosses_zero():
    force = VARIES.loc["force"]
    assert (force["low"], force["high"]) == (0, 10)
    assert force["mean"] == pytest.approx(7.79)
    assert _spread(_theta([0.1, 0.03, 1.0]), bounds=SIGNED).loc["force", "mean"] == pytest.approx(-7.79)


def test_values_at_the_bounds_are_counted():
    theta = np.tile([0.5, 0.1, -5.0], (4, 1))
    theta[:, 1] = [0.0, 0.005, 0.5, 1.0]
    assert _spread(theta).loc["damping", "at_bound"] == 0.75


def test_frames_of_too_few_contacts_are_undetermined():
    """One contact has one θ, however many frames show it."""
    spread = _spread(_theta([0.001, 0.001, 0.01]), contacts=2)
    assert spread["verdict"].tolist() == ["n too small"] * 3
    assert np.isnan(_spread(_theta([0.1, 0.1, 1])[:1], contacts=1).loc["stiffness", "sd"])
