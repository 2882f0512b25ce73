"""How many points err alike, where it is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from estimators.grip.alike import correlated_points

SPACING = 8


def grid(columns: int, rows: int) -> np.ndarray:
    row, column = np.mgrid[:rows, :columns]
    return SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)


@pytest.mark.parametrize("width", [0.0, 1.0, 2.0])
def test_points_that_err_alike_count_as_one(width: float) -> None:
    """White noise that a Gaussian blurs is alike over 4 π width² points."""
    points = grid(80, 60)
    white = np.random.default_rng(1).standard_normal((2, 60, 80))
    errors = np.stack([gaussian_filter(field, width) if width else field for field in white]).reshape(2, -1).T
    lost = errors.copy()
    lost[::7] = np.nan
    expected = max(4 * np.pi * width**2, 1.0)
    for given in (errors, lost):
        assert correlated_points(points, SPACING, given) == pytest.approx(expected, rel=0.35)
