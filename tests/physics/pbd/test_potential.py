"""The compiled energy and its derivatives against plain constraints and finite differences."""

import numpy as np
import pytest

from palpate.physics.pbd.potential import Potential
from tests.physics.fem.bodies import rotation
from tests.physics.pbd.particles import block, sheet
from tests.physics.pbd.plain import constraint

BODIES = {"sheet": sheet(4, 4), "block": block((2, 1, 1))}


def case_of(name, seed=0, size=1e-3):
    """Energy, positions and a direction; spreads of the stiffness make kinds of constraint weigh equally."""
    body, random = BODIES[name], np.random.default_rng(seed)
    stiffness = random.uniform(0.5, 2.0, len(body.layout.rest))
    stiffness[body.kinds[1]] *= 1e10
    turned = (body.rest + size * random.normal(size=body.rest.shape)) @ rotation(seed).T
    return Potential(body, stiffness), turned, random.normal(size=body.rest.shape)


@pytest.mark.parametrize("name", BODIES)
def test_energy_is_the_plain_constraints(name):
    energy, points, _ = case_of(name)
    total, expected = 0.0, np.zeros_like(points)
    for index in range(len(energy.stiffness)):
        members, value, slope = constraint(energy.body, index, points)
        total += 0.5 * energy.stiffness[index] * value**2
        expected[members] += energy.stiffness[index] * value * slope
    found, slope = energy.slope(points)
    assert found == pytest.approx(total, rel=1e-12)
    np.testing.assert_allclose(slope, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", BODIES)
def test_derivatives_equal_finite_differences(name):
    energy, points, direction = case_of(name, seed=1)
    (up, above), (down, below) = (energy.slope(points + sign * 1e-8 * direction) for sign in (1, -1))
    assert (energy.slope(points)[1] * direction).sum() == pytest.approx((up - down) / 2e-8, rel=1e-6)
    curved = energy.bend(points, direction)
    np.testing.assert_allclose(curved, (above - below) / 2e-8, atol=1e-6 * np.abs(curved).max())


def test_a_rotation_is_found_from_wherever_it_begins():
    """Quarter turns and more from the last one, where Newton's step alone would go astray."""
    energy, points, _ = case_of("block", seed=2)
    expected = energy.slope(points)[0]
    for seed in range(20):
        assert energy.slope(points @ rotation(seed).T)[0] == pytest.approx(expected, rel=1e-10)


def test_stiffness_of_another_shape_is_refused():
    with pytest.raises(ValueError, match="stiffness has shape"):
        Potential(BODIES["sheet"], np.ones(3))
