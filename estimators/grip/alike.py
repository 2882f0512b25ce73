"""How many points err alike: what many points say together depends on it."""

from __future__ import annotations

import numpy as np


def correlated_points(points: np.ndarray, spacing: int, errors: np.ndarray) -> float:
    """How many points on a square grid have the same error, effectively: the sum of its autocorrelation.

    Args:
        points: shape [N, 2] [px].
        spacing: of the grid [px].
        errors: by axis, shape [N, 2] [px]; not a number where a point is lost.
    """
    cells = np.rint(points / spacing).astype(int)
    cells -= cells.min(axis=0)
    shape = 2 * (cells.max(axis=0) + 1)
    known = np.isfinite(errors).all(axis=1)
    counts, products = np.zeros(tuple(shape)), np.zeros(tuple(shape))
    counts[tuple(cells[known].T)] = 1
    pairs = np.fft.irfft2(np.square(np.abs(np.fft.rfft2(counts))), tuple(shape)).round()
    for axis in range(errors.shape[1]):
        field = np.zeros(tuple(shape))
        field[tuple(cells[known].T)] = errors[known, axis]
        products += np.fft.irfft2(np.square(np.abs(np.fft.rfft2(field))), tuple(shape))
    correlation = np.where(pairs > 0, products / np.maximum(pairs, 1), 0.0)
    correlation /= correlation[0, 0]
    away = np.hypot(
        *np.meshgrid(*(np.minimum(np.arange(side), side - np.arange(side)) for side in shape), indexing="ij")
    )
    rings = np.rint(away).astype(int)
    mean = np.bincount(rings.ravel(), correlation.ravel()) / np.bincount(rings.ravel())
    # Beyond the first ring without correlation there is only chance.
    end = int(np.argmax(mean <= 0)) if (mean <= 0).any() else len(mean)
    return max(float(correlation[rings < end].sum()), 1.0)
