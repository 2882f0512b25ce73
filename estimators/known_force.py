"""A force that was measured for a part of a motion, which tells it for the rest of it.

What moves linearly shows a force up to one factor: the deepest dent of a press, the relative force of a grip. The
frames whose force is known tell the factor, and how far off it is; no length is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.source.table import read_series
from estimators.estimate import NoEstimate

COLUMNS = ("time_s", "force_N")
LEAST_KNOWN = 3
"""Fewer frames whose force is known tell no factor."""


@dataclass(frozen=True, eq=False)
class KnownForce:
    """Measured forces; K of them."""

    times: np.ndarray
    """Rising, in the clip's time, shape [K] [s]."""
    force: np.ndarray
    """Shape [K] [N]."""

    def at(self, times: np.ndarray) -> np.ndarray:
        """Force at some times, linear in between, not a number before the first and after the last, shape as given."""
        return np.interp(times, self.times, self.force, left=np.nan, right=np.nan)


@dataclass(frozen=True, eq=False)
class ForceCurve:
    """A force over time; T frames."""

    force: np.ndarray
    """Shape [T] [N]."""
    sd: np.ndarray
    """Its standard deviation, shape [T] [N]."""
    known: np.ndarray
    """What was measured, shape [T] [N]; not a number where nothing was."""
    factor: float
    """Force over what shows it."""
    factor_sd: float
    """Its standard deviation."""


def read_forces(path: Path) -> KnownForce:
    """Read a table of forces with the columns COLUMNS.

    Raises:
        InputError: it can't be read, is too short, its times don't rise, or it holds something that is no number.
    """
    return KnownForce(*read_series(path, COLUMNS, "table of forces", LEAST_KNOWN).T)


def fit_factor(shown: np.ndarray, force: np.ndarray) -> tuple[float, float, float]:
    """Force over what shows it by least squares, its variance, and the standard deviation of what is left [N].

    What is left changes slowly, so that the variance counts half of the frames.
    """
    square = float(shown @ shown)
    factor = float(force @ shown) / square
    left = float(np.square(force - factor * shown).sum()) / max(len(shown) - 1, 1)
    return factor, 2 * left / square, math.sqrt(left)


def predict_force(known: np.ndarray, shown: np.ndarray, shown_sd: np.ndarray) -> ForceCurve:
    """Force of all frames from that of some.

    Args:
        known: measured, shape [T] [N]; not a number where it was not.
        shown: what the force is proportional to, shape [T].
        shown_sd: its standard deviation, shape [T].

    Raises:
        NoEstimate: too few frames are known, or nothing is shown in those.
    """
    some = np.isfinite(known)
    if some.sum() < LEAST_KNOWN or not shown[some].any():
        raise NoEstimate(
            f"The force is known in {int(some.sum())} frames that move; {LEAST_KNOWN} are needed to tell the others'."
        )
    factor, variance, left = fit_factor(shown[some], known[some])
    sd = np.sqrt(variance * shown**2 + left**2 + (factor * shown_sd) ** 2)
    return ForceCurve(factor * shown, sd, known, factor, math.sqrt(variance))
