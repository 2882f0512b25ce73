"""What a user gives in place of what a clip shows: which tissue is pinned, and where the gripper goes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.data.source.frames import Frame
from palpate.data.source.images import printable, read_image
from palpate.data.source.layout import InputError
from palpate.data.source.table import read_series
from palpate.estimators.estimate import NoEstimate

WHITE = 128
"""Where all channels have this much of 255 a mask is white."""
COLUMNS = ("time_s", "x_px", "y_px", "z")
ROUNDED = 1e-3
"""Rows of a path reach farther by this, since their times are rounded [s]."""


@dataclass(frozen=True, eq=False)
class Pins:
    """A mask of what is pinned."""

    path: Path
    white: np.ndarray
    """Pixels of the clip's pictures, free of lens distortion, shape [H, W], bool."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        height, width = self.white.shape
        return width, height

    def require_size(self, size: tuple[int, int]) -> None:
        """Raise an InputError unless pictures of such width and height [px] have its pixels."""
        if self.size != size:
            said = "is {}x{}, the clip's pictures are {}x{}".format(*self.size, *size)
            raise InputError(f"{printable(self.path)} {said}; give a mask of the size of the clip's pictures.")

    def at(self, pixels: np.ndarray) -> np.ndarray:
        """Whether places [N, 2] (column, row) [px] are white, shape [N], bool."""
        column, row = np.clip(pixels.round().astype(int), 0, np.array(self.size) - 1).T
        return self.white[row, column]


@dataclass(frozen=True, eq=False)
class GripperPath:
    """Where a gripper is over time; K rows."""

    path: Path
    times: np.ndarray
    """Rising, in the clip's time, shape [K] [s]."""
    places: np.ndarray
    """Column and row in the clip's pictures, free of lens distortion [px], and depth [scene units], shape [K, 3]."""

    def at(self, time: float) -> np.ndarray | None:
        """Column, row and depth by a time [s], linear between rows, shape [3]; None where the rows don't reach."""
        if not self.times[0] - ROUNDED <= time <= self.times[-1] + ROUNDED:
            return None
        return np.array([np.interp(time, self.times, values) for values in self.places.T])

    def begun(self, frame: Frame) -> np.ndarray:
        """As `at`, in the frame in which contact begins.

        Raises:
            NoEstimate: the rows don't reach there.
        """
        place = self.at(frame.time_s)
        if place is None:
            said = f"tells no place at {frame.time_s:g} s, when contact begins in frame {frame.number}"
            raise NoEstimate(f"{printable(self.path)} {said}; give rows from before that time on.")
        return place


def read_pins(path: Path) -> Pins:
    """Read a mask: a picture whose white pixels are pinned.

    Raises:
        InputError: it can't be read, or nothing in it is white.
    """
    white = read_image(path).min(axis=2) >= WHITE
    if not white.any():
        raise InputError(f"{printable(path)} is white nowhere; paint what is pinned white, or leave pins out.")
    return Pins(path, white)


def read_path(path: Path) -> GripperPath:
    """Read a table with the columns COLUMNS.

    Raises:
        InputError: as of `read_series`.
    """
    times, *places = read_series(path, COLUMNS, "path of a gripper", 2).T
    return GripperPath(path, times, np.stack(places, axis=1))
