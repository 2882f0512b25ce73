"""An instrument that is followed as a rigid body seen from a little nearer or farther, from an outline on.

Points in and at the outline are followed by pyramidal Lucas and Kanade from the picture in which it was drawn, and a
similarity is fitted to them; where that fails, from the last picture in which it was found.
"""

from functools import cached_property

import cv2
import numpy as np

from palpate.data.tracks.linking import followed

WORKING_SIZE = 640
"""Longer side that pictures are brought to, so that lengths mean the same everywhere [px]."""
MOST_POINTS, SPACING, TEXTURE = 200, 4, 0.005
"""Followed points of an instrument, their least distance [px] and their least contrast, as a share of the best."""
FEWEST, LEAST_SHARE = 6, 0.4
"""Fewer points, or a smaller share of those that were found again, that agree on a motion tell none."""


class RigidInstrument:
    """One instrument, followed from the picture in which it is outlined.

    Args:
        outline: corners (column, row), shape [K, 2] [px], also beyond the picture's edge.
        gray: the picture, uint8 [h, w].
    """

    def __init__(self, outline: np.ndarray, gray: np.ndarray) -> None:
        self.outline, self._last = outline, gray
        """Where it is now, none once it has left the picture; and the picture in which it was seen there."""
        self._reference, self._drawn, self._motion = gray, outline, np.eye(2, 3)
        self._largest = self._visible().sum()
        """How much of it has shown at most [px²]."""

    @cached_property
    def _points(self) -> np.ndarray:
        """Points of the reference that are followed, shape [N, 2] [px]."""
        near = cv2.dilate(self._visible(), np.ones((5, 5), np.uint8))  # its edges are often all that shows
        found = cv2.goodFeaturesToTrack(self._reference, MOST_POINTS, TEXTURE, SPACING, mask=near)
        return np.empty((0, 2), np.float32) if found is None else found[:, 0]

    def _visible(self) -> np.ndarray:
        return filled(np.zeros(self._last.shape, np.uint8), self.outline, 1)

    def follow(self, gray: np.ndarray) -> bool:
        """Whether it is found in the next picture, or has left it."""
        if not len(self.outline):
            return True
        motion = self._moved(gray)
        if motion is None and self._reference is not self._last:
            # It has turned, or come nearer, too far for the first picture's pattern.
            self._reference, self._drawn, self._motion = self._last, self.outline, np.eye(2, 3)
            del self._points
            motion = self._moved(gray)
        if motion is not None:
            self._motion, self._last = motion, gray
            self.outline = cv2.transform(self._drawn[:, None], motion)[:, 0]
            self._largest = max(self._largest, self._visible().sum())
        # An instrument that isn't found has left the picture if less than this share of what showed of it at most did
        # last.
        elif self._visible().sum() < 0.25 * self._largest:
            self.outline = self.outline[:0]
        return motion is not None or not len(self.outline)

    def _moved(self, gray: np.ndarray) -> np.ndarray | None:
        """Its motion since the reference, shape [2, 3]; None where too few points agree."""
        if len(self._points) < FEWEST:
            return None
        expected = cv2.transform(self._points[:, None], self._motion)[:, 0]
        step, known = followed(self._reference, gray, self._points, near=expected)
        if known.sum() < FEWEST:
            return None
        there = (self._points + step).astype(np.float32)
        # Points agree with a motion that takes them so near to where they are [px].
        found, agree = cv2.estimateAffinePartial2D(
            self._points[known], there[known], method=cv2.RANSAC, ransacReprojThreshold=1.5
        )
        if found is None or agree.sum() < max(FEWEST, LEAST_SHARE * known.sum()):
            return None
        return found


def filled(labels: np.ndarray, outline: np.ndarray, label: int) -> np.ndarray:
    """A label map [H, W], in which a polygon [K, 2] (column, row) [px] has got a label."""
    if len(outline):
        cv2.fillPoly(labels, [np.rint(outline).astype(np.int32)], label)
    return labels
