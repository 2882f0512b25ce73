"""A camera that moves over drawn uneven tissue: what later frames show near the instrument is told by far points."""

from __future__ import annotations

import numpy as np
import pytest

from data.tracks.background import FAR, far_points, without_background
from data.tracks.parallax import WAYS, camera_motion

SPACING, FOCAL, LEARNT = 8, 400.0, 8
MIDDLE = np.array([240.0, 160.0])
PLACE = np.array([360.0, 120.0])
"""Of the instrument [px]."""


def grid() -> np.ndarray:
    rows, columns = np.mgrid[8:320:8, 8:480:8]
    return np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)


def rigid(points: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Points on uneven tissue as a pinhole camera sees them that has gone ways [T, 3], less their first places."""
    column, row = (points - MIDDLE).T / FOCAL
    depth = 1 + 0.15 * np.sin(9 * column + 2) * np.cos(11 * row) + 0.2 * (column > 0.1)
    scene = np.column_stack([column * depth, row * depth, depth])
    seen = scene - ways[:, None]
    return FOCAL * (seen[..., :2] / seen[..., 2:]) - (points - MIDDLE)


def swings(count: int = 16) -> np.ndarray:
    """The camera goes to and fro along its three axes, a twentieth of the depth [T, 3]."""
    time = np.arange(1, count + 1)
    return 0.05 * np.column_stack([np.sin(0.9 * time), np.sin(0.6 * time + 1) - np.sin(1), 0.6 * np.sin(1.3 * time)])


def pull(points: np.ndarray, count: int = 16) -> np.ndarray:
    """Of up to 12 px, at the instrument alone [T, N, 2]."""
    near = np.exp(-np.linalg.norm(points - PLACE, axis=1) / 25)
    return np.linspace(0, 1, count)[:, None, None] * near[:, None] * [10.0, -6.6]


def length(vectors: np.ndarray) -> float:
    return float(np.sqrt(np.square(vectors).sum(axis=-1).mean()))


def test_far_points_tell_what_the_camera_does_near_the_instrument() -> None:
    """Beyond an affine motion, in frames that nothing was learnt from."""
    points = grid()
    distance = np.linalg.norm(points - PLACE, axis=1)
    camera = rigid(points, swings())
    moved = np.array([without_background(points, motion, distance) for motion in camera + pull(points)])
    found = camera_motion(points, SPACING, moved, distance, LEARNT)
    expected = moved - pull(points)
    near = (distance < 100) & (distance > 60)
    later = slice(LEARNT, None)
    assert length(expected[later, near]) > 3
    assert length((found - expected)[later, near]) < 0.3 * length(expected[later, near])


def test_later_motion_near_the_instrument_is_not_looked_at() -> None:
    points = grid()
    distance = np.linalg.norm(points - PLACE, axis=1)
    moved = rigid(points, swings())
    found = camera_motion(points, SPACING, moved, distance, LEARNT)
    other = moved.copy()
    other[LEARNT:, distance <= np.percentile(distance, FAR)] += 50.0
    np.testing.assert_array_equal(camera_motion(points, SPACING, other, distance, LEARNT), found)
    np.testing.assert_array_equal(camera_motion(points, SPACING, moved[:12], distance, LEARNT), found[:12])


def test_motion_in_few_ways_is_found_exactly() -> None:
    """Every point by its own share of each way, in frames of its own amounts; nothing is smooth but for a tenth."""
    random = np.random.default_rng(0)
    points = grid()
    distance = np.linalg.norm(points - PLACE, axis=1)
    cell = (points // 80).astype(int) @ [1, 7]
    shares = random.normal(size=(cell.max() + 1, 2, WAYS))[cell]
    ways = 4 * random.normal(size=(20, WAYS))
    affine = np.column_stack([points, np.ones(len(points))]) @ random.normal(0, [[0.01], [0.01], [5]], (20, 3, 2))
    moved = np.einsum("tk,nck->tnc", ways, shares) + affine
    found = camera_motion(points, SPACING, moved, distance, 12)
    assert length((found - moved)[12:]) < 0.06 * length(moved[12:] - affine[12:])


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_points_that_go_astray_count_little(share: float) -> None:
    random = np.random.default_rng(1)
    points = grid()
    distance = np.linalg.norm(points - PLACE, axis=1)
    camera = rigid(points, swings())
    moved = camera.copy()
    moved[random.random(moved.shape[:2]) < share] += 15.0
    moved[random.random(moved.shape[:2]) < share] = np.nan
    found = camera_motion(points, SPACING, moved, distance, LEARNT)
    assert length((found - camera)[LEARNT:]) < (0.3 if share else 0.2) * length(
        (camera - camera.mean(axis=1, keepdims=True))[LEARNT:]
    )


def test_one_frame_or_none_tells_a_quadratic_motion_alone() -> None:
    points = grid()
    distance = np.linalg.norm(points - PLACE, axis=1)
    affine = np.column_stack([points, np.ones(len(points))]) @ np.array([[0.01, 0.02], [-0.015, 0.01], [6.0, -4.0]])
    moved = np.stack([affine, 2 * affine])
    for learnt in (0, 1):
        np.testing.assert_allclose(camera_motion(points, SPACING, moved, distance, learnt), moved, atol=1e-3)
    moved[1] = np.nan
    np.testing.assert_allclose(camera_motion(points, SPACING, moved, distance, 2)[0], affine, atol=1e-2)
    assert not far_points(moved[1], distance).any()
