"""Tool masks from outlines that a person has drawn in one or several frames; instruments are tracked from there.

The file is YAML or JSON: polygons of instruments by the number of the frame in which they were drawn, in pixels of the
picture (to the right, down). Until the next such frame every instrument moves as a rigid body seen from a little nearer
or farther, by a similarity fitted to its tracks (pyramidal Lucas and Kanade). A shaft that enters from the picture's
edge is straight and goes on beyond it, so that more of it shows as it comes in.
"""

import itertools
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from palpate.common.files import file_sha256
from palpate.data.labels import TISSUE, TOOL, MaskError
from palpate.data.masks.lit import lit_picture, picture_field
from palpate.data.masks.rigid import RigidInstrument, filled
from palpate.data.source.camera import MOST_SIDE
from palpate.data.source.frames import Frame
from palpate.data.source.layout import InputError, read_mapping


class OutlinedMasks:
    """Mask source (see masks.MaskSource) from outlines; frames must come in order.

    Args:
        path: the file.

    Raises:
        InputError: it can't be used.
    """

    def __init__(self, path: Path) -> None:
        self._outlines = read_outlines(path)
        self.identity = f"outlines:2:{file_sha256(path)}"  # version of the method, which rises when the result changes
        self._name = path.name
        self.reset()

    def reset(self) -> None:
        """Forget the frames of the clip so far."""
        self._instruments: list[RigidInstrument] = []
        self._share = 1.0
        """Size in which instruments are tracked over the picture's."""
        self._drawn = -1
        """Number of the frame whose outlines are tracked."""

    @property
    def outlines(self) -> list[np.ndarray]:
        """Corners [K, 2] (column, row) [px] of the instruments in the last frame; none of one that has left it."""
        return [instrument.outline / self._share for instrument in self._instruments]

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a frame.

        Raises:
            MaskError: no outline comes before the frame, or an instrument couldn't be followed into it.
        """
        picture = frame.picture
        # Longer side in which instruments are tracked, so that lengths mean the same in all clips [px].
        share = self._share = 640 / max(picture.shape[:2])
        size = max(round(picture.shape[1] * share), 16), max(round(picture.shape[0] * share), 16)
        gray = cv2.cvtColor(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
        lit = lit_picture(picture)
        drawn = max((number for number in self._outlines if number <= frame.number), default=-1)
        if drawn < 0:
            first = min(self._outlines)
            raise MaskError(f"{self._name} outlines no instrument before frame {first}; give `{frame.number}: []`.")
        if drawn != self._drawn:
            # How far every pixel lies from the end of the endoscope's picture, or of the image.
            field = np.pad(picture_field(lit).astype(np.uint8), 1)
            edge = cv2.distanceTransform(field, cv2.DIST_L2, 5)[1:-1, 1:-1] / max(picture.shape[:2])
            outlines = [_beyond_edge(outline, edge) for outline in self._outlines[drawn]]
            self._instruments = [RigidInstrument(share * outline, gray) for outline in outlines]
            self._drawn = drawn
        else:
            found = [instrument.follow(gray) for instrument in self._instruments]
            if not all(found):
                raise MaskError(
                    f"An instrument outlined in frame {drawn} can't be followed here; outline it again in {self._name}."
                )
        labels = lit.astype(np.uint8) * np.uint8(TISSUE)
        for outline in self.outlines:
            filled(labels, outline, TOOL)
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
            number = int(str(key))  # none of 0.5 and true
            corners = [np.array(polygon, np.float64) for polygon in polygons]
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{path} holds {str(key)[:20]!r} with what are no polygons; {wanted}.") from None
        for polygon in corners:
            if polygon.ndim != 2 or polygon.shape[1:] != (2,) or len(polygon) < 3 or number < 0:
                few = "of fewer than three corners, or before frame 0"
                raise InputError(f"{path} has an outline in frame {number} {few}; {wanted}.")
            if not (np.abs(polygon) <= MOST_SIDE).all():
                raise InputError(f"{path} has a corner in frame {number} that lies in no picture; {wanted}.")
        if len(corners) > 50:
            raise InputError(f"{path} has {len(corners)} outlines in frame {number}; give 50 at most.")
        outlines[number] = corners
    if not outlines:
        raise InputError(f"{path} holds no frame; {wanted}.")
    return outlines


def _beyond_edge(outline: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """An outline [K, 2] whose corners at the picture's edge are moved out along its sides, where there are any.

    Args:
        edge: distance from the picture's edge, in shares of its longer side, shape [H, W].
    """
    columns, rows = np.clip(np.rint(outline).astype(int), 0, np.array(edge.shape[::-1]) - 1).T
    # Corners of an outline that are so near to the picture's edge lie on it, as a share of its longer side.
    at_edge = edge[rows, columns] < 0.012
    # Sides of an outline that was cut are jagged; one is taken over so much of the picture's longer side at least.
    least, sides = 0.05 * max(edge.shape), []
    for here, step in itertools.product(np.flatnonzero(at_edge), (1, -1)):
        around = (here + step * np.arange(1, len(outline))) % len(outline)
        inner = around[: np.argmax(np.append(at_edge[around], True))]
        if len(inner):
            far = np.linalg.norm(outline[inner] - outline[here], axis=1) >= least
            sides.append(outline[here] - outline[inner[np.argmax(far) if far.any() else -1]])
    if not sides:
        return outline
    way = np.sum([side / max(np.linalg.norm(side), 1e-9) for side in sides], axis=0)
    # How far beyond the edge a shaft goes on, in longer sides of the picture.
    way *= 2.0 * max(edge.shape) / max(np.linalg.norm(way), 1e-9)
    return np.where(at_edge[:, None], outline + way, outline)
