"""How points were followed is measured as it was drawn."""

from __future__ import annotations

import numpy as np

from palpate.evaluation.recovery.followed import Following, measure_following, ring_correlation

SPACING = 8
TRUE = Following(np.empty(0), 6.0, 0.1, np.array([[1.0, 0.5], [0.5, 1.0]]))


def test_drawn_errors_are_measured() -> None:
    row, column = np.mgrid[:40, :50]
    points = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    sizes = np.where(np.arange(len(points)) % 5 == 0, 0.8, 0.2)
    true = Following(sizes, TRUE.reach, TRUE.shared, TRUE.in_time)
    places = np.linalg.cholesky(true.covariance(points) + 1e-9 * np.eye(len(points)))
    generator, times = np.random.default_rng(2), np.linalg.cholesky(true.in_time)
    errors = np.einsum("nm,ts,sma->tna", places, times, generator.normal(size=(2, len(points), 2)))
    errors[0, :10] = np.nan
    found = measure_following(points, np.zeros(len(points)), SPACING, 1.7 * sizes, errors)
    # As far as points err alike, so many fewer tell.
    np.testing.assert_allclose(found.sizes, sizes, rtol=0.15)
    assert 0.05 < found.shared < 0.2
    np.testing.assert_allclose(found.in_time, true.in_time, atol=0.15)
    even = Following(np.ones(len(points)), TRUE.reach, TRUE.shared, TRUE.in_time)
    alike = np.linalg.cholesky(even.covariance(points)) @ generator.normal(size=(len(points), 2))
    again = measure_following(points, np.zeros(len(points)), SPACING, np.ones(len(points)), alike[None])
    assert abs(again.reach / TRUE.reach - 1) < 0.2


def test_correlation_is_found_ring_by_ring() -> None:
    row, column = np.mgrid[:30, :30]
    points = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    wave = np.cos(np.pi * column.ravel() / 3)
    found = ring_correlation(points, SPACING, np.column_stack([wave, wave]))
    assert found[0] == 1
    assert found[3] < -0.2 < 0.2 < found[1]
    white = np.random.default_rng(3).normal(size=(900, 2))
    assert np.abs(ring_correlation(points, SPACING, white)[1:10]).max() < 0.1
