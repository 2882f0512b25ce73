"""The background's affine motion taken off, and where there is too little of it."""

import numpy as np

from palpate.data.tracks.background import MIN_FAR, without_background

AFFINE = np.array([[0.02, -0.01], [0.015, 0.03], [2.0, -5.0]])
"""Motion by column, by row, and everywhere."""


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Points, and their distance from a tool at the left edge."""
    rows, columns = np.mgrid[8:120:8, 8:200:8]
    points = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)
    return points, points[:, 0].copy()


def carried(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))]) @ AFFINE


def test_an_affine_motion_is_taken_off_exactly() -> None:
    points, distance = grid()
    np.testing.assert_allclose(without_background(points, carried(points), distance), 0, atol=1e-10)


def test_what_tissue_at_the_tool_does_besides_stays() -> None:
    points, distance = grid()
    own = np.where(distance[:, None] < 60, [4.0, -1.0], 0.0)
    np.testing.assert_allclose(without_background(points, carried(points) + own, distance), own, atol=1e-10)


def test_lost_points_count_nothing_and_stay_lost() -> None:
    points, distance = grid()
    moved = carried(points)
    lost = np.random.default_rng(0).random(len(points)) < 0.5
    moved[lost] = np.nan
    found = without_background(points, moved, distance)
    assert np.isnan(found[lost]).all()
    np.testing.assert_allclose(found[~lost], 0, atol=1e-10)


def test_the_farthest_of_the_points_that_are_seen_are_meant() -> None:
    """Where all points far away are lost, the farthest of the others take their place."""
    points, distance = grid()
    moved = carried(points)
    moved[distance > 80] = np.nan
    found = without_background(points, moved, distance)
    np.testing.assert_allclose(found[distance <= 80], 0, atol=1e-10)


def test_too_few_points_determine_nothing() -> None:
    """Four tenths of 15 points are 6, of 12 points but 5."""
    points, distance = grid()
    chosen = np.arange(0, len(points), len(points) // 15)[:15]
    distance = np.arange(float(len(points)))
    points, distance, moved = points[chosen], distance[chosen], carried(points)[chosen]
    np.testing.assert_allclose(without_background(points, moved, distance), 0, atol=1e-9)
    few = slice(0, 12)
    assert (distance[few] > np.percentile(distance[few], 60)).sum() == MIN_FAR - 1
    np.testing.assert_array_equal(without_background(points[few], moved[few], distance[few]), moved[few])


def test_where_no_point_is_seen_nothing_is_said() -> None:
    points, distance = grid()
    assert np.isnan(without_background(points, np.full_like(points, np.nan), distance)).all()
