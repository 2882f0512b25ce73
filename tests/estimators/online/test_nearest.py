"""Nearest neighbours by a grid against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.estimators.online.nearest import grid_of

RANDOM = np.random.default_rng(0)


def surface(count: int) -> np.ndarray:
    """A bent sheet whose widest axes are the second and the third."""
    flat = RANDOM.uniform(size=(count, 2))
    return np.stack([0.2 * np.sin(4 * flat[:, 0]), 3 * flat[:, 0], 2 * flat[:, 1]], axis=1)


def strays(count: int) -> np.ndarray:
    """A sheet with some points far away."""
    points = surface(count)
    points[:3] += [[0, 50, 0], [-40, 0, 90], [1e3, 1e3, 1e3]]
    return points


CLOUDS = {
    "a surface": surface(80),
    "a body": RANDOM.normal(size=(80, 3)),
    "with strays": strays(200),
    "a line": np.outer(RANDOM.uniform(size=80), [1.0, 2.0, 3.0]),
    "a plane across": surface(80) * [1, 1, 0],
    "one point": RANDOM.normal(size=(1, 3)),
    "one place": np.ones((5, 3)),
    "equally far": np.stack([*np.meshgrid(np.arange(9.0), np.arange(9.0)), np.zeros((9, 9))], axis=-1).reshape(-1, 3),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_neighbours_are_those_of_brute_force(name):
    """Of places among the points, midway between them, and far away to all sides; of equals the first."""
    points = CLOUDS[name]
    queries = np.concatenate([surface(200), points, (points[1:] + points[:-1]) / 2, 30 * RANDOM.normal(size=(60, 3))])
    squared, index = grid_of(points).nearest(queries)
    apart = queries[:, None] - points
    apart = apart[..., 0] ** 2 + apart[..., 1] ** 2 + apart[..., 2] ** 2
    np.testing.assert_allclose(squared, apart.min(axis=1), rtol=1e-12)
    if name == "equally far":
        np.testing.assert_array_equal(index, apart.argmin(axis=1))
    np.testing.assert_allclose(np.square(queries - points[index]).sum(axis=1), squared, rtol=1e-12)


def test_a_cell_holds_about_a_point_and_strays_dont_change_that():
    for name in ("a surface", "with strays"):
        assert np.diff(grid_of(CLOUDS[name]).starts).max() < 8


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_points_that_are_not_finite_are_refused(value: float) -> None:
    """No cell holds them."""
    points = np.random.default_rng(0).normal(size=(20, 3))
    broken = points.copy()
    broken[7, 1] = value
    with pytest.raises(ValueError, match="not finite"):
        grid_of(broken)
    with pytest.raises(ValueError, match="not finite"):
        grid_of(points).nearest(broken)
