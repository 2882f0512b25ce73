"""Which particles are seen: facing and hidden ones of sheets whose answer is plain, and of any scene by brute force."""

from __future__ import annotations

import numpy as np

from palpate.estimators.online.visibility import facing, uncovered
from tests.physics.pbd.particles import sheet

BODY = sheet(9, 8)
REST = BODY.rest - BODY.rest.mean(axis=0) + [0, 0, 0.2]


def folded() -> np.ndarray:
    """The rows beyond the middle one laid back over the others, 3 mm nearer to the camera."""
    points = REST.copy()
    over = points[:, 1] > 1e-9
    points[over, 1] *= -0.98  # not particle on particle
    points[over, 2] -= 0.003
    return points


def hidden_by_brute_force(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Every particle against every triangle, by where its line of sight meets the triangle's plane."""
    found = np.zeros(len(points), bool)
    for face in faces:
        one, two, three = points[face]
        normal = np.cross(two - one, three - one)
        inverse = np.linalg.pinv(np.stack([two - one, three - one], axis=1))
        for index, point in enumerate(points):
            if index in face or abs(normal @ point) < 1e-15:
                continue
            share = (normal @ one) / (normal @ point)
            u, v = inverse @ (share * point - one)
            found[index] |= 0 < share < 1 - 1e-9 and min(u, v, 1 - u - v) > 1e-6
    return found


def test_a_sheet_is_seen_whole_wherever_it_lies_and_moves_a_little():
    moved = REST + [0.01, -0.004, 0.02] + 5e-4 * np.random.default_rng(0).normal(size=REST.shape)
    for points in (REST, moved):
        assert facing(points, REST, BODY.faces).all()
        assert uncovered(points, BODY.faces).all()


def test_what_is_folded_over_faces_away_and_covers_what_lies_below():
    points = folded()
    rows = REST[:, 1]
    seen = facing(points, REST, BODY.faces)
    assert seen[rows < 1e-9].all()
    assert not seen[rows > 1e-9].any()
    hidden = ~uncovered(points, BODY.faces)
    inner = np.abs(REST[:, 0]) < np.abs(REST[:, 0]).max() - 1e-9
    under = (rows < -1e-3) & (rows > rows.min() + 1e-3)
    assert hidden[under & inner].all()
    assert not hidden[rows > 1e-9].any()


def test_it_is_that_of_brute_force():
    random = np.random.default_rng(1)
    for points in (folded(), REST + random.normal(0, 0.01, REST.shape)):
        expected = hidden_by_brute_force(points, BODY.faces)
        assert 0.1 < expected.mean() < 0.9
        np.testing.assert_array_equal(~uncovered(points, BODY.faces), expected)


def test_what_lies_behind_the_camera_is_not_seen():
    points = REST.copy()
    points[:8, 2] = -0.1
    seen = uncovered(points, BODY.faces)
    assert not seen[:8].any()
    assert seen[8:].all()
    assert not uncovered(-REST, BODY.faces).any()
