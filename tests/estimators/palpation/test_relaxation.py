"""A ramp and hold against the closed form, and what a fit makes of it."""

import numpy as np
import pytest

from palpate.estimators.palpation import Hold, fit_relaxation
from palpate.estimators.palpation.relaxation import answers

TIMES = np.arange(0, 12, 0.1)
RAMP = 2.0


def ramp_and_hold(ratio: float, tau: float) -> Hold:
    """Linear elastic answer; force of a standard linear solid under a ramp to 1 N and a hold, in closed form."""
    moved = np.minimum(TIMES / RAMP, 1)
    rising = tau / RAMP * -np.expm1(-TIMES / tau)
    holding = tau / RAMP * np.expm1(RAMP / tau) * np.exp(-TIMES / tau)
    return Hold(TIMES, moved + ratio * np.where(TIMES <= RAMP, rising, holding), 3 * moved)


def test_the_simulated_force_is_the_closed_form() -> None:
    hold = ramp_and_hold(1.5, 3.0)
    force = answers(hold.times, hold.depth, 3.0, 1e-6, 3.0) @ [1.0, 1.5]
    np.testing.assert_allclose(force, hold.force, atol=1e-6)


def test_a_fit_finds_the_standard_linear_solid() -> None:
    found = fit_relaxation(ramp_and_hold(1.5, 3.0))
    assert found is not None
    assert found.ratio == pytest.approx(1.5, rel=0.02)
    assert found.time == pytest.approx(3.0, rel=0.02)


def test_a_force_that_goes_on_rising_tells_no_solid() -> None:
    depth = 3 * np.minimum(TIMES / RAMP, 1)
    assert fit_relaxation(Hold(TIMES, depth * (1 + 0.02 * TIMES), depth)) is None
