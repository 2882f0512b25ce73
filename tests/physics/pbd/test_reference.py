"""The plain time steps against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from physics.pbd.body import make_body
from physics.pbd.reference import project, steps

NOBODY = np.empty(0, np.int64)


def test_one_spring_is_implicit_euler_s():
    """Along its own line a distance is linear, and one sweep solves it: m (x - x̃)/Δt² = -k C."""
    body = make_body(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), pinned=np.array([True, False, True])
    )
    stiffness = np.eye(len(body.layout.rest))[0] * 3.0  # of the edge 0–1 only
    start = np.array([[0.0, 0, 0], [1.2, 0, 0], [0, 1, 0]])
    found = next(steps(
        body, stiffness, start, np.zeros((3, 3)), NOBODY, np.empty((1, 0, 3)),
        time_step=0.5, iterations=1, keep=1.0, acceleration=np.zeros(3),
    ))  # fmt: skip
    expected = 1 + 0.2 / (1 + 3.0 * 0.5**2)
    np.testing.assert_allclose(found[1], [expected, 0, 0], atol=1e-14)


def test_a_hanging_chain_stretches_by_the_weight_below():
    """e = (mass below) g/k for every spring, when steps have come to rest."""
    count, gravity, stiffness = 4, 0.02, 2.0
    line = np.zeros((count, 3))
    line[:, 1] = -np.arange(count)
    side = line + np.array([1.0, 0, 0])
    faces = np.array([[i, i + 1, count + i] for i in range(count - 1)])
    body = make_body(np.concatenate([line, side]), faces, pinned=np.arange(2 * count) % count == 0)
    weights = np.zeros(len(body.layout.rest))
    weights[: len(body.edges)] = np.where(np.diff(body.edges, axis=1)[:, 0] == 1, stiffness, 0.0)
    for points in steps(
        body, weights, body.rest, np.zeros_like(body.rest), NOBODY, np.empty((150, 0, 3)),
        time_step=1.0, iterations=10, keep=0.0, acceleration=np.array([0, -gravity, 0]),
    ):  # fmt: skip
        found = points
    stretch = -np.diff(found[:count, 1]) - 1
    np.testing.assert_allclose(stretch, gravity / stiffness * np.arange(count - 1, 0, -1), rtol=1e-3)


def test_nothing_moves_at_rest():
    body = make_body(np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3]]), np.array([[0, 1, 2, 3]]))
    points, multipliers = body.rest.copy(), np.zeros(len(body.layout.rest))
    changed = project(body, points, multipliers, np.full(len(multipliers), 5.0), np.ones(4))
    assert changed < 1e-15
    assert np.abs(points - body.rest).max() < 1e-14


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
