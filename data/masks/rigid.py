"""An instrument that is tracked as a rigid body seen from a little nearer or farther, from an outline on.

A similarity is fitted to tracks of points in and at the outline (pyramidal Lucas and Kanade) from the picture in which
it was drawn or, if that fails, from the last picture in which it was found.
"""

from functools import cached_property

import cv2
import numpy as np

from palpate.data.tracks.linking import followed

FEWEST = 6
"""Smallest number of points that determine an instrument's motion."""


class RigidInstrument:
    """One instrument, tracked from the picture in which it is outlined.

    Args:
        outline: corners (column, row), shape [K, 2] [px], also beyond the picture's edge.
        gray: the picture, uint8 [h, w].
    """

    def __init__(self, outline: np.ndarray, gray: np.ndarray) -> None:
        self.outline, self._last = outline, gray
        """Current outline, empty once the instrument has left the picture; and the picture in which it was seen."""
        self._reference, self._drawn, self._motion = gray, outline, np.eye(2, 3)
        self._largest = self._visible().sum()
        """Largest visible area so far [px²]."""

    @cached_property
    def _points(self) -> np.ndarray:
        """Points of the reference that are tracked, shape [N, 2] [px]."""
        near = cv2.dilate(self._visible(), np.ones((5, 5), np.uint8))  # its edges are often all that shows
        found = cv2.goodFeaturesToTrack(self._reference, 200, qualityLevel=0.005, minDistance=4, mask=near)
        return np.empty((0, 2), np.float32) if found is None else found[:, 0]

    def _visible(self) -> np.ndarray:
        return filled(np.zeros(self._last.shape, np.uint8), self.outline, 1)

    def follow(self, gray: np.ndarray) -> bool:
        """Track the instrument into the next picture; return whether it is found, or has left the picture."""
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
        """Motion since the reference, shape [2, 3]; None if too few points agree."""
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
        if found is None or agree.sum() < max(FEWEST, 0.4 * known.sum()):
            return None
        return found


def filled(labels: np.ndarray, outline: np.ndarray, label: int) -> np.ndarray:
    """A label map [H, W], in which a polygon [K, 2] (column, row) [px] has got a label."""
    if len(outline):
        cv2.fillPoly(labels, [np.rint(outline).astype(np.int32)], label)
    return labels
