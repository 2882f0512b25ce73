"""Adam against its closed forms and its recurrence written out."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.estimators.online.adam import Adam


def test_the_first_step_is_the_rate_against_the_sign():
    found = Adam(0.1).step(np.array([1.0, -2.0, 3.0]), np.array([5.0, -1e-3, 0.0]))
    np.testing.assert_allclose(found, [0.9, -1.9, 3.0], rtol=1e-5)


def test_equal_slopes_make_equal_steps():
    """Both means are then the slope and its square, whatever the count."""
    adam, values = Adam(0.05, guard=0.0), np.zeros(2)
    for count in range(1, 30):
        values = adam.step(values, np.array([3.0, -0.1]))
        np.testing.assert_allclose(values, [-0.05 * count, 0.05 * count], rtol=1e-12)


def test_steps_are_those_of_the_sums():
    """The means as weighted sums over all slopes so far, instead of the recurrence."""
    slopes, adam, values = np.random.default_rng(0).normal(size=(7, 4)), Adam(), np.zeros(4)
    expected = np.zeros(4)
    for count in range(1, 8):
        values = adam.step(values, slopes[count - 1])
        back = np.arange(count)[::-1]
        mean, square = (
            (1 - decay) * (decay**back) @ slopes[:count] ** power / (1 - decay**count)
            for decay, power in ((0.9, 1), (0.999, 2))
        )
        expected -= 0.1 * mean / (np.sqrt(square) + 1e-8)
    np.testing.assert_allclose(values, expected, rtol=1e-12)


@pytest.mark.parametrize("rate", [0.0, np.inf])
def test_a_rate_out_of_range_is_refused(rate):
    with pytest.raises(ValueError, match="rate is"):
        Adam(rate)
