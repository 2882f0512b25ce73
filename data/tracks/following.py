"""Tracks of a grid of tissue points through a clip, in its pictures' plane.

Every picture is linked to the one before (`data.tracks.linking`), and every few pictures to the first one, so that
errors don't add up while its tissue is in view. A point that an instrument hid is found again if the motion of its
neighbours, the way back, and the first picture's pattern agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from palpate.data.labels import TOOL
from palpate.data.tracks.linking import Linker, flat, patterns, resemblance

SPACING = 8
"""Spacing of the grid of points [px]."""
TOUCHED = 3
"""Least distance of a point from the tool; nearer ones may be the tool's and are lost [px]."""
EDGED = 12
"""Distance from the tool within which a point's window holds the tool's edge, which drags it along [px]."""
CHECK = 2.5
"""Largest distance between a point and its return by flow and backward flow [px]."""
RELINKED = 3
"""Interval at which pictures are linked to the first one [frames]."""
COARSE = 4
"""Pixels of a picture's side in one of its colours'."""
RIM = 15
"""Width of the square by which the picture's field is shrunk [px]."""


def lit_field(picture: np.ndarray) -> np.ndarray:
    """Lit part of an RGB picture [H, W, 3], away from its edge, bool [H, W]."""
    red, green, blue = cv2.split(picture)
    brightest = cv2.max(cv2.max(red, green), blue)
    # Where no channel is brighter there is no picture, outside an endoscope's round field.
    return cv2.erode((brightest > 20).astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0


def tool_distance(tool: np.ndarray) -> np.ndarray:
    """Distance of every pixel from the tool's mask [H, W] [px], float32; 8192 if there is no tool."""
    if not tool.any():
        return np.full(tool.shape, 8192.0, np.float32)
    return cv2.distanceTransform((~tool).astype(np.uint8), cv2.DIST_L2, 5)


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture in which points are tracked, at most 854 px wide and high to save time; all trackers share it."""

    picture: np.ndarray
    """RGB, uint8 [H, W, 3]."""
    labels: np.ndarray
    """Label map, uint8 [H, W]."""
    size: tuple[int, int]
    """Width and height of the picture before it was shrunk [px]."""

    @classmethod
    def of_view(cls, view: tuple[np.ndarray, np.ndarray]) -> Shown:
        """A picture of any size, uint8 [H, W, 3] RGB, with its label map [H, W]."""
        picture, labels = view
        height, width = labels.shape
        share = 854 / max(height, width)
        if share < 1:
            small = max(round(width * share), 1), max(round(height * share), 1)
            picture = cv2.resize(picture, small, interpolation=cv2.INTER_AREA)
            labels = cv2.resize(labels, small, interpolation=cv2.INTER_NEAREST)
        return cls(picture, labels, (width, height))

    @cached_property
    def gray(self) -> np.ndarray:
        """The grey picture, uint8 [H, W]."""
        return cv2.cvtColor(self.picture, cv2.COLOR_RGB2GRAY)

    @cached_property
    def colour(self) -> np.ndarray:
        """Logarithm of red over green, float32 [H / COARSE, W / COARSE], which light hardly changes."""
        height, width = self.gray.shape
        small = cv2.resize(self.picture, (width // COARSE, height // COARSE), interpolation=cv2.INTER_AREA)
        red, green, _ = cv2.split(small.astype(np.float32) + 8)
        return np.log(red / green)

    @cached_property
    def lit(self) -> np.ndarray:
        """Mask of the lit part, as in `lit_field`, bool [H, W]."""
        return lit_field(self.picture)

    @cached_property
    def tool(self) -> np.ndarray:
        """Mask of the tool, bool [H, W]."""
        return self.labels == TOOL

    @cached_property
    def away(self) -> np.ndarray:
        """Distance of every pixel from the tool, as in `tool_distance`."""
        return tool_distance(self.tool)

    @cached_property
    def flat(self) -> np.ndarray:
        """The grey picture without its local mean, uint8 [H, W]."""
        return flat(self.gray)

    @cached_property
    def tissue(self) -> np.ndarray:
        """Mask of places for points, bool [H, W]: lit, away from the tool and from the picture's edge."""
        offsets = np.arange(-TOUCHED, TOUCHED + 1)
        disc = (np.hypot(*np.meshgrid(offsets, offsets)) <= TOUCHED).astype(np.uint8)
        found = self.lit & (cv2.dilate(self.tool.astype(np.uint8), disc) == 0)
        inner = np.zeros_like(found)
        inner[4:-4, 4:-4] = found[4:-4, 4:-4]
        return inner

    @cached_property
    def edge(self) -> np.ndarray:
        """Mask of places whose window holds the tool's edge, bool [H, W]."""
        # A square costs a tenth of a disc.
        return cv2.dilate(self.tool.astype(np.uint8), np.ones((2 * EDGED + 1, 2 * EDGED + 1), np.uint8)) > 0


def lattice(shape: tuple[int, ...], spacing: int) -> np.ndarray:
    """Places of a grid in a picture of a shape (H, W), a spacing from its edges, [rows, columns, 2] (column, row)."""
    height, width = shape
    grid = np.mgrid[spacing : height - spacing : spacing, spacing : width - spacing : spacing]
    return np.moveaxis(grid[::-1], 0, -1)


def spread(usable: np.ndarray, spacing: int) -> np.ndarray:
    """Places of a `lattice` that are usable, by a mask [H, W], shape [N, 2] (column, row)."""
    places = lattice(usable.shape, spacing).reshape(-1, 2)
    return places[values_at(usable, places)]


class PointFollower:
    """Points on tissue from the first picture on, in pixels of `Shown` pictures.

    Args:
        shown: the first picture.
        spacing: distance of the points [px].
    """

    def __init__(self, shown: Shown, spacing: int = SPACING) -> None:
        self.shown = shown
        """The last picture."""
        gray, away = shown.gray, shown.away
        places = lattice(gray.shape, spacing)
        columns, rows = np.moveaxis(places, -1, 0)
        # No point begins nearer to the tool.
        self._grid = (away[rows, columns] > 5.0) & shown.lit[rows, columns]
        self.spacing = spacing
        self.points = places[self._grid].astype(np.float32)
        """Places of the points in the first picture, shape [N, 2] (column, row) [px]."""
        self.distance = values_at(away, self.points)
        """Distance of the points from the tool in the first picture, shape [N] [px]."""
        self.place = self.points.copy()
        """Current, or last known, places of the points, shape [N, 2] [px]."""
        self.followed = np.ones(len(self.points), bool)
        """Mask of points that are tracked now, shape [N]."""
        self._linker, self._count = Linker(self._grid, spacing), 0
        self._first = self._before = self._linker.prepared(gray)
        self._patterns = patterns(gray, self.points)

    @property
    def moved(self) -> np.ndarray:
        """Displacement since the first picture, shape [N, 2] [px]; NaN where a point is lost."""
        return np.where(self.followed[:, None], self.place - self.points, np.nan).astype(np.float64)

    def step(self, shown: Shown) -> None:
        """Follow the points into the next picture."""
        apart = ~values_at(self.shown.edge, self.place)
        self.shown = shown
        gray, tissue = shown.gray, shown.tissue
        before, self._before = self._before, self._linker.prepared(gray)
        place, returned = self._linker.link(before, self._before, self.place, self.followed, apart)
        self.followed &= (returned < CHECK) & values_at(tissue, place)
        self._take(place, self.followed)
        self._count += 1
        if self._count % RELINKED == 0 and self.followed.any():
            self._relink(gray, tissue)

    def _relink(self, gray: np.ndarray, tissue: np.ndarray) -> None:
        """Link the first picture to this one: against drift, and to find lost points again."""
        motion = self._filled()
        motion[self._grid] = expected = np.where(self.followed[:, None], self.place - self.points, motion[self._grid])
        dragged = values_at(self.shown.edge, self.points + expected) | (self.distance < EDGED)
        place, returned = self._linker.refine(self._first, self._before, self.points, motion, ~dragged)
        off = np.linalg.norm(place - self.points - expected, axis=1)
        # A link to the first picture counts where it ends near to where the point is expected, and patterns are alike.
        good = (returned < CHECK) & (off < 4.0) & values_at(tissue, place)
        good &= resemblance(self._patterns, patterns(gray, place)) > 0.8
        self.followed = self.followed | good
        self._take(place, good)

    def _take(self, place: np.ndarray, found: np.ndarray) -> None:
        self.place = np.where(found[:, None], place, self.place).astype(np.float32)

    def _filled(self) -> np.ndarray:
        """Motion of the whole grid, of lost points by their neighbours', float32 [rows, columns, 2] [px]."""
        weight = np.zeros(self._grid.shape, np.float32)
        weight[self._grid] = self.followed
        motion = np.zeros((*self._grid.shape, 3), np.float32)
        motion[self._grid, :2] = np.where(self.followed[:, None], self.place - self.points, 0)
        motion[..., 2] = weight
        total = np.zeros_like(motion)
        size = motion.shape[1::-1]
        # By kernels of these standard deviations [points] and weights, on grids that much coarser.
        for reach, share, coarser in ((2, 1.0, 1), (8, 1e-2, 4), (32, 1e-4, 16)):
            small = max(size[0] // coarser, 1), max(size[1] // coarser, 1)
            blurred = cv2.GaussianBlur(cv2.resize(motion, small, interpolation=cv2.INTER_AREA), (0, 0), reach / coarser)
            total += share * cv2.resize(blurred, size, interpolation=cv2.INTER_LINEAR)
        return total[..., :2] / np.maximum(total[..., 2:], np.finfo(np.float32).tiny)


def values_at(picture: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values of a picture or mask [H, W] at places [N, 2] (column, row) [px], outside those of its edge, shape [N]."""
    height, width = picture.shape
    column, row = np.clip(place, 0, [width - 1, height - 1]).astype(int).T
    return picture[row, column]
