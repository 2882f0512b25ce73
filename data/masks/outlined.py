"""Tool masks from outlines that a person has drawn in one frame, or in some; instruments are followed from there.

The file is YAML or JSON: polygons of instruments by the number of the frame in which they were drawn, in pixels of the
picture (to the right, down). Until the next such frame every instrument moves as a rigid body seen from a little nearer
or farther: points of it are followed by pyramidal Lucas and Kanade, and a similarity is fitted to them. A shaft that
enters from the picture's edge is straight and goes on beyond it, so that more of it shows as it comes in.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from palpate.common.files import file_sha256
from palpate.data.labels import TISSUE, TOOL, MaskError
from palpate.data.masks.automatic import lit_picture, picture_field
from palpate.data.source.camera import MOST_SIDE
from palpate.data.source.frames import Frame
from palpate.data.source.layout import InputError, read_mapping
from palpate.data.tracks.linking import followed

VERSION = 1
"""Version of the method, part of the masks' identity; it must rise when the result changes."""
WORKING_SIZE = 640
"""Longer side of the pictures in which instruments are followed [px]."""
MOST_POINTS, SPACING, TEXTURE = 200, 4, 0.005
"""Followed points of an instrument, their least distance [px] and their least contrast, as a share of the best."""
FEWEST, LEAST_SHARE = 6, 0.4
"""Fewer points, or a smaller share of those that were found again, that agree on a motion tell none."""
AGREE = 1.5
"""Points agree with a motion that takes them so near to where they are [px]."""
ENTERS = 0.012
"""Corners of an outline that are so near to the picture's edge lie on it, as a share of its longer side."""
LEAVING = 0.25
"""An instrument that isn't found has left the picture if less than this share of what showed of it at most did last."""
BEYOND = 2.0
"""How far beyond the edge a shaft goes on, in longer sides of the picture."""


class OutlinedMasks:
    """Mask source (see masks.MaskSource) from outlines; frames must come in order.

    Args:
        path: the file.

    Raises:
        InputError: it can't be used.
    """

    def __init__(self, path: Path) -> None:
        self._outlines = read_outlines(path)
        self.identity = f"outlines:{VERSION}:{file_sha256(path)}"
        self._name = path.name
        self.reset()

    def reset(self) -> None:
        """Forget the frames of the clip so far."""
        self._instruments: list[_Instrument] = []
        self._drawn = -1
        """Number of the frame whose outlines are followed."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a frame.

        Raises:
            MaskError: no outline comes before the frame, or an instrument couldn't be followed into it.
        """
        picture = frame.picture
        share = WORKING_SIZE / max(picture.shape[:2])
        size = max(round(picture.shape[1] * share), 16), max(round(picture.shape[0] * share), 16)
        gray = cv2.cvtColor(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
        lit = lit_picture(picture)
        drawn = max((number for number in self._outlines if number <= frame.number), default=-1)
        if drawn < 0:
            first = min(self._outlines)
            raise MaskError(f"{self._name} outlines no instrument before frame {first}; give `{frame.number}: []`.")
        if drawn != self._drawn:
            edge = _edge_distance(lit) / max(picture.shape[:2])
            outlines = [_beyond_edge(outline, edge) for outline in self._outlines[drawn]]
            self._instruments = [_Instrument(share * outline, gray) for outline in outlines]
            self._drawn = drawn
        else:
            found = [instrument.follow(gray) for instrument in self._instruments]
            if not all(found):
                raise MaskError(
                    f"An instrument outlined in frame {drawn} can't be followed here; outline it again in {self._name}."
                )
        labels = lit.astype(np.uint8) * np.uint8(TISSUE)
        for instrument in self._instruments:
            filled(labels, instrument.outline / share, TOOL)
        return labels


class _Instrument:
    """One instrument in working pictures, from the one in which it is outlined.

    Args:
        outline: corners (column, row), shape [K, 2] [px], also beyond the picture's edge.
        gray: the picture, uint8 [h, w].
    """

    def __init__(self, outline: np.ndarray, gray: np.ndarray) -> None:
        self.outline, self._last = outline, gray
        """Where it is now, none once it has left the picture; and the picture in which it was seen there."""
        self._begin()
        self._largest = self._visible().sum()
        """How much of it has shown at most [px²]."""

    def _begin(self) -> None:
        """Follow it from the last picture on."""
        self._reference, self._drawn, self._motion = self._last, self.outline, np.eye(2, 3)
        near = cv2.dilate(self._visible(), np.ones((5, 5), np.uint8))  # its edges are often all that shows
        found = cv2.goodFeaturesToTrack(self._last, MOST_POINTS, TEXTURE, SPACING, mask=near)
        self._points = np.empty((0, 2), np.float32) if found is None else found[:, 0]

    def _visible(self) -> np.ndarray:
        return filled(np.zeros(self._last.shape, np.uint8), self.outline, 1)

    def follow(self, gray: np.ndarray) -> bool:
        """Whether it is found in the next picture, or has left it."""
        if not len(self.outline):
            return True
        motion = self._moved(gray)
        if motion is None and self._reference is not self._last:
            # It has turned, or come nearer, too far for the first picture's pattern.
            self._begin()
            motion = self._moved(gray)
        if motion is not None:
            self._motion, self._last = motion, gray
            self.outline = cv2.transform(self._drawn[:, None], motion)[:, 0]
            self._largest = max(self._largest, self._visible().sum())
        elif self._visible().sum() < LEAVING * self._largest:
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
        found, agree = cv2.estimateAffinePartial2D(
            self._points[known], there[known], method=cv2.RANSAC, ransacReprojThreshold=AGREE
        )
        if found is None or agree.sum() < max(FEWEST, LEAST_SHARE * known.sum()):
            return None
        return found


def filled(labels: np.ndarray, outline: np.ndarray, label: int) -> np.ndarray:
    """A label map [H, W], in which a polygon [K, 2] (column, row) [px] has got a label."""
    if len(outline):
        cv2.fillPoly(labels, [np.rint(outline).astype(np.int32)], label)
    return labels


def read_outlines(path: Path) -> Mapping[int, list[np.ndarray]]:
    """Corners of instruments [K, 2] (column, row) [px] by the number of the frame in which they were drawn.

    Raises:
        InputError: the file can't be read, or holds anything else.
    """
    wanted = "give polygons by frame, such as `0: [[[12, 300], [150, 280], [155, 320]]]`, or `0: []`"
    outlines: dict[int, list[np.ndarray]] = {}
    for key, polygons in read_mapping(path, "outlines of instruments").items():
        try:
            number = int(key)
            corners = [np.array(polygon, np.float64) for polygon in polygons]
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{path} holds {str(key)[:20]!r} with what are no polygons; {wanted}.") from None
        for polygon in corners:
            if polygon.ndim != 2 or polygon.shape[1:] != (2,) or len(polygon) < 3 or number < 0:
                raise InputError(f"{path} has an outline in frame {number} of fewer than three corners; {wanted}.")
            if not (np.abs(polygon) <= MOST_SIDE).all():
                raise InputError(f"{path} has a corner in frame {number} that lies in no picture; {wanted}.")
        outlines[number] = corners
    if not outlines:
        raise InputError(f"{path} holds no frame; {wanted}.")
    return outlines


def _edge_distance(lit: np.ndarray) -> np.ndarray:
    """How far every pixel [H, W] lies from the end of the endoscope's picture, or of the image [px]."""
    field = np.pad(picture_field(lit).astype(np.uint8), 1)
    return cv2.distanceTransform(field, cv2.DIST_L2, 5)[1:-1, 1:-1]


def _beyond_edge(outline: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """An outline [K, 2] whose corners at the picture's edge are moved out along its sides, where there are any.

    Args:
        edge: distance from the picture's edge, in shares of its longer side, shape [H, W].
    """
    columns, rows = np.clip(np.rint(outline).astype(int), 0, np.array(edge.shape[::-1]) - 1).T
    at_edge = edge[rows, columns] < ENTERS
    sides = [
        outline[here] - outline[there]
        for here in np.flatnonzero(at_edge)
        for there in ((here - 1) % len(outline), (here + 1) % len(outline))
        if not at_edge[there]
    ]
    if not sides:
        return outline
    way = np.sum([side / max(np.linalg.norm(side), 1e-9) for side in sides], axis=0)
    way *= BEYOND * max(edge.shape) / max(np.linalg.norm(way), 1e-9)
    return np.where(at_edge[:, None], outline + way, outline)
