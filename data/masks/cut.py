"""An instrument cut out by strokes: what the network takes for it, refined by GrabCut (Rother 2004)."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.data.masks.automatic import AutomaticMasks

WORKING_SIZE = 480
"""Longer side of the picture that is cut [px]."""
PEN, AROUND, REACH = 5, 9, 40
"""Width of a stroke, of what begins as instrument around it, and how far the cut moves an outline [px of that]."""
ALIKE = 0.5
"""Probability from which a stroke takes a whole part that the network sees."""
TOLERANCE = 0.75
"""Largest distance between a polygon and the outline that it stands for [px of the working size]."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line that a person draws over an instrument, or beside it."""

    points: np.ndarray
    """Column and row, shape [N, 2] [px]; a single one is a click."""
    instrument: bool = True
    """Whether the instrument is there."""


class InstrumentCut:
    """Outlines instruments by strokes."""

    def __init__(self) -> None:
        self._masks = AutomaticMasks(threads=1)

    def outlines(
        self, picture: np.ndarray, strokes: Sequence[Stroke], begin: Sequence[np.ndarray] = ()
    ) -> list[np.ndarray]:
        """Polygons [K, 2] (column, row) [px] of an instrument's visible parts; none where no stroke is on it.

        Args:
            picture: RGB uint8 [H, W, 3].
            strokes: at least one over the instrument; later ones count more.
            begin: polygons that are taken for the instrument where no stroke says otherwise.
        """
        share = WORKING_SIZE / max(picture.shape[:2])
        size = max(round(picture.shape[1] * share), 16), max(round(picture.shape[0] * share), 16)
        probability = cv2.resize(self._masks.probability(picture), size, interpolation=cv2.INTER_LINEAR)
        ends = ((np.vstack([each.points, each.points[-1:]]), each.instrument) for each in strokes)  # a click is a dot
        lines = [(np.rint(points * share).astype(np.int32)[:, None], instrument) for points, instrument in ends]
        on, guess = np.zeros((2, *size[::-1]), np.uint8)
        for polygon in begin:
            cv2.fillPoly(guess, [np.rint(polygon * share).astype(np.int32)], 1)
        for line, instrument in lines:
            cv2.polylines(on, [line], False, int(instrument), PEN)
            cv2.polylines(guess, [line], False, int(instrument), AROUND)
        guess |= _touched((probability > ALIKE).astype(np.uint8), on)
        far = cv2.distanceTransform(1 - guess, cv2.DIST_L2, 3) > REACH
        labels = np.where(far, cv2.GC_BGD, np.where(guess > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD)).astype(np.uint8)
        for line, instrument in lines:
            cv2.polylines(labels, [line], False, cv2.GC_FGD if instrument else cv2.GC_BGD, PEN)
        if not on.any():
            return []
        if (labels == cv2.GC_BGD).any():  # GrabCut learns colours from both
            # Colours are lightness and redness; the third is what the network says.
            features = cv2.cvtColor(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2Lab)
            features[..., 2] = probability * 255
            models = np.zeros((2, 1, 65))
            cv2.grabCut(features, labels, (0, 0, 1, 1), models[0], models[1], 1, cv2.GC_INIT_WITH_MASK)
        cut = cv2.morphologyEx(labels & 1, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) | on
        found, _ = cv2.findContours(_touched(cut, on), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        return [polygon / share for each in found if len(polygon := cv2.approxPolyDP(each, TOLERANCE, True)[:, 0]) > 2]


def _touched(mask: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Connected parts of a mask [h, w] that strokes [h, w] touch, uint8 [h, w]."""
    _, numbers = cv2.connectedComponents(mask)
    return (np.isin(numbers, numbers[on > 0]) & (numbers > 0)).astype(np.uint8)
