"""Settling time against trajectories whose answer is known in closed form, and motions that can't be believed."""

import numpy as np
import pandas as pd
import pytest

from palpate.physics.mechanics import Mechanics
from palpate.results.paper.simulated import median_share, motion_row, settle

MECHANICS = Mechanics(time_step=0.01, steps=200, load_steps=50)


def _settle(distance, load_steps=50):
    """The one row of a displacement along x [T]."""
    trajectory = np.stack([distance, np.zeros(200), np.zeros(200)], axis=1)[None]
    return settle(trajectory, np.array([load_steps]), MECHANICS).iloc[0]


def test_exponential_return():
    # Load for 0.5 s at 1, then exp(−t/τ) with τ = 0.1 s: 5 % after τ·ln 20 = 0.29957 s, so after the step at 0.30 s.
    time = MECHANICS.times
    result = _settle(np.where(time <= 0.5, 1.0, np.exp(-(time - 0.5) / 0.1)))
    assert result["state"] == "settled"
    assert result["release_s"] == pytest.approx(0.5)
    assert result["settling_time_s"] == pytest.approx(0.30)
    assert result["peak"] == 1.0
    assert result["end_fraction_of_peak"] == pytest.approx(np.exp(-15))


def test_an_oscillation_settles_after_its_last_excursion():
    distance = np.zeros(200)
    distance[:50] = 1.0
    distance[[60, 80]] = 0.06, 0.2  # index 80 is the time 0.81 s: the band is entered for good at 0.82 s
    assert _settle(distance)["settling_time_s"] == pytest.approx(0.32)


def test_the_median_s_top_is_a_share_of_the_highest_peak():
    rising = np.minimum(MECHANICS.times, 0.5)[None, :, None] * np.array([0.2, 0.6, 1.0])[:, None, None]
    paths = np.concatenate([rising, np.full((1, 200, 1), np.nan)]) * np.array([0.6, 0.8, 0.0])
    assert median_share(paths) == pytest.approx(0.6)
    assert np.isnan(median_share(np.zeros((2, 200, 3))))


@pytest.mark.parametrize(
    ("distance", "load_steps", "state"),
    [
        (np.ones(200), 50, "not reached"),
        (np.ones(200), 200, "no release"),
        (np.zeros(200), 50, "no motion"),
        (np.full(200, np.nan), 50, "not finite"),
        (np.r_[np.ones(199), np.inf], 50, "not finite"),
    ],
)
def test_states_without_a_time(distance, load_steps, state):
    result = _settle(distance, load_steps)
    assert result["state"] == state
    assert np.isnan(result["settling_time_s"])


def test_every_state_is_counted_and_the_median_is_of_the_settled():
    fast, slow = np.r_[np.ones(60), np.zeros(140)], np.r_[np.ones(80), np.zeros(120)]
    settling = pd.DataFrame([_settle(distance) for distance in (fast, slow, np.full(200, 2.0), np.zeros(200))])
    row = motion_row(settling)
    states = ("settled", "not reached", "no release", "no motion", "not finite")
    assert [row[state] for state in states] == [2, 1, 0, 1, 0]
    assert row["median settling time [s]"] == pytest.approx((0.11 + 0.31) / 2)
    assert row["longest [s]"] == pytest.approx(0.31)
    assert row["peak over 1 scene unit"] == 1
