"""An instrument cut out by strokes: the network's probability refined by GrabCut (Rother 2004)."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.data.masks.automatic import AutomaticMasks


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line that a person draws over an instrument, or beside it."""

    points: np.ndarray
    """Column and row, shape [N, 2] [px]; a single one is a click."""
    instrument: bool = True
    """True if the stroke is on the instrument, False if it is beside it."""


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
        share, pen = 480 / max(picture.shape[:2]), 5  # longer side of the picture that is cut; width of a stroke [px]
        size = max(round(picture.shape[1] * share), 16), max(round(picture.shape[0] * share), 16)
        probability = cv2.resize(self._masks.probability(picture), size, interpolation=cv2.INTER_LINEAR)
        ends = ((np.vstack([each.points, each.points[-1:]]), each.instrument) for each in strokes)  # a click is a dot
        lines = [(np.rint(points * share).astype(np.int32)[:, None], instrument) for points, instrument in ends]
        on, guess = np.zeros((2, *size[::-1]), np.uint8)
        for polygon in begin:
            cv2.fillPoly(guess, [np.rint(polygon * share).astype(np.int32)], 1)
        for line, instrument in lines:
            cv2.polylines(on, [line], False, int(instrument), pen)
            cv2.polylines(guess, [line], False, int(instrument), 9)  # begins as instrument
        guess |= _touched((probability > 0.5).astype(np.uint8), on)
        far = cv2.distanceTransform(1 - guess, cv2.DIST_L2, 3) > 40  # the cut moves an outline no farther
        labels = np.where(far, cv2.GC_BGD, np.where(guess > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD)).astype(np.uint8)
        for line, instrument in lines:
            cv2.polylines(labels, [line], False, cv2.GC_FGD if instrument else cv2.GC_BGD, pen)
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
        return [polygon / share for each in found if len(polygon := cv2.approxPolyDP(each, 0.75, True)[:, 0]) > 2]


def _touched(mask: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Connected parts of a mask [h, w] that strokes [h, w] touch, uint8 [h, w]."""
    _, numbers = cv2.connectedComponents(mask)
    return (np.isin(numbers, numbers[on > 0]) & (numbers > 0)).astype(np.uint8)
