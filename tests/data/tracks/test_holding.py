"""The piece that moves most against an affine background, and where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from data.tracks.holding import PEAK, background_motion, held_distance

SPACING = 8


def grid() -> np.ndarray:
    rows, columns = np.mgrid[8:320:8, 8:480:8]
    return np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)


def affine(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))]) @ [[0.01, 0.02], [-0.015, 0.01], [6.0, -4.0]]


def swelling(points: np.ndarray, column: float, row: float, width: float, height: float) -> np.ndarray:
    away = np.square(points - [column, row]).sum(axis=1) / (2 * width**2)
    return np.outer(np.exp(-away), [0.6 * height, 0.8 * height])


def test_background_is_what_most_points_do() -> None:
    """A fifth of them moves otherwise, all at one side."""
    points = grid()
    own = np.where((points[:, :1] > 384), [30.0, 12.0], 0.0)
    np.testing.assert_allclose(background_motion(points, affine(points) + own), affine(points), atol=0.1)


def test_background_of_too_few_points_is_at_rest() -> None:
    points = grid()[:5]
    moved = np.full((5, 2), np.nan)
    moved[:2] = 3
    np.testing.assert_array_equal(background_motion(points, moved), 0)


@pytest.mark.parametrize("camera", [False, True])
def test_held_is_where_most_motion_is(camera: bool) -> None:
    points = grid()
    moved = swelling(points, 120, 200, 40, 30) + (affine(points) if camera else 0)
    moved[::7] = np.nan
    distance = held_distance(points, SPACING, moved, 0.5)
    held = points[distance == 0]
    away = np.linalg.norm(held - [120, 200], axis=1)
    length = np.linalg.norm(swelling(points, 120, 200, 40, 30), axis=1)
    # A swelling is above a height up to √(2 log(its own over that)) widths.
    expected = 40 * np.sqrt(2 * np.log(30 / (0.5 * np.percentile(length, PEAK))))
    assert away.max() == pytest.approx(expected, abs=SPACING)
    expected = np.maximum(np.linalg.norm(points - [120, 200], axis=1) - away.max(), 0)
    np.testing.assert_allclose(distance, expected, atol=2 * SPACING)


def test_one_piece_is_held_not_two() -> None:
    points = grid()
    moved = swelling(points, 120, 160, 30, 25) + swelling(points, 380, 160, 20, 25)
    held = points[held_distance(points, SPACING, moved, 0.6) == 0]
    assert held[:, 0].max() < 200


def test_where_nothing_is_seen_or_moves_nothing_is_held() -> None:
    points = grid()
    assert np.isinf(held_distance(points, SPACING, np.full(points.shape, np.nan), 0.5)).all()
    assert np.isinf(held_distance(points, SPACING, np.zeros(points.shape), 0.5)).all()
    assert held_distance(points[:0], SPACING, np.zeros((0, 2)), 0.5).shape == (0,)
