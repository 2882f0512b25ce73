"""When a press begins is known to a frame only: what that adds to an estimate's uncertainty.

Every simulated press begins at the time stamp of the first frame in contact. A real one begins up to a frame interval T
before or after it, and an estimate that takes the stamp for the beginning is surer than it may be: the motion is off by
its velocity times the delay. To first order the parameters follow as in a least-squares fit within the box, and a delay
spread evenly over ±T has a variance of T²/3. `python -m evaluation.benchmark --suite late-onset --onset between`, or
without that option, shows what it makes of the intervals.
"""

from __future__ import annotations

import numpy as np

BETWEEN, STAMP = "between", "stamp"
ONSETS = (BETWEEN, STAMP)
"""A press begins anywhere within a frame interval of the first frame in contact, or at that frame's time stamp."""


def onset_error(onset: str, fps: float) -> float:
    """How far from the first frame in contact a press may begin, at so many frames a second [s]."""
    return 1 / fps if onset == BETWEEN else 0.0


def velocities(path: np.ndarray, steps: np.ndarray, time_step: float) -> np.ndarray:
    """Velocity of a simulated contact at some steps, shape [M, 3] [scene units/s].

    Args:
        path: displacement after every step, shape [T, 3]; before the first it is 0.
        steps: indices into it, shape [M].
        time_step: [s].
    """
    return np.gradient(np.concatenate([np.zeros((1, 3)), path]), time_step, axis=0)[1:][steps]


def onset_covariance(jacobian: np.ndarray, velocity: np.ndarray, prior: np.ndarray, interval: float) -> np.ndarray:
    """Covariance of φ that an unknown beginning within ±`interval` [s] adds, shape [3, 3].

    Args:
        jacobian: derivatives of the observed motion by φ, in units of its noise, shape [R, 3].
        velocity: its derivative by time, in units of the noise, shape [R] [1/s].
        prior: information of the box, shape [3, 3].
        interval: [s].
    """
    moved = np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ velocity)
    return np.outer(moved, moved) * interval**2 / 3
