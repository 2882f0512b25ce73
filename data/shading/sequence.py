"""The shading sequence of a contact: light around it, frame by frame, and that of the tissue at rest.

Gain and slow changes of the light over the picture are measured on tissue far from the contact and taken off.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.common.robust import median_sd
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import FINE
from palpate.data.shading.registration import View

REACH = 7
"""Tissue up to so many rows and columns from the contact is compared [grid pixels]."""
MARGIN = 3
"""Around that what may come to be seen there is known, too [grid pixels]."""
SIDE = FINE * (2 * (REACH + MARGIN) + 1)
"""Places along either axis of that square."""
PLACES = (np.arange(SIDE) + 0.5) / FINE - 0.5 - REACH - MARGIN
"""Their rows, or columns, from the contact, shape [SIDE] [grid pixels]."""
KEPT = 8
"""Frames before a contact whose median is the light at rest."""
LEAST_SD = 0.002
"""Least noise of the logarithm of light, half a level of 8 bits: coded video repeats what hardly changes."""
SPARSE = 3
"""Every so many places along an axis tell the gain."""


@dataclass(frozen=True, eq=False)
class ShadingSequence:
    """Light around a contact over a run; N frames, a square of L = SIDE places along either axis."""

    times: np.ndarray
    """Since the onset, shape [N] [s]."""
    light: np.ndarray
    """Logarithms of red, green and blue, gains taken off, shape [N, 3, L, L], float32; not a number where no tissue
    is seen."""
    rest: np.ndarray
    """Light at rest, shape [3, L, L]."""
    noise: np.ndarray
    """Standard deviation of the difference of light and rest where tissue is still, by colour, shape [3]."""

    def chosen(self, frames: np.ndarray) -> ShadingSequence:
        """Some of its frames: a mask [N] or indices."""
        return dataclasses.replace(self, times=self.times[frames], light=self.light[frames])


def slow_change(places: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Gain and slow changes of the light over the picture, and the standard deviation that they leave.

    Args:
        places: rows and columns in shares of the picture's larger side, shape [K, 2].
        change: of the light's logarithm since rest there, shape [K]; not a number where it isn't known.

    Returns:
        Coefficients of 1, row and column, shape [3], and that; None where too few places are known.
    """
    known = np.isfinite(change)
    terms = np.column_stack([np.ones(len(places)), places])
    gain, sd = np.zeros(3), np.inf
    for _ in range(3):
        if known.sum() < 500:
            return None
        gain = np.linalg.lstsq(terms[known], change[known], rcond=None)[0]
        left = change - terms @ gain
        sd = max(median_sd(left[known]), LEAST_SD)
        # Places that differ by more are no still tissue.
        known = known & (np.abs(left) <= 3.0 * sd)
    return gain, sd


def change_of_light(light: np.ndarray, rest: np.ndarray) -> np.ndarray | None:
    """Logarithm of light over that at rest, gain and slow changes taken off; None where they aren't known.

    Args:
        light, rest: of the same quantity, e.g. `brightness`, shape [h, w].
    """
    rows, columns = (np.arange(size, dtype=np.float32) / max(rest.shape) for size in rest.shape)
    change = light - rest
    some = change[::SPARSE, ::SPARSE].ravel()
    places = np.stack(np.meshgrid(rows[::SPARSE], columns[::SPARSE], indexing="ij"), axis=-1).reshape(-1, 2)
    found = slow_change(places, some)
    if found is None:
        return None
    gain = found[0].astype(np.float32)
    return change - (gain[0] + gain[1] * rows)[:, None] - gain[2] * columns


def smoothed(change: np.ndarray, darker: np.ndarray | None = None) -> np.ndarray:
    """Return the mean change around every place of the lattice, shape [h, w]; NaN where little tissue shows.

    Args:
        change: of the light's logarithm, or of its colour's, since rest, shape [h, w].
        darker: of the light's logarithm, if that is another, shape [h, w].
    """
    # What is darker than at rest by more, as a logarithm, is a part of the instrument that its mask leaves out.
    dark = (change if darker is None else darker) < -1.2
    instrument = cv2.dilate(dark.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    known = np.isfinite(change) & ~instrument
    # Standard deviation of the weights with which changes are averaged [grid pixels].
    weights, sums = (
        cv2.GaussianBlur(part.astype(np.float32), (0, 0), FINE * 1.0) for part in (known, np.where(known, change, 0))
    )
    # This share of the weights must lie on tissue.
    return np.where(weights >= 0.3, sums / np.maximum(weights, 1e-6), np.nan)


class RestingLight:
    """The light of tissue at rest: the median of the last frames before a contact."""

    def __init__(self) -> None:
        self._frames: deque[Callable[[], np.ndarray]] = deque(maxlen=KEPT)
        self._median: np.ndarray | None = None
        """Median light that was asked for last."""
        self._later = 0
        """Frames since then."""

    def push(self, light: Callable[[], np.ndarray]) -> None:
        """Take the next frame out of contact, by what returns its light as in `log_light`."""
        self._frames.append(light)
        self._later += 1

    def clear(self) -> None:
        """Forget what was seen."""
        self._frames.clear()
        self._median = None

    def __len__(self) -> int:
        return len(self._frames)

    def median(self, without: int = 0) -> np.ndarray:
        """Return the median light of the frames, at least one, place by place; not a number where no frame shows
        tissue.

        Args:
            without: so many of the last frames may be left out, to save time.
        """
        if self._median is None or self._later > without:
            self._median, self._later = _median(np.stack([light() for light in self._frames])), 0
        return self._median


def _median(frames: np.ndarray) -> np.ndarray:
    """Return `numpy.nanmedian` of a few arrays [K, …] along their first axis, in a fraction of the time."""
    ordered, known = np.sort(frames, axis=0), np.isfinite(frames).sum(axis=0)  # what isn't a number comes last
    below, above = (
        np.take_along_axis(ordered, np.maximum(at, 0)[None], axis=0)[0] for at in ((known - 1) // 2, known // 2)
    )
    return (below + above) / 2


class ShadingRecorder:
    """Gathers the shading sequence of one run of contact.

    Args:
        rest: light at rest, as in `log_light`.
        pixel: row and column of the contact in the onset's frame [grid pixels].
        view: in which the onset's light lies; None = the frame's own, of a camera that stands still.
    """

    def __init__(self, rest: np.ndarray, pixel: np.ndarray, view: View | None = None) -> None:
        pixel = pixel if view is None else np.rint(view.moved(pixel)).astype(np.int64)
        self._reference = None if view is None else view.reference
        first = FINE * (np.asarray(pixel, np.int64) - REACH - MARGIN)
        self._window = tuple(np.ix_(*(begin + np.arange(SIDE) for begin in first)))
        height, width = rest.shape[1:]
        self._inside = (self._window[0] >= 0) & (self._window[0] < height)
        self._inside = self._inside & (self._window[1] >= 0) & (self._window[1] < width)
        self._rest = self._cut(rest)
        rows, columns = (part.ravel() for part in np.mgrid[:height:SPARSE, :width:SPARSE])
        far = (np.abs(np.stack([rows, columns]) - first[:, None] - SIDE // 2) > SIDE // 2).any(axis=0)
        self._far = slice(None), rows[far], columns[far]
        self._far_rest = rest[self._far]
        self._places = np.stack(self._far[1:], axis=1) / max(height, width)
        self._middle = np.stack(np.broadcast_arrays(1.0, *(part / max(height, width) for part in self._window)))
        self._noise: list[list[float]] = []

    def _cut(self, light: np.ndarray) -> np.ndarray:
        rows, columns = (np.clip(part, 0, size - 1) for part, size in zip(self._window, light.shape[1:], strict=True))
        return np.where(self._inside, light[:, rows, columns], np.nan)

    def frame(self, frame: PreparedFrame) -> np.ndarray | None:
        """Return a frame's light around the contact; None where light or gain isn't known, or of another reference."""
        light, view = frame.light, frame.light_view
        if light is None or (None if view is None else view.reference) != self._reference:
            return None
        found = [slow_change(self._places, colour) for colour in light[self._far] - self._far_rest]
        if None in found:
            return None
        gains, sds = zip(*found, strict=True)
        self._noise.append(sds)
        return (self._cut(light) - np.tensordot(gains, self._middle, 1)).astype(np.float32)

    def record(self, times: np.ndarray, light: list[np.ndarray], _: int = 0) -> ShadingSequence:
        """Return the sequence of some frames, times since the onset [s]."""
        stacked = np.stack(light) if light else np.empty((0, 3, SIDE, SIDE), np.float32)
        noise = np.median(self._noise, axis=0) if self._noise else np.full(3, np.nan)
        return ShadingSequence(np.asarray(times, np.float64), stacked, self._rest, noise)
