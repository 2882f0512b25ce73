"""Values of the constraints against closed forms, their gradients against finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from physics.pbd.constraints import distance, shape, volume
from tests.physics.fem.bodies import rotation

RANDOM = np.random.default_rng(0)
CASES = {
    "distance": (distance, RANDOM.normal(size=(2, 3)), 1.3),
    "volume": (volume, RANDOM.normal(size=(4, 3)), 0.4),
    "shape": (shape, *RANDOM.normal(size=(2, 6, 3))),
    "shape of a plane": (shape, RANDOM.normal(size=(7, 3)), RANDOM.normal(size=(7, 3)) * [1, 1, 0]),
    "shape in a plane": (shape, *(RANDOM.normal(size=(2, 7, 3)) * [1, 1, 0])),
}
"""Constraint, points, and its length, volume or offsets at rest; offsets are centred where they are used."""


def case_of(name):
    constraint, points, rest = CASES[name]
    return constraint, points, rest - rest.mean(axis=0) if "shape" in name else rest


@pytest.mark.parametrize("name", CASES)
def test_gradient_equals_finite_differences(name):
    constraint, points, rest = case_of(name)
    slope = constraint(points, rest)[1]
    for place in np.ndindex(points.shape):
        step = np.zeros_like(points)
        step[place] = 1e-6
        central = (constraint(points + step, rest)[0] - constraint(points - step, rest)[0]) / 2e-6
        assert slope[place] == pytest.approx(central, abs=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_gradient_adds_up_to_no_force_and_no_moment(name):
    constraint, points, rest = case_of(name)
    slope = constraint(points, rest)[1]
    np.testing.assert_allclose(slope.sum(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose(np.cross(points, slope).sum(axis=0), 0, atol=1e-13)


@pytest.mark.parametrize("name", CASES)
def test_value_does_not_see_rigid_motion(name):
    constraint, points, rest = case_of(name)
    value, slope = constraint(points, rest)
    moved, turned = constraint(points @ rotation(3).T + [1.0, -2.0, 0.5], rest)
    assert moved == pytest.approx(value, rel=1e-12)
    np.testing.assert_allclose(turned, slope @ rotation(3).T, atol=1e-12)


def test_values_are_those_of_closed_forms():
    assert distance(np.array([[0.0, 3.0, 0.0], [4.0, 0.0, 0.0]]), 4.5)[0] == pytest.approx(0.5, abs=1e-15)
    assert volume(np.concatenate([np.zeros((1, 3)), np.diag([1.0, 2.0, 3.0])]), 0.25)[0] == pytest.approx(0.75)
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    assert shape(square @ rotation(1).T, square)[0] == pytest.approx(0, abs=1e-8)  # of the guard under the root
    # Stretched along one axis by s, every corner is off by s - 1 along it.
    assert shape(square * [1.2, 1, 1], square)[0] == pytest.approx(0.2 * 2, rel=1e-12)


def test_a_shape_turned_inside_out_is_not_at_rest():
    offsets = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 0.5], [0, 0, -0.5]])
    # Of all rotations, the mirrored thickness leaves the least apart: 2 · (2·0.5)².
    assert shape(offsets * [1, 1, -1], offsets)[0] == pytest.approx(np.sqrt(2.0), rel=1e-12)
