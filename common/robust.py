"""Robust statistics: errors with Student's distribution in a plane, spreads by medians, and affine motions of points.

Followed points err by a little, and now and then by a lot. Student's distribution lets a point that is far off count
little, by weights that are found anew with every fit (iteratively reweighted least squares; Lange, Little and Taylor
1989, "Robust statistical modeling using the t distribution", equations 6 and 7).
"""

import numpy as np

FREEDOM = 3.0
"""Degrees of freedom of Student's distribution, in the plane."""
NORMAL_MEDIAN = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""
SCALED = 10
"""Steps to the errors' scale."""


def student_weights(squares: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """How much errors in the plane count, any shape: about 1 for usual ones, little for those that are far off.

    Args:
        squares: squared lengths of the errors.
        variance: of the errors by axis, in the same unit.
    """
    return (FREEDOM + 2) / (FREEDOM + squares / variance)


def student_loss(squares: np.ndarray, variance: np.ndarray) -> float:
    """Negative log density of errors in the plane, up to a constant; arguments as of `student_weights`."""
    return float(((FREEDOM + 2) / 2 * np.log1p(squares / variance / FREEDOM) + np.log(variance)).sum())


def error_scale(squares: np.ndarray, known: np.ndarray, weights: np.ndarray, scale: float, least: float) -> float:
    """Likeliest variance by axis of weighted errors besides the known one, from a value on.

    Args:
        squares: squared lengths of errors in the plane, shape [n].
        known: variances by axis, shape [n].
        weights: shape [n].
        scale: the value so far.
        least: a variance that isn't larger counts as 0.
    """
    found = max(scale, float(known.min()))
    for _ in range(SCALED):
        variance = known + found
        found *= float(np.sqrt((weights * squares / (2 * variance**2)).sum() / (1 / variance).sum()))
    return found if found > least else 0.0


def median_sd(values: np.ndarray) -> float:
    """Standard deviation of most values, of those that are numbers, by the median of their sizes; 0 of none."""
    found = values[np.isfinite(values)]
    return NORMAL_MEDIAN * float(np.median(np.abs(found))) if found.size else 0.0


def affine_terms(points: np.ndarray) -> np.ndarray:
    """Terms of an affine function of place at points [N, 2], each of about unit size, shape [N, 3]."""
    return np.column_stack([(points - points.mean(axis=0)) / points.std(axis=0), np.ones(len(points))])


def affine_motion(points: np.ndarray, motion: np.ndarray, used: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The affine function of place that explains some motion by least squares, at other places, shape [M, A].

    Args:
        points: shape [N, 2].
        motion: of them, shape [N, A]; of those that aren't used it may be not a number.
        used: which points count, shape [N], bool.
        places: where it is asked for, shape [M, 2].
    """
    terms, there = (np.column_stack([where, np.ones(len(where))]).astype(np.float64) for where in (points, places))
    return there @ np.linalg.lstsq(terms[used], motion[used], rcond=None)[0]


def trimmed_fit(terms: np.ndarray, values: np.ndarray, rounds: int, beyond: float) -> np.ndarray:
    """Linear least squares that leave out what is far off, at all rows, shape [N].

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
