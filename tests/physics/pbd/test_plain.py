"""The plain version: constraints against closed forms and finite differences, time steps against closed forms."""

import numpy as np
import pytest

from palpate.physics.pbd.body import make_body
from palpate.physics.pbd.simulation import Stepping
from tests.physics.fem.bodies import rotation
from tests.physics.pbd.plain import distance, project, shape, steps, volume

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
def test_gradient_equals_finite_differences_adds_up_to_nothing_and_turns_with_the_points(name):
    constraint, points, rest = case_of(name)
    value, slope = constraint(points, rest)
    for place in np.ndindex(points.shape):
        step = np.zeros_like(points)
        step[place] = 1e-6
        central = (constraint(points + step, rest)[0] - constraint(points - step, rest)[0]) / 2e-6
        assert slope[place] == pytest.approx(central, abs=1e-8)
    np.testing.assert_allclose(slope.sum(axis=0), 0, atol=1e-14)  # no force
    np.testing.assert_allclose(np.cross(points, slope).sum(axis=0), 0, atol=1e-13)  # and no moment
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


NOBODY = np.empty(0, np.int64)


def test_one_spring_is_implicit_euler_s():
    """Along its own line a distance is linear, and one sweep solves it: m (x - x̃)/Δt² = -k C."""
    body = make_body(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), pinned=np.array([True, False, True])
    )
    stiffness = np.eye(len(body.layout.rest))[0] * 3.0  # of the edge 0–1 only
    start = np.array([[0.0, 0, 0], [1.2, 0, 0], [0, 1, 0]])
    how = Stepping(time_step=0.5, iterations=1)
    found = next(steps(body, stiffness, start, NOBODY, np.empty((1, 0, 3)), how))
    expected = 1 + 0.2 / (1 + 3.0 * 0.5**2)
    np.testing.assert_allclose(found[1], [expected, 0, 0], atol=1e-14)


def test_a_pulled_chain_stretches_by_its_springs_compliance():
    """All springs bear one force, k e, when steps have come to rest."""
    count, pull = 4, 0.1
    line = np.zeros((count, 3))
    line[:, 1] = -np.arange(count)
    side = line + np.array([1.0, 0, 0])
    faces = np.array([[i, i + 1, count + i] for i in range(count - 1)])
    body = make_body(np.concatenate([line, side]), faces, pinned=np.arange(2 * count) % count == 0)
    weights, stiffness = np.zeros(len(body.layout.rest)), np.array([1.0, 2.0, 4.0])
    along = (body.edges < count).all(axis=1) & (np.diff(body.edges, axis=1)[:, 0] == 1)
    weights[: len(body.edges)][along] = stiffness
    path = np.tile(line[-1] - [0, pull, 0], (150, 1, 1))
    *_, found = steps(body, weights, body.rest, np.array([count - 1]), path, Stepping(time_step=0.7))
    np.testing.assert_allclose(-np.diff(found[:count, 1]) - 1, pull / stiffness / (1 / stiffness).sum(), rtol=1e-3)


@pytest.mark.parametrize("stiffness", [0.5, 1e12])
def test_volume_is_kept_as_far_as_it_is_stiff(stiffness):
    """Pressed on one corner, a tetrahedron of four unit masses: the sweeps settle where k C = -λ."""
    body = make_body(np.concatenate([np.zeros((1, 3)), np.eye(3)]), np.array([[0, 1, 2]]), np.array([[0, 1, 2, 3]]))
    weight = np.zeros(len(body.layout.rest))
    weight[body.kinds[1]] = stiffness
    points, multipliers = body.rest * [1, 1, 0.7], np.zeros(len(weight))
    for _ in range(60):
        project(body, points, multipliers, weight, np.ones(4))
    now = np.linalg.det(points[1:] - points[0]) / 6 - 1 / 6
    assert now == pytest.approx(-multipliers[body.kinds[1]][0] / stiffness, abs=1e-9)
    assert (abs(now) < 1e-9) == (stiffness > 1)
