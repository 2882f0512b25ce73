"""The deepest dent, or bump, of tissue that is pressed where no tool is in view, to which the force is proportional.

On a linear sheet that is pressed on one patch every displacement is the force times a shape.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter, median_filter

MOST_REST, LEAST_REST = 64, 3
"""Most depth maps at rest that are kept for their median, and fewest that it needs."""
MEDIAN_WIDTH, BLUR_SD = 5, 2.0
"""Widths of the filters against a depth sensor's noise [grid px]."""
MAX_CHANGE = 0.1
"""A larger change is the sensor's error [scene units]."""


class DentRecorder:
    """Follows a clip's deepest dent, a frame at a time.

    Args:
        rest_s: first and last time at which nothing presses [s].
    """

    def __init__(self, rest_s: tuple[float, float]) -> None:
        self._rest_s = rest_s
        self._at_rest: list[np.ndarray] = []
        self._rest: np.ndarray | None = None
        self.frames: list[int] = []
        """Numbers of the frames after rest."""
        self.times: list[float] = []
        """Time stamps of these frames [s]."""
        self.depths: list[float] = []
        """Deepest dents in these frames [scene units]."""

    def push(self, number: int, time_s: float, depth: np.ndarray) -> None:
        """Record the next frame.

        Args:
            number: number of the frame.
            time_s: time stamp of the frame [s].
            depth: z on the grid, shape [h, w] [scene units], 0 = invalid.
        """
        if time_s <= self._rest_s[1]:
            if time_s >= self._rest_s[0] and len(self._at_rest) < MOST_REST and (depth > 0).any():
                self._at_rest.append(depth)
            return
        if self._rest is None and len(self._at_rest) >= LEAST_REST:
            self._rest = median_of_valid(self._at_rest)
            self._at_rest.clear()
        if self._rest is not None and (depth > 0).any():
            self.frames.append(number)
            self.times.append(time_s)
            self.depths.append(deepest(depth, self._rest))


def median_of_valid(maps: Sequence[np.ndarray]) -> np.ndarray:
    """Median of depth maps where half of them or more are valid, 0 elsewhere, shape [h, w]."""
    stack = np.stack(maps)
    valid = (stack > 0).mean(axis=0) >= 0.5
    middle = np.nanmedian(np.where((stack > 0) | ~valid, stack, np.nan), axis=0)
    return np.where(valid, middle, 0)


def deepest(depth: np.ndarray, rest: np.ndarray) -> float:
    """Largest smoothed change of depth against rest, in either direction [scene units]."""
    change = np.where((depth > 0) & (rest > 0), rest - depth, 0)
    change = median_filter(change, MEDIAN_WIDTH)
    change[np.abs(change) > MAX_CHANGE] = 0
    return float(np.abs(gaussian_filter(change, BLUR_SD)).max())
