"""Robust statistics: spreads by medians, and affine motions of points."""

import numpy as np


def median_sd(values: np.ndarray) -> float:
    """Return the standard deviation of most values, of those that are numbers, by the median of their sizes; 0 of
    none."""
    found = values[np.isfinite(values)]
    # Standard deviation of a normal variable over the median of its absolute value.
    return 1.4826 * float(np.median(np.abs(found))) if found.size else 0.0


def affine_terms(points: np.ndarray) -> np.ndarray:
    """Return terms of an affine function of place at points [N, 2], each of about unit size, shape [N, 3]."""
    return np.column_stack([(points - points.mean(axis=0)) / points.std(axis=0), np.ones(len(points))])


def affine_motion(points: np.ndarray, motion: np.ndarray, used: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the affine function of place that explains some motion by least squares, at other places, shape [M, A].

    Args:
        points: shape [N, 2].
        motion: of them, shape [N, A]; of those that aren't used it may be not a number.
        used: which points count, shape [N], bool.
        places: where it is asked for, shape [M, 2].
    """
    terms, there = (np.column_stack([where, np.ones(len(where))]).astype(np.float64) for where in (points, places))
    return there @ np.linalg.lstsq(terms[used], motion[used], rcond=None)[0]


def trimmed_fit(terms: np.ndarray, values: np.ndarray, rounds: int, beyond: float) -> np.ndarray:
    """Fit linear least squares that leave out what is far off; return values at all rows, shape [N].

    Args:
        terms: shape [N, K].
        values: shape [N].
        rounds: of the fit.
        beyond: rows that are more standard deviations off, by `median_sd`, don't count in the next round.
    """
    kept, fitted = np.ones(len(values), bool), np.zeros(len(values))
    for _ in range(rounds):
        fitted = terms @ np.linalg.lstsq(terms[kept], values[kept], rcond=None)[0]
        left = np.abs(values - fitted)
        kept = left <= beyond * median_sd(left) + 1e-9
    return fitted
