"""Pictures of a camera that moves, brought into the view of an earlier one, so that places of tissue can be compared.

Tissue far from instruments is followed from the reference picture to the next ones, and a homography fitted, which is
exact where the camera turns or the tissue is flat.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from palpate.data.tracks.following import Shown, lattice, values_at
from palpate.data.tracks.linking import followed

SPACING, GUARD = 32, 24
"""Distances of the points that are followed, and how far from an instrument they begin [px of a picture 854 wide]."""
FEWEST, LEAST_SHARE = 12, 0.5
"""Fewer points, or a smaller share of them, that agree on a motion tell none."""
STILL = 0.3
"""A camera is still where no corner of the picture moves farther [px]."""


class View(NamedTuple):
    """From where a frame's light is seen."""

    reference: int
    """Number of the reference picture; light of different ones can't be compared."""
    matrix: np.ndarray
    """Homography from the frame's grid to the reference's (column, row, 1) [grid pixels], shape [3, 3]."""

    def moved(self, pixel: np.ndarray) -> np.ndarray:
        """Row and column in the reference of a place (row, column) of the frame, shape [2] [grid pixels]."""
        place = np.array([[pixel[::-1]]], np.float64)
        return cv2.perspectiveTransform(place, self.matrix)[0, 0, ::-1]

    def back(self, pixel: np.ndarray) -> np.ndarray:
        """The other way round."""
        return View(self.reference, np.linalg.inv(self.matrix)).moved(pixel)


class Registration:
    """One clip's frames in order, each brought into the view of a reference.

    Args:
        grid_shape: rows and columns of the grid.
    """

    def __init__(self, grid_shape: tuple[int, int]) -> None:
        self._grid_shape, self._count = grid_shape, 0
        self._reference: tuple[np.ndarray, np.ndarray] | None = None
        """Picture, as in `Shown.flat`, whatever the exposure does, and points [N, 2] of the reference."""
        self._last = np.eye(3)
        """Homography from the reference's picture to the last one."""

    def push(self, shown: Shown) -> tuple[View, Callable[[], tuple[np.ndarray, np.ndarray]]]:
        """Take the next frame; return its view, and what returns picture and labels in the view of the reference.

        These are black and 0 where the frame doesn't show that.
        """
        motion = None if self._reference is None else self._motion(shown)
        if motion is None:
            share = shown.gray.shape[1] / 854
            places = lattice(shown.gray.shape, max(round(SPACING * share), 6)).reshape(-1, 2)
            usable = (values_at(shown.away, places) > GUARD * share) & values_at(shown.lit, places)
            self._reference, self._count = (shown.flat, places[usable].astype(np.float32)), self._count + 1
            motion = np.eye(3)
        self._last = motion
        if np.array_equal(motion, np.eye(3)):
            return View(self._count, np.eye(3)), lambda: (shown.picture, shown.labels)
        size = shown.gray.shape[::-1]

        @cache
        def warped() -> tuple[np.ndarray, np.ndarray]:
            flags = cv2.WARP_INVERSE_MAP
            picture = cv2.warpPerspective(shown.picture, motion, size, flags=flags | cv2.INTER_CUBIC)
            return picture, cv2.warpPerspective(shown.labels, motion, size, flags=flags | cv2.INTER_NEAREST)

        grid = scaled(motion, np.array(self._grid_shape[::-1]) / size)
        return View(self._count, np.linalg.inv(grid)), warped

    def _motion(self, shown: Shown) -> np.ndarray | None:
        """Homography from the reference to a picture [px]; None where another reference is needed."""
        assert self._reference is not None
        flat, places = self._reference
        expected = cv2.perspectiveTransform(places[:, None], self._last)[:, 0] if len(places) else places
        step, known = followed(flat, shown.flat, places, near=expected)
        known &= values_at(shown.away, np.rint(places + step)) > GUARD / 2 * flat.shape[1] / 854
        if known.sum() < FEWEST:
            return None
        found, agree = cv2.findHomography(places[known], (places + step)[known], cv2.RANSAC, 1.0)
        if found is None or agree.sum() < max(FEWEST, LEAST_SHARE * known.sum()):
            return None
        height, width = flat.shape
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
        way = np.linalg.norm(cv2.perspectiveTransform(corners[:, None], found)[:, 0] - corners, axis=1)
        if way.max() < STILL:
            return np.eye(3)
        # A picture that has moved farther is the reference of the next ones.
        return found if way.mean() < 0.25 * width else None


def scaled(matrix: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """A homography of places (column, row) between pictures that are larger by a factor along each axis."""
    grown = np.array([[factor[0], 0, (factor[0] - 1) / 2], [0, factor[1], (factor[1] - 1) / 2], [0, 0, 1]])
    return grown @ matrix @ np.linalg.inv(grown)
