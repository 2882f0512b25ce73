"""Identities of instruments: a number for each, kept from frame to frame and when it crosses another."""

import cv2
import numpy as np

from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.flow import FlowCarrier

MISSED = 12
"""Number of frames in a row for which an unseen instrument keeps its number and its place."""


class InstrumentNumbers:
    """Numbers the instruments of a clip from 1 on, from left to right as they are first seen."""

    def __init__(self) -> None:
        self._carrier = FlowCarrier()
        self._gray: np.ndarray | None = None
        self._numbers = np.zeros((0, 0), np.uint8)
        """Numbers of the instruments at every pixel in the frame before."""
        self._missed: dict[int, int] = {}
        """Number of frames for which each instrument has not been seen."""
        self._next = 1

    def push(self, prepared: PreparedFrame) -> np.ndarray:
        """The number of the instrument at every pixel of the next frame's grid, 0 = none, uint8 [h, w]."""
        tool = (prepared.labels == TOOL).astype(np.uint8)
        before = self._moved(prepared)
        numbers = np.zeros_like(tool)
        count, parts, stats, middles = cv2.connectedComponentsWithStats(tool)
        for index in sorted(range(1, count), key=lambda part: middles[part][0]):
            # Parts of a mask with fewer pixels are no instrument [grid pixels²].
            if stats[index, cv2.CC_STAT_AREA] >= 8:
                part = parts == index
                numbers[part] = self._of(part, before)
        missed = {each: 0 if (numbers == each).any() else count + 1 for each, count in self._missed.items()}
        self._missed = {each: count for each, count in missed.items() if count <= MISSED}
        kept = np.where(np.isin(before, [each for each, count in self._missed.items() if count]), before, 0)
        self._numbers = np.where(numbers > 0, numbers, kept).astype(np.uint8)
        return numbers

    def _of(self, part: np.ndarray, before: np.ndarray) -> np.ndarray | int:
        """Number of the instrument that a part of a mask shows, bool [h, w], or numbers of its pixels [P]."""
        shared, sizes = (np.bincount(values, minlength=256) for values in (before[part], before.ravel()))
        share = shared / np.maximum(np.minimum(sizes, part.sum()), 1)
        share[0] = 0
        # A part is, or holds, an instrument that shares so much of the smaller of the two with it.
        found = np.flatnonzero(share > 0.3)
        if len(found) > 1:  # they cross: every pixel belongs to the one it is nearest to
            away = [cv2.distanceTransform((before != each).astype(np.uint8), cv2.DIST_L2, 3)[part] for each in found]
            return found[np.argmin(away, axis=0)]
        if share.max() == 0:
            number, self._next = self._next, min(self._next + 1, 255)
            self._missed[number] = 0
            return number
        return int(share.argmax())

    def _moved(self, prepared: PreparedFrame) -> np.ndarray:
        """The numbers of the frame before, moved along the optical flow where there are several, uint8 [h, w]."""
        before, shape = self._gray, prepared.labels.shape
        self._gray = None
        if prepared.visible and (prepared.labels == TOOL).any():
            self._gray = cv2.resize(prepared.shown.gray, shape[::-1], interpolation=cv2.INTER_AREA)
        if self._numbers.shape != shape:
            return np.zeros(shape, np.uint8)
        if before is None or self._gray is None or len(self._missed) < 2:
            return self._numbers
        return self._carrier.carried(self._numbers, before, self._gray, cv2.INTER_NEAREST)
