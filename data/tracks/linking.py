"""Where the places of one picture are in another one, by dense optical flow checked forwards and backwards.

Dense inverse search flow (Kroeger 2016, OpenCV's DIS) of pictures of half the size, which begins at what is known
already; the check is Kalal 2010's.
"""

from __future__ import annotations

import cv2
import numpy as np

STRIDE, DESCENTS = 6, 12
"""Of DIS: distance of its patches [px], and steps of each; its finest scale is the halved picture's own."""
BLUR = 2.0
"""Standard deviation of the filter in place of DIS's variational refinement, which costs twice as much [px]."""
REACH, STEP = 6, 3
"""Of a pattern around a point, to either side, and between its samples [px]."""


class Linker:
    """Links pictures of one size.

    Args:
        shape: of the pictures (height, width) [px].
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._flow.setFinestScale(0)
        self._flow.setPatchStride(STRIDE)
        self._flow.setGradientDescentIterations(DESCENTS)
        self._flow.setVariationalRefinementIterations(0)
        height, width = shape
        self.size = max(width // 2, 1), max(height // 2, 1)
        """Width and height of the halved pictures [px]."""
        self.shares = (np.array([width, height]) / self.size).astype(np.float32)
        """Of the whole pictures over these."""

    def half(self, picture: np.ndarray) -> np.ndarray:
        """A picture [H, W] of half the size, uint8."""
        return cv2.resize(picture, self.size, interpolation=cv2.INTER_AREA)

    def link(
        self, one: np.ndarray, other: np.ndarray, places: np.ndarray, guess: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Places of one picture in the other, and how far from them the way back ends.

        Args:
            one, other: halved pictures.
            places: shape [N, 2] (column, row) [px].
            guess: flow from which to begin, float32 [H/2, W/2, 2] in pixels of the halved pictures, which is written
                over; None = none.

        Returns:
            Places there [N, 2] and distances [N] [px], float32.
        """
        against = None if guess is None else -guess  # before a flow is written over its guess
        there, back = self._found(one, other, guess), self._found(other, one, against)
        step = self._sampled(there, places)
        return places + step, np.linalg.norm(step + self._sampled(back, places + step), axis=1)

    def _found(self, one: np.ndarray, other: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
        flow = self._flow.calc(one, other, guess)  # ty: ignore[no-matching-overload]  None is a guess
        return cv2.GaussianBlur(flow, (0, 0), BLUR)

    def _sampled(self, field: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Bilinear values of a flow at places of the whole picture [N, 2], in its pixels."""
        if not len(places):
            return np.zeros((0, 2), np.float32)
        at = (places + 0.5) / self.shares - 0.5
        columns, rows = (np.ascontiguousarray(at[:, [axis]], np.float32) for axis in (0, 1))
        values = cv2.remap(field, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return values.reshape(-1, 2) * self.shares


def resemblance(one: np.ndarray, other: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Correlation of the patterns around places [N, 2] of two pictures [H, W], shape [N], from -1 to 1."""
    if not len(here):
        return np.zeros(0, np.float32)
    steps = np.arange(-REACH, REACH + 1, STEP, dtype=np.float32)
    around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)

    def pattern(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
        columns, rows = np.moveaxis((places[:, None] + around).astype(np.float32), -1, 0)
        values = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return values - values.mean(axis=1, keepdims=True, dtype=np.float32)

    first, second = pattern(one, here), pattern(other, there)
    power = np.square(first).sum(axis=1) * np.square(second).sum(axis=1)
    return (first * second).sum(axis=1) / np.sqrt(np.maximum(power, 1))
