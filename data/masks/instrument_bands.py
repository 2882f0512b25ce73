"""Finds bands of parallel straight edges that enter the picture from its border: such as an instrument's shaft.

Straight edges come from the line segment detector of Grompone von Gioi 2010 (OpenCV's LSD). Lengths are in pixels of a
working picture whose longer side is `WORKING_SIZE`.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.physics.jit import inlined, kernel

WORKING_SIZE = 640
"""Longer side that pictures are brought to before edges are sought, so that lengths mean the same everywhere [px]."""
SHORTEST_SEGMENT = 10.0
"""Shortest segment that is not noise [px]."""
SHORTEST_BASE = 30.0
"""Least length of a band's longest edge [px]."""
WIDEST_BAND = 110.0
"""Width of the widest band: an instrument close to the camera [px]."""
THINNEST_BAND = 6.0
"""Width of the thinnest band; two closer edges are one line, such as a vessel [px]."""
PARALLEL_COSINE = np.cos(np.radians(5.0))
"""Least cosine of the angle between edges of one band."""
COLLINEAR_COSINE = np.cos(np.radians(3.0))
"""Least cosine of the angle between segments of one line."""
BORDER_MARGIN = 4.0
"""Edges this close to the end of the endoscope's picture are its own outline [px]."""
CAPTION_MARGIN = 0.1
"""Bands exactly along an image side and within this share of the height from it are captions of the display."""


@dataclass(frozen=True)
class Band:
    """A straight strip between parallel edges; positions in pixels (u, v) of the working picture."""

    start: np.ndarray
    """End of the centre line that is nearer to the border, shape [2]."""
    axis: np.ndarray
    """Unit vector from the border inwards, shape [2]."""
    length: float
    """Length of the strip along which edges were found [px]."""
    width: float
    """Distance between the outermost edges [px]."""
    gap: float
    """Distance from `start` back to the border of the picture [px]."""
    edges: int
    """Number of straight edges in the strip."""
    support: float
    """Summed length of those edges [px]."""

    @property
    def normal(self) -> np.ndarray:
        """Unit vector across the strip, [2]."""
        return np.array([-self.axis[1], self.axis[0]])

    def points(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Positions [len(across), len(along), 2] at distances from `start` [px] and from the centre line [px]."""
        return self.start + along[None, :, None] * self.axis + across[:, None, None] * self.normal

    def outline(self, low: float, high: float, widen: float = 0.0) -> np.ndarray:
        """Corners [4, 2] int32 of the strip between two distances along the axis, widened on both sides [px]."""
        half = self.width / 2 + widen
        corners = self.points(np.array([low, high]), np.array([-half, half]))
        return np.rint(corners[[0, 0, 1, 1], [0, 1, 1, 0]]).astype(np.int32)


def find_bands(gray: np.ndarray, field: np.ndarray) -> list[Band]:
    """Candidate bands, the densest in edges first.

    Args:
        gray: working picture, uint8 [h, w].
        field: the endoscope's picture without its dark surround, bool [h, w], convex.
    """
    segments = straight_edges(gray, field)
    vectors = segments[:, 2:] - segments[:, :2]
    lengths = np.linalg.norm(vectors, axis=1)
    directions, bands = vectors / lengths[:, None], []
    for base in np.argsort(-lengths):
        if lengths[base] < SHORTEST_BASE:
            break
        bands += _grown(base, segments, directions, lengths, field)
    return sorted(bands, key=lambda band: -band.support / np.sqrt(band.width))


def straight_edges(gray: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Straight segments (u0, v0, u1, v1) [S, 4] inside the picture, collinear pieces joined, longest first."""
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD, 1.0, 0.6).detect(cv2.GaussianBlur(gray, (0, 0), 1.0))[0]
    if found is None:
        return np.empty((0, 4))
    segments = found.reshape(-1, 4).astype(np.float64)
    lengths = np.linalg.norm(segments[:, 2:] - segments[:, :2], axis=1)
    # The image's own sides end the picture as well, hence the padding.
    depth = cv2.distanceTransform(np.pad(field.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    middle = np.rint((segments[:, :2] + segments[:, 2:]) / 2).astype(int)
    inside = depth[middle[:, 1].clip(0, gray.shape[0] - 1), middle[:, 0].clip(0, gray.shape[1] - 1)] > BORDER_MARGIN
    keep = inside & (lengths >= SHORTEST_SEGMENT)
    result = _joined(segments[keep][np.argsort(-lengths[keep])])
    return result[np.argsort(-np.linalg.norm(result[:, 2:] - result[:, :2], axis=1))]


@kernel
def _joined(segments):
    """Segments on one line, of one polarity and with gaps below 0.4 of the longer one joined, shape [J, 4].

    Segments [S, 4] come longest first.
    """
    count, found = len(segments), 0
    free, joined = np.ones(count, np.bool_), np.empty_like(segments)
    for index in range(count):
        if not free[index]:
            continue
        line, other = segments[index].copy(), index
        while other >= 0:
            free[other] = False
            length = math.hypot(line[2] - line[0], line[3] - line[1])
            right, down = (line[2] - line[0]) / length, (line[3] - line[1]) / length
            # Its ends are the outermost of the four, along the line as it was.
            low, high = 0.0, length
            start = line[:2].copy()
            for place in (segments[other, :2], segments[other, 2:]):
                along = (place[0] - start[0]) * right + (place[1] - start[1]) * down
                if along < low:
                    low = along
                    line[:2] = place
                if along > high:
                    high = along
                    line[2:] = place
            other = _touching(line, segments, free)
        joined[found] = line
        found += 1
    return joined[:found]


@inlined
def _touching(line, segments, free):
    """The first of the free segments that continues a line (u0, v0, u1, v1), or -1."""
    length = math.hypot(line[2] - line[0], line[3] - line[1])
    right, down = (line[2] - line[0]) / length, (line[3] - line[1]) / length
    for index in range(len(segments)):
        if free[index]:
            across, along = segments[index, 0] - line[0], segments[index, 1] - line[1]
            first, first_off = across * right + along * down, along * right - across * down
            across, along = segments[index, 2] - line[0], segments[index, 3] - line[1]
            last, last_off = across * right + along * down, along * right - across * down
            size = math.hypot(segments[index, 2] - segments[index, 0], segments[index, 3] - segments[index, 1])
            on_line = max(abs(first_off), abs(last_off)) < 2 and last - first > COLLINEAR_COSINE * size
            if on_line and min(first, last) < 1.4 * length and max(first, last) > -0.4 * length:
                return index
    return -1


def _grown(
    base: int, segments: np.ndarray, directions: np.ndarray, lengths: np.ndarray, field: np.ndarray
) -> list[Band]:
    """Narrow and wide bands on either side of a base segment, from all segments parallel to it."""
    parallel = np.abs(directions @ directions[base]) > PARALLEL_COSINE
    start = int(parallel[:base].sum())
    chosen = segments[parallel], lengths[parallel], directions[base], field
    sizes = [(side, widest) for side in (1, -1) for widest in (WIDEST_BAND / 3, WIDEST_BAND)]
    found = [_grow(start, side, widest, *chosen) for side, widest in sizes]
    return [band for band in found if band is not None]


def _grow(
    base: int, side: int, widest: float, segments: np.ndarray, lengths: np.ndarray, axis: np.ndarray, field: np.ndarray
) -> Band | None:
    """Band on one side of a base segment along an axis from segments that are parallel to it; None where none is."""
    origin, normal = segments[base, :2], np.array([-axis[1], axis[0]]) * side
    first, last = segments[:, :2] - origin, segments[:, 2:] - origin
    across = (first + last) @ normal / 2
    along = np.sort(np.stack([first @ axis, last @ axis]), axis=0)
    eligible = (across > -2) & (across < widest)
    if eligible.sum() < 2:  # the base alone
        return None
    low, high = 0.0, lengths[base]
    member = np.zeros(len(segments), bool)
    member[base] = True
    for _ in range(3):
        reach = 0.5 * (high - low)
        member |= eligible & (along[0] < high + reach) & (along[1] > low - reach)
        low = max(along[0][member].min(), -1.5 * lengths[base])
        high = min(along[1][member].max(), 2.5 * lengths[base])
    width = float(np.ptp(across[member]))
    if width < THINNEST_BAND or high - low < 1.2 * width:
        return None
    centre = origin + normal * (across[member].min() + width / 2)
    ends = (centre + low * axis, centre + high * axis)
    gaps = (_to_border(ends[0], -axis, field), _to_border(ends[1], axis, field))
    entry = int(gaps[1] < gaps[0])
    inward = axis if entry == 0 else -axis
    if _is_caption(ends[entry], inward, width, field.shape):
        return None
    return Band(ends[entry], inward, high - low, width, gaps[entry], int(member.sum()), float(lengths[member].sum()))


def _to_border(point: np.ndarray, direction: np.ndarray, field: np.ndarray) -> float:
    """Distance from a point to the end of the picture along a direction [px]; 0 outside it."""
    reach = np.arange(0.0, sum(field.shape), 2.0)
    columns, rows = np.rint(point + reach[:, None] * direction).astype(int).T
    inside = (columns >= 0) & (columns < field.shape[1]) & (rows >= 0) & (rows < field.shape[0])
    inside[inside] = field[rows[inside], columns[inside]]
    return float(reach[np.argmin(inside)])


def _is_caption(start: np.ndarray, axis: np.ndarray, width: float, shape: tuple[int, int]) -> bool:
    """Whether a band lies exactly along an image side and close to it, as boxes of text do and instruments seldom."""
    tilt = np.abs(axis)
    if tilt.min() > np.sin(np.radians(1.0)):
        return False
    lateral = int(np.argmin(tilt))
    extent = shape[1] if lateral == 0 else shape[0]
    nearest = min(start[lateral], extent - 1 - start[lateral]) - width / 2
    return bool(nearest < CAPTION_MARGIN * shape[0])
