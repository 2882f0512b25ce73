"""A frame and how the colour of its tissue differs from that at rest: where instruments are, where a dent is."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from palpate.common.robust import median_sd
from palpate.data.contact.tips import JAWS, tool_tips
from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import FINE
from palpate.data.shading.registration import View
from palpate.data.tracks.following import lit_field

LEAST_TIP = 6
"""Smallest mask of an instrument's free end [grid pixels²]."""
REDDER = 0.06
"""A dent is redder than at rest by at least this [logarithm]."""
DENT, AROUND, FAR = 6.0, 20.0, 50.0
"""Radius of a dent at most; motion so near to it is that of its instrument; its instrument's free end lies this near,
since masks may end before instruments do [grid pixels]."""


@dataclass(eq=False)
class LitFrame:
    """A frame and how the colour of its tissue differs from that at rest, in the view of the reference."""

    prepared: PreparedFrame
    make_light: Callable[[], np.ndarray]
    """Return the light as in `log_light`."""
    make_grey: Callable[[], np.ndarray]
    """Return the logarithm of the picture's grey levels on the lattice, instruments and all."""
    view: View
    """Place of the frame's grid in the reference's."""
    near: np.ndarray
    """Distance of every place of the lattice from instruments' free ends [grid pixels]."""
    compared: bool = False
    """True once it has been compared with the tissue at rest."""
    change: np.ndarray | None = None
    """Logarithm of red over the other colours less that at rest, averaged around every place; None where it isn't
    known, or where so much changes that a dent would not show."""
    noise: float = math.inf
    """Standard deviation of the change where nothing presses."""
    dent: np.ndarray | None = None
    """Row and column of the middle of what has reddened most [grid pixels]; None where nothing clearly has."""

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        make_light: Callable[[], np.ndarray],
        view: View,
        registered: Callable[[], tuple[np.ndarray, np.ndarray]],
    ) -> "LitFrame":
        """Return a frame and where its instruments are; nothing is compared yet.

        Args:
            registered: returns picture and labels in the view of the reference.
        """
        rows, columns = prepared.labels.shape
        size, ends = (FINE * columns, FINE * rows), np.zeros((rows, columns), np.uint8)
        if prepared.shown.tool.any():
            picture, labels = registered()
            tool, lit = (part.astype(np.uint8) for part in (labels == TOOL, lit_field(picture)))
            tool = cv2.resize(tool, (columns, rows), interpolation=cv2.INTER_NEAREST_EXACT) > 0
            for tip in tool_tips(tool, cv2.resize(lit, (columns, rows)) > 0, JAWS, LEAST_TIP):
                ends[tip[:, 1], tip[:, 0]] = 1
        near = np.full(size[::-1], np.inf)
        if ends.any():
            near = cv2.resize(cv2.distanceTransform(1 - ends, cv2.DIST_L2, 3), size)
        return cls(prepared, make_light, cache(lambda: log_grey(registered()[0], size)), view, near)

    def look(self, within: np.ndarray, least: float) -> None:
        """Look for a dent: what has reddened most and is no texture that has moved, which pales beside it.

        Args:
            within: places of the lattice where one may be, apart from the picture's edge.
            least: change of a dent.
        """
        assert self.change is not None
        edge, found = round(FINE * DENT), np.zeros_like(self.change)
        inner = slice(edge, -edge), slice(edge, -edge)
        found[inner] = np.where(within & np.isfinite(self.change), self.change, 0.0)[inner]
        row, column = divmod(int(np.argmax(found)), found.shape[1])
        strength, window = found[row, column], _around((row, column), DENT)
        around = self.change[window]
        if strength < least or -np.nanmin(around) >= 0.5 * strength:
            return
        weights = np.where(around > 0.5 * strength, around, 0.0).ravel()
        places = np.indices(around.shape).reshape(2, -1) + [[part.start] for part in window]
        self.dent = (places @ weights / weights.sum() + 0.5) / FINE - 0.5

    def change_at(self, place: np.ndarray) -> float:
        """Return the largest change within a grid pixel of a place; NaN where none shows."""
        if self.change is None:
            return math.nan
        around = self.change[_around(_lattice(place), 1.0)]
        return float(np.nanmax(around)) if np.isfinite(around).any() else math.nan

    def distance(self, place: np.ndarray) -> float:
        """Return the distance of an instrument's free end from a place [grid pixels]."""
        return float(self.near[tuple(_lattice(place))])

    def moved(self, before: "LitFrame", place: np.ndarray) -> int:
        """Return how many places of the lattice around a dent show something else than in the frame before.

        That is an instrument that comes or goes, however badly its mask outlines it.
        """
        middle = _lattice(place)
        window, now, then = _around(middle, AROUND), self.make_grey(), before.make_grey()
        noise = median_sd((now - then)[::4, ::4].ravel())
        changes = np.abs(now[window] - then[window]) > max(0.1, 6 * noise)
        rows, columns = np.ogrid[tuple(map(slice, changes.shape))]
        away = np.hypot(rows + window[0].start - middle[0], columns + window[1].start - middle[1]) / FINE
        # The dent itself grows.
        return int(changes[(away > DENT - 2) & (away < AROUND)].sum())


def _lattice(place: np.ndarray) -> np.ndarray:
    """Return row and column on the lattice of a place [grid pixels]."""
    return np.rint(FINE * (np.asarray(place) + 0.5) - 0.5).astype(int)


def _around(place: Sequence[int] | np.ndarray, reach: float) -> tuple[slice, slice]:
    """Return rows and columns of the lattice up to so many grid pixels from a place on it."""
    size = round(FINE * reach)
    row, column = (int(part) for part in place)
    return slice(max(row - size, 0), row + size + 1), slice(max(column - size, 0), column + size + 1)


def log_grey(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the logarithm of a picture's grey levels on a lattice of so many columns and rows, float32."""
    grey = cv2.resize(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA)
    return np.log(grey.astype(np.float32) + 8)
