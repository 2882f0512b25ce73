"""What the tissue around a point looked like, to find it again: flow from frame to frame drifts, this does not."""

from __future__ import annotations

import cv2
import numpy as np

from palpate.data.contact.outlines import near
from palpate.data.labels import TISSUE, TOOL

RADIUS = 32
"""Half side of the patch [px]."""
REACH = 8
"""Largest correction along each axis [px]."""
TOOL_MARGIN = 12
"""Pixels this near to the tool (its shadow, its highlights) are not compared [px]."""
LEAST_SHARE = 0.3
"""Share of the patch's pixels that must be tissue in both frames."""
LEAST_CORRELATION = 0.7
"""Weaker matches are no match."""


class TissueTemplate:
    """A patch of tissue that is found again by normalised correlation, pixels of the tool left out in both frames."""

    def __init__(self, image: np.ndarray, labels: np.ndarray, point: np.ndarray) -> None:
        """
        Args:
            image: RGB, uint8, shape [H, W, 3].
            labels: label map, shape [H, W].
            point: (u, v) [px].
        """
        self._offset = point - np.rint(point)
        self._patch, self._usable = _crop(image, labels, np.rint(point).astype(int), RADIUS)

    def locate(self, image: np.ndarray, labels: np.ndarray, near: np.ndarray) -> np.ndarray | None:
        """The point in another picture, within REACH of `near` (u, v), or None where nothing matches well.

        Returns:
            (u, v) [px], to a fraction of a pixel.
        """
        centre = np.rint(near - self._offset).astype(int)
        picture, usable = _crop(image, labels, centre, RADIUS + REACH)
        score = _correlation(self._patch, self._usable, picture, usable)
        row, column = np.unravel_index(np.argmax(score), score.shape)
        inside = 0 < row < 2 * REACH and 0 < column < 2 * REACH
        if not inside or score[row, column] < LEAST_CORRELATION:
            return None
        across = _peak(score[row, column - 1 : column + 2])
        down = _peak(score[row - 1 : row + 2, column])
        return centre + self._offset + (column + across - REACH, row + down - REACH)


def _crop(image: np.ndarray, labels: np.ndarray, centre: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Grey square around a pixel, float32, and where it shows tissue away from the tool (outside: nowhere)."""
    margin = 2 * (radius + TOOL_MARGIN)
    left, top = centre + margin // 2
    window = np.s_[top : top + margin + 1, left : left + margin + 1]
    grey = np.pad(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), margin)[window].astype(np.float32)
    kinds = np.pad(labels, margin)[window]
    inner = np.s_[TOOL_MARGIN:-TOOL_MARGIN, TOOL_MARGIN:-TOOL_MARGIN]
    return grey[inner], ((kinds == TISSUE) & ~near(kinds == TOOL, TOOL_MARGIN))[inner]


def _correlation(patch: np.ndarray, known: np.ndarray, picture: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Normalised correlation of a patch at every shift within a larger picture, over the pixels usable in both.

    Args:
        patch, known: grey values and usable pixels of the patch, shape [2R+1, 2R+1].
        picture, usable: the same of the picture, shape [S, S].

    Returns:
        Shape [S-2R, S-2R]; -1 where too few pixels are usable.
    """
    # Around the patch's mean, so that single precision loses nothing to the square of a large mean.
    middle = float(patch[known].mean()) if known.any() else 0.0
    ours, theirs = known.astype(np.float32), usable.astype(np.float32)
    first, second = (patch - middle) * ours, (picture - middle) * theirs

    def total(large: np.ndarray, small: np.ndarray) -> np.ndarray:
        return cv2.matchTemplate(large, small, cv2.TM_CCORR).astype(np.float64)

    count = np.rint(total(theirs, ours))
    safe = np.maximum(count, 1)
    mean_first, mean_second = total(theirs, first) / safe, total(second, ours) / safe
    covariance = total(second, first) / safe - mean_first * mean_second
    spread = (total(theirs, first * first) / safe - mean_first**2) * (
        total(second * second, ours) / safe - mean_second**2
    )
    enough = (count >= LEAST_SHARE * patch.size) & (spread > 1e-6)
    return np.where(enough, covariance / np.sqrt(np.where(enough, spread, 1)), -1)


def _peak(values: np.ndarray) -> float:
    """Place of a parabola's peak through three values at -1, 0, 1."""
    curvature = values[0] - 2 * values[1] + values[2]
    return 0.0 if curvature >= 0 else float(np.clip(0.5 * (values[0] - values[2]) / curvature, -0.5, 0.5))
