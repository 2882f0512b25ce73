"""A ramp and hold against the closed form, and what a fit makes of it."""

import numpy as np
import pytest

from palpate.estimators.palpation import Hold, fit_relaxation
from palpate.estimators.palpation.relaxation import Viscoelastic

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
    model = Viscoelastic(1e-6, 3.0, np.array([3.0]), np.array([1.0, 1.5]), 0.0, 0.0)
    np.testing.assert_allclose(model.force(hold.times, hold.depth), hold.force, atol=1e-6)


def test_one_branch_finds_the_standard_linear_solid() -> None:
    found = fit_relaxation(ramp_and_hold(1.5, 3.0), branches=1)
    assert found.solid.ratio == pytest.approx(1.5, rel=0.02)
    assert found.solid.time == pytest.approx(3.0, rel=0.02)
    assert found.relaxed_share == pytest.approx(0.4, rel=0.02)


def test_the_rest_of_a_hold_follows_from_its_beginning() -> None:
    """Also of a solid whose times are none of the fixed ones, and that relaxes over two of them."""
    one, two = ramp_and_hold(0.5, 0.7), ramp_and_hold(0.8, 5.0)
    hold = Hold(TIMES, one.force + two.force, one.depth)
    found = fit_relaxation(hold, 7.0)
    late = hold.times > 7
    assert np.abs(found.force(hold.times, hold.depth) - hold.force)[late].max() < 0.02 * hold.force.max()
    assert found.solid is None
    assert found.forecast_sd >= found.noise


def test_too_little_is_said() -> None:
    with pytest.raises(ValueError, match="samples of the hold"):
        fit_relaxation(ramp_and_hold(1, 1), 2.0)
    with pytest.raises(ValueError, match="branches is 2"):
        fit_relaxation(ramp_and_hold(1, 1), branches=2)
