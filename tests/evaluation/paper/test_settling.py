"""Settling time against trajectories whose answer is known in closed form."""

import numpy as np
import pytest

from evaluation.paper.settling import settle, summarise_settling
from physics.mechanics import Mechanics

MECHANICS = Mechanics(time_step=0.01, steps=200, load_steps=50)


def _along_x(distance):
    return np.stack([distance, np.zeros_like(distance), np.zeros_like(distance)], axis=1)


def test_exponential_return():
    # Load for 0.5 s at 1, then exp(−t/τ) with τ = 0.1 s: 5 % after τ·ln 20 = 0.29957 s, so after the step at 0.30 s.
    time = MECHANICS.times
    distance = np.where(time <= 0.5, 1.0, np.exp(-(time - 0.5) / 0.1))
    result = settle(_along_x(distance), 50, MECHANICS)
    assert result.state == "settled"
    assert result.release_s == pytest.approx(0.5)
    assert result.after_release_s == pytest.approx(0.30)
    assert result.peak == 1.0
    assert result.end_fraction == pytest.approx(np.exp(-15))


def test_an_oscillation_settles_after_its_last_excursion():
    distance = np.zeros(200)
    distance[:50] = 1.0
    distance[[60, 80]] = 0.06, 0.2  # index 80 is the time 0.81 s: the band is entered for good at 0.82 s
    assert settle(_along_x(distance), 50, MECHANICS).after_release_s == pytest.approx(0.32)


def test_distance_is_the_vectors_length():
    # Every component stays below 5 % of the peak's, the length (0.04·√3 = 0.069) does not.
    trajectory = np.zeros((200, 3))
    trajectory[:50, 0] = 1.0
    trajectory[50:] = 0.04
    assert settle(trajectory, 50, MECHANICS).state == "not reached"


def test_at_rest_already_at_release():
    distance = np.zeros(200)
    distance[10] = 1.0
    assert settle(_along_x(distance), 50, MECHANICS).after_release_s == 0.0


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
    result = settle(_along_x(distance), load_steps, MECHANICS)
    assert result.state == state
    assert result.after_release_s is None


def test_summary_counts_every_state_and_takes_the_median_of_the_settled():
    fast = np.r_[np.ones(60), np.zeros(140)]
    slow = np.r_[np.ones(80), np.zeros(120)]
    results = [settle(_along_x(d), 50, MECHANICS) for d in (fast, slow, np.ones(200), np.zeros(200))]
    summary = summarise_settling(results)
    assert summary.counts == {"settled": 2, "not reached": 1, "no release": 0, "no motion": 1, "not finite": 0}
    assert summary.median_s == pytest.approx((0.11 + 0.31) / 2)
    assert summary.longest_s == pytest.approx(0.31)
    assert summarise_settling(results[2:]).median_s is None
