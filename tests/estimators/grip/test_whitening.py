"""Errors of neighbours become independent: beside the covariance's dense inverse."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.distance import cdist

from palpate.estimators.grip.whitening import REACH, Whitening, correlated_points, matern, points_as_one


def grid(side: int, spacing: int = 8) -> np.ndarray:
    row, column = np.mgrid[:side, :side]
    return spacing * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)


def covariance(points: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    return np.square(np.minimum(sizes[:, None], sizes)) * matern(cdist(points, points) / REACH)


@pytest.mark.parametrize("uneven", [False, True])
def test_whitened_errors_are_nearly_independent_and_of_size_one(uneven: bool) -> None:
    """One in ten errs fifty times as much, as at a tool's edge: its neighbours don't."""
    points, generator = grid(16), np.random.default_rng(0)
    sizes = 0.1 * generator.uniform(0.8, 1.2, len(points))
    if uneven:
        sizes[generator.choice(len(points), 25, replace=False)] = 5.0
    transform = Whitening(points).transform(sizes).toarray()
    found = transform @ covariance(points, sizes) @ transform.T
    np.testing.assert_allclose(np.diag(found), 1, atol=1e-9)
    assert np.abs(found - np.diag(np.diag(found))).max() < 0.06


def test_it_tells_of_a_smooth_motion_what_the_dense_covariance_tells() -> None:
    points = grid(16)
    sizes = np.full(len(points), 0.1)
    motion = np.exp(-np.linalg.norm(points - 60, axis=1) / 40)
    dense = motion @ np.linalg.solve(covariance(points, sizes), motion)
    whitened = Whitening(points).transform(sizes) @ motion
    assert whitened @ whitened == pytest.approx(dense, rel=0.02)


def test_points_that_are_not_seen_say_nothing() -> None:
    points = grid(8)
    sizes = np.full(len(points), 0.1)
    sizes[[9, 27, 28]] = np.nan
    seen = np.isfinite(sizes)
    transform = Whitening(points).transform(sizes).toarray()
    assert not transform[~seen].any()
    assert not transform[:, ~seen].any()
    part = transform[np.ix_(seen, seen)]
    found = part @ covariance(points[seen], sizes[seen]) @ part.T
    np.testing.assert_allclose(found, np.eye(len(found)), atol=0.06)


def test_points_that_err_alike_are_the_sum_of_the_correlation() -> None:
    points = grid(81)
    summed = matern(np.linalg.norm(points - points[len(points) // 2], axis=1) / REACH).sum()
    assert points_as_one(8) == pytest.approx(summed, rel=0.01)


def test_matern_is_one_at_no_distance_and_dies_away() -> None:
    np.testing.assert_allclose(matern(np.array([0.0, 1.0, 2.0])), [1, 2 / np.e, 3 / np.e**2])


@pytest.mark.parametrize("width", [0.0, 1.0, 2.0])
def test_points_that_err_alike_count_as_one(width: float) -> None:
    """White noise that a Gaussian blurs is alike over 4 π width² points."""
    row, column = np.mgrid[:60, :80]
    points = 8.0 * np.column_stack([column.ravel(), row.ravel()])
    white = np.random.default_rng(1).standard_normal((2, 60, 80))
    errors = gaussian_filter(white, (0, width, width)).reshape(2, -1).T
    lost = errors.copy()
    lost[::7] = np.nan
    expected = max(4 * np.pi * width**2, 1.0)
    for given in (errors, lost):
        assert correlated_points(points, 8, given) == pytest.approx(expected, rel=0.35)
