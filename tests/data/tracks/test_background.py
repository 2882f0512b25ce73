"""The background's affine motion taken off, and where there is too little of it."""

import numpy as np

from palpate.data.tracks.background import MIN_FAR, without_background

ROWS, COLUMNS = np.mgrid[8:120:8, 8:200:8]
POINTS = np.column_stack([COLUMNS.ravel(), ROWS.ravel()]).astype(np.float32)
DISTANCE = POINTS[:, 0].copy()
"""From a tool at the left edge."""
CARRIED = POINTS @ [[0.02, -0.01], [0.015, 0.03]] + [2.0, -5.0]
"""Motion by column, by row, and everywhere."""


def test_an_affine_motion_is_taken_off_exactly() -> None:
    np.testing.assert_allclose(without_background(POINTS, CARRIED, DISTANCE), 0, atol=1e-10)


def test_what_tissue_at_the_tool_does_besides_stays() -> None:
    own = np.where(DISTANCE[:, None] < 60, [4.0, -1.0], 0.0)
    np.testing.assert_allclose(without_background(POINTS, CARRIED + own, DISTANCE), own, atol=1e-10)


def test_lost_points_count_nothing_and_stay_lost() -> None:
    lost = np.random.default_rng(0).random(len(POINTS)) < 0.5
    found = without_background(POINTS, np.where(lost[:, None], np.nan, CARRIED), DISTANCE)
    assert np.isnan(found[lost]).all()
    np.testing.assert_allclose(found[~lost], 0, atol=1e-10)


def test_too_few_points_determine_nothing() -> None:
    """Four tenths of 15 points are 6, of 12 points but 5."""
    chosen = np.arange(0, len(POINTS), len(POINTS) // 15)[:15]
    points, distance, moved = POINTS[chosen], np.arange(float(len(POINTS)))[chosen], CARRIED[chosen]
    np.testing.assert_allclose(without_background(points, moved, distance), 0, atol=1e-9)
    assert (distance[:12] > np.percentile(distance[:12], 60)).sum() == MIN_FAR - 1
    np.testing.assert_array_equal(without_background(points[:12], moved[:12], distance[:12]), moved[:12])
