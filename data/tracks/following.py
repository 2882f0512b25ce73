"""Follows a grid of tissue points through a clip by dense optical flow, checked forwards and backwards.

Dense inverse search flow (Kroeger 2016, OpenCV's DIS), its finest scale half the picture's; the check is Kalal 2010's.
A point that is lost stays lost: what comes back from under a tool need not be the same tissue.
"""

from __future__ import annotations

import cv2
import numpy as np

SPACING = 8
"""Of the grid of points [px]."""
MARGIN = 5.0
"""No point begins nearer to the tool [px]."""
TOUCHED = 3.0
"""A point that comes nearer to the tool is lost: it may be the tool's [px]."""
BORDER = 3
"""And one that comes nearer to the picture's edge [px]."""
CHECK = 1.5
"""Largest distance to where flow and backward flow return a point [px]."""
WIDEST = 854
"""Wider or higher pictures are shrunk to this before their points are followed, which would take too long [px]."""
DARK = 20
"""Of 255: where no channel is brighter there is no picture, outside an endoscope's round field."""
RIM = 15
"""Width of the square by which the picture's field is shrunk [px]."""


def lit_field(picture: np.ndarray) -> np.ndarray:
    """Where an RGB picture [H, W, 3] shows anything, away from its edge, bool [H, W]."""
    return cv2.erode((picture.max(axis=2) > DARK).astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0


def tool_distance(tool: np.ndarray) -> np.ndarray:
    """Distance of every pixel from the tool's mask [H, W] [px], float32; huge where there is no tool."""
    return cv2.distanceTransform((~tool).astype(np.uint8), cv2.DIST_L2, 5)


class PointFollower:
    """Points on tissue from the first picture on; all in pixels of a picture at most WIDEST wide and high.

    Args:
        picture: the first one, uint8 [H, W, 3] RGB.
        tool: its mask of the tool, bool [H, W].
        spacing: of the points [px].
    """

    def __init__(self, picture: np.ndarray, tool: np.ndarray, spacing: int = SPACING) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        picture, tool = shrunk(picture, tool)
        self._gray = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        self._lit = lit_field(picture)
        height, width = self._gray.shape
        rows, columns = np.mgrid[spacing : height - spacing : spacing, spacing : width - spacing : spacing]
        away = tool_distance(tool)
        places = np.column_stack([columns.ravel(), rows.ravel()])
        at = places[:, 1], places[:, 0]
        places = places[(away[at] > MARGIN) & self._lit[at]]
        self.spacing = spacing
        self.points = places.astype(np.float32)
        """Where they are in the first picture, shape [N, 2] (column, row) [px]."""
        self.distance = away[places[:, 1], places[:, 0]]
        """From the tool there, shape [N] [px]."""
        self.place = self.points.copy()
        """Where they are now, or were last seen, shape [N, 2] [px]."""
        self.followed = np.ones(len(places), bool)
        """Which are still followed, shape [N]."""

    @property
    def moved(self) -> np.ndarray:
        """Displacement since the first picture, shape [N, 2] [px]; not a number where a point is lost."""
        return np.where(self.followed[:, None], self.place - self.points, np.nan).astype(np.float64)

    def step(self, picture: np.ndarray, tool: np.ndarray) -> None:
        """Follow the points into the next picture, with its tool's mask."""
        picture, tool = shrunk(picture, tool)
        before, self._gray = self._gray, cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        there = self._flow.calc(before, self._gray, None)  # ty: ignore[no-matching-overload]  no first guess
        back = self._flow.calc(self._gray, before, None)  # ty: ignore[no-matching-overload]  no first guess
        step = _sampled(there, self.place)
        place = self.place + step
        height, width = self._gray.shape
        inside = (place > BORDER).all(axis=1) & (place < [width - 1 - BORDER, height - 1 - BORDER]).all(axis=1)
        returned = np.linalg.norm(step + _sampled(back, place), axis=1)
        column, row = np.clip(place, 0, [width - 1, height - 1]).astype(int).T
        tissue = (tool_distance(tool)[row, column] > TOUCHED) & self._lit[row, column]
        self.followed &= inside & (returned < CHECK) & tissue
        self.place = np.where(self.followed[:, None], place, self.place).astype(np.float32)


def shrunk(picture: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A picture and its mask, at most WIDEST wide and high."""
    height, width = tool.shape
    share = WIDEST / max(height, width)
    if share >= 1:
        return picture, tool
    size = max(round(width * share), 1), max(round(height * share), 1)
    small = cv2.resize(tool.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA), small


def _sampled(field: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Bilinear values of a field [H, W, 2] at places [N, 2] (column, row)."""
    if not len(places):
        return np.zeros((0, 2), np.float32)
    columns, rows = (np.ascontiguousarray(places[:, [axis]], np.float32) for axis in (0, 1))
    return cv2.remap(field, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(-1, 2)
