"""The force of a whole motion from its measurement in a part of it.

A linear motion determines its force up to one factor: the relative force of a grip is proportional to the
force. The frames whose force is known give the factor and its error; no length is needed.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.data.source.table import read_series
from palpate.estimators.estimate import NoEstimate

LEAST_KNOWN = 3
"""Fewest frames of known force that determine the factor."""


@dataclass(frozen=True, eq=False)
class KnownForce:
    """Measured forces; K of them."""

    times: np.ndarray
    """Times of the measurements in the clip's time, rising, shape [K] [s]."""
    force: np.ndarray
    """Measured forces, shape [K] [N]."""

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the force at some times, linear in between, not a number before the first and after the last, shape as
        given."""
        return np.interp(times, self.times, self.force, left=np.nan, right=np.nan)


def read_forces(path: Path) -> KnownForce:
    """Read a table of forces with the columns time_s and force_N.

    Raises:
        InputError: the table can't be read, is too short, its times don't rise, or a value is no number.
    """
    return KnownForce(*read_series(path, ("time_s", "force_N"), "table of forces", LEAST_KNOWN).T)


def fit_factor(signal: np.ndarray, force: np.ndarray) -> tuple[float, float, float]:
    """Return the force over a signal that is proportional to it, by least squares.

    Residuals change slowly, so that the variance counts half of the frames.

    Args:
        signal: the signal, shape [K].
        force: measured force, shape [K] [N].

    Returns:
        The factor, its variance, and the standard deviation of the residuals [N].
    """
    square = float(signal @ signal)
    factor = float(force @ signal) / square
    variance = float(np.square(force - factor * signal).sum()) / max(len(signal) - 1, 1)
    return factor, 2 * variance / square, math.sqrt(variance)


def predict_force(known: np.ndarray, signal: np.ndarray, signal_sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the force in all frames and its standard deviation, shape [T] each [N], from its measurement in some.

    Args:
        known: measured force, shape [T] [N]; not a number where nothing was measured.
        signal: quantity that is proportional to the force, shape [T].
        signal_sd: standard deviation of the signal, shape [T].

    Raises:
        NoEstimate: the force is known in too few frames, or the signal is 0 in all of those.
    """
    some = np.isfinite(known)
    if some.sum() < LEAST_KNOWN or not signal[some].any():
        raise NoEstimate(f"The force is known in {some.sum()} frames that move; {LEAST_KNOWN} are needed for others.")
    factor, variance, residual = fit_factor(signal[some], known[some])
    return factor * signal, np.sqrt(variance * signal**2 + residual**2 + (factor * signal_sd) ** 2)
