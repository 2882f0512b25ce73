"""Tool and tissue masks of raw video without a learned model: instruments by shape, other lit pixels as tissue.

An instrument is a band of straight parallel edges that enters from the picture's border, is paler than tissue of the
same brightness, and, while it moves, moves against the tissue. One that was found twice and isn't found in a frame is
followed there as a rigid body, for half a second at most. The mode abstains (no tool pixel) when unsure.
docs/reports/masks.md reports its accuracy on real clips.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.data.labels import TISSUE, TOOL
from palpate.data.masks.instrument_bands import WORKING_SIZE, Band, find_bands
from palpate.data.masks.rigid import RigidInstrument, filled
from palpate.data.source.frames import Frame

VERSION = 3
"""Version of the method, part of the masks' identity; it must rise when the result changes."""
SATURATED = 245
"""Pixels whose brightest channel is at least this have no usable colour [8-bit value]."""
COLOR_MARGIN = 60.0
"""Distance around a band within which its instrument is sought by colour [working px]."""
SAME_REDNESS = 0.1
"""Excess of redness over a band's at which a pixel around the band no longer belongs to its instrument."""
DARKEST_LIT = 18
"""Pixels whose brightest channel is below this are unlit or clipped [8-bit value]."""
# Thresholds; pallor as in `pallor`, lengths in working pixels.
MIN_LENGTH = 40.0
"""Shortest band [px]."""
MAX_GAP = 1.2
"""Longest distance between a band and the border, as a multiple of the band's length."""
COLORLESS_PALLOR = 0.12
"""Least pallor of a band that is an instrument by its colour; it must also pass the next two limits."""
MAX_REDNESS = 0.08
"""Largest median redness of that band."""
COLORLESS_SUPPORT = 0.65
"""Least summed length of that band's edges, as a multiple of its length."""
SATURATED_SHARE = 0.2
"""A pale band with a larger share of saturated pixels is a highlight on tissue."""
GROOVED_PALLOR = 0.02
"""Least pallor of a band that is an instrument by the many sharp edges of its jaws and joints."""
GROOVED_CONTRAST = 65.0
"""Least mean brightness gradient across that band (3x3 Sobel of 8-bit values)."""
GROOVED_EDGES = 6
"""Least number of that band's edges."""
GROOVED_SUPPORT = 1.8
"""Least summed length of that band's edges, as a multiple of its length."""
MOVING_PALLOR = 0.03
"""Least pallor of a band that is an instrument because it has several edges and moves against the tissue."""
MOVING_EDGES = 4
"""Least number of that band's edges."""
MIN_MOTION = 3.0
"""Least median motion of that band against the tissue [px a frame]."""
MAX_INSTRUMENTS = 3
"""Largest number of instruments in one picture."""
MOST_MISSED = 12
"""So many frames in a row an instrument is followed without being found."""
BLOCK, CHANGED, CHANGED_BLOCKS = 8, 6, 4
"""A picture has changed where the means of so many blocks differ by more than so much: width of blocks [working px],
difference [8-bit value], and their number."""
LEVELS = 1024
"""Levels of redness by which its quantiles are found; sorting all pixels takes five times as long."""
SAME = 0.3
"""What is found is a known instrument if they share so much of the smaller one."""


@dataclass(frozen=True)
class Look:
    """Colour maps of a working picture, each float32 [h, w]."""

    pale: np.ndarray
    """Pallor (see `pallor`)."""
    red: np.ndarray
    """Redness (see `redness`)."""
    bright: np.ndarray
    """Brightest channel [8-bit value]."""

    def is_colorless(self, band: Band) -> bool:
        """Whether a band is paler than tissue and hardly red at all."""
        pale, red = (float(np.median(band_values(band, values))) for values in (self.pale, self.red))
        return pale >= COLORLESS_PALLOR and red <= MAX_REDNESS


@dataclass
class _Known:
    """An instrument that was found."""

    body: RigidInstrument
    times: int
    """How often it was found."""
    missed: int = 0
    """Frames since then."""

    def is_at(self, mask: np.ndarray) -> bool:
        """Whether it is what a mask shows, bool [h, w]."""
        own = filled(np.zeros(mask.shape, np.uint8), self.body.outline, 1) > 0
        return bool((own & mask).sum() > SAME * min(own.sum(), mask.sum()))


class AutomaticMasks:
    """Mask source (see masks.MaskSource) for raw video; frames must come in order.

    Args:
        every: while the picture stays as it is or instruments are known, they are sought in one of so many frames,
            and followed in the others.
    """

    def __init__(self, every: int = 1) -> None:
        self.identity, self._every = f"automatic:{VERSION}" + (f":{every}" if every > 1 else ""), every
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self.reset()

    def reset(self) -> None:
        """Forget the frames of the clip so far."""
        self._last_gray: np.ndarray | None = None
        self._known: list[_Known] = []
        self._field = np.zeros((0, 0), bool)
        """The endoscope's picture when instruments were sought last."""
        self._since = 0
        """Frames since then."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a frame."""
        image = frame.picture
        working = _working(image)
        gray = cv2.cvtColor(working, cv2.COLOR_RGB2GRAY)
        if self._since == 0 or (not self._known and self._has_changed(gray)):
            tool, self._since = self._find_tool(working, gray), 0
        else:
            tool = self._followed(gray)
        self._since = (self._since + 1) % self._every
        labels = lit_picture(image).astype(np.uint8) * np.uint8(TISSUE)
        if tool.any():
            full = cv2.resize(tool.astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            labels[full > 0.5] = TOOL
        return labels

    def _find_tool(self, working: np.ndarray, gray: np.ndarray) -> np.ndarray:
        """Tool pixels of the working picture, in colours and in grey, bool [h, w]."""
        lit = lit_picture(working)
        field = self._field = picture_field(lit)
        smooth = cv2.GaussianBlur(working, (0, 0), 1.0).astype(np.float32)
        bright, red = brightest_channel(smooth), redness(smooth)
        look = Look(pallor(red, bright, lit), red, bright)
        motion = functools.cache(functools.partial(self._motion_against_tissue, gray, self._last_gray, field))
        self._last_gray = gray
        slopes = cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1)
        found: list[np.ndarray] = []
        near = np.zeros(lit.shape, bool)
        for band in find_bands(gray, field):
            if len(found) == MAX_INSTRUMENTS:
                break
            # The strongest band stands for its instrument: bands next to it are its shadow or the tissue it holds.
            if band_values(band, near).mean() < 0.1 and self._is_instrument(band, look, slopes, motion):
                found.append(outline_tool(band, look, field))
                near |= cv2.dilate(found[-1].astype(np.uint8), np.ones((41, 41), np.uint8)).astype(bool)
        self._update(found, gray)
        tool = np.any([np.zeros(lit.shape, bool), *found], axis=0).astype(np.uint8)
        for known in self._known:
            if known.missed and known.times > 1:
                filled(tool, known.body.outline, 1)
        return (tool > 0) & field

    def _has_changed(self, gray: np.ndarray) -> bool:
        """Whether a working picture differs from the last one, as where an instrument comes into view."""
        if self._last_gray is None or self._last_gray.shape != gray.shape:
            return True
        size = max(gray.shape[1] // BLOCK, 1), max(gray.shape[0] // BLOCK, 1)
        blocks = [cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (gray, self._last_gray)]
        return int((cv2.absdiff(*blocks) > CHANGED).sum()) >= CHANGED_BLOCKS

    def _followed(self, gray: np.ndarray) -> np.ndarray:
        """Where the known instruments have gone in a working picture, bool [h, w]."""
        tool, self._last_gray = np.zeros(gray.shape, np.uint8), gray
        self._known = [known for known in self._known if known.body.follow(gray)]
        for known in self._known:
            if not known.missed or known.times > 1:
                filled(tool, known.body.outline, 1)
        return (tool > 0) & self._field

    def _update(self, found: list[np.ndarray], gray: np.ndarray) -> None:
        """Take what is found in a picture [h, w], masks [h, w], and follow what isn't."""
        now = []
        for mask in found:
            times = 1 + max((known.times for known in self._known if known.is_at(mask)), default=0)
            parts, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
            if parts:
                outline = max(parts, key=cv2.contourArea)[:, 0].astype(np.float64)
                now.append(_Known(RigidInstrument(outline, gray), times))
        for known in self._known:
            known.missed += self._every
            if known.missed <= MOST_MISSED and not any(known.is_at(mask) for mask in found) and known.body.follow(gray):
                now.append(known)
        self._known = now

    def _is_instrument(
        self, band: Band, look: Look, slopes: tuple[np.ndarray, np.ndarray], motion: Callable[[], np.ndarray]
    ) -> bool:
        """Whether a band's colour, edges or motion are an instrument's."""
        if band.length < MIN_LENGTH or band.gap > MAX_GAP * band.length:
            return False
        density = band.support / band.length
        if look.is_colorless(band) and density >= COLORLESS_SUPPORT:
            return bool((band_values(band, look.bright) >= SATURATED).mean() < SATURATED_SHARE)
        paleness = float(np.median(band_values(band, look.pale)))
        many = band.edges >= GROOVED_EDGES and density >= GROOVED_SUPPORT
        if many and paleness >= GROOVED_PALLOR:
            across = sum(band_values(band, slope) * part for slope, part in zip(slopes, band.normal, strict=True))
            if np.abs(across).mean() >= GROOVED_CONTRAST:
                return True
        if paleness >= MOVING_PALLOR and band.edges >= MOVING_EDGES:
            return bool(np.median(band_values(band, motion())) >= MIN_MOTION)
        return False

    def _motion_against_tissue(self, gray: np.ndarray, before: np.ndarray | None, field: np.ndarray) -> np.ndarray:
        """Speed against the affine motion of most of the picture [px a frame], float32 [h, w]; 0 at first."""
        if before is None or before.shape != gray.shape:
            return np.zeros(gray.shape, np.float32)
        size = (gray.shape[1] // 2, gray.shape[0] // 2)
        first, second = (cv2.resize(g, size, interpolation=cv2.INTER_AREA) for g in (gray, before))
        flow = self._flow.calc(first, second, None)  # ty: ignore[no-matching-overload]  no first guess
        rows, columns = (grid.ravel() for grid in np.mgrid[4 : size[1] : 8, 4 : size[0] : 8])
        inside = field[rows * 2, columns * 2]
        if inside.sum() < 3:  # three points make an affine motion; a black picture has none
            return np.zeros(gray.shape, np.float32)
        source = np.stack([columns, rows], axis=1)[inside].astype(np.float32)
        target = source + flow[rows[inside], columns[inside]]
        matrix, _ = cv2.estimateAffine2D(source, target, method=cv2.RANSAC, ransacReprojThreshold=1.0, maxIters=200)
        if matrix is None:
            return np.zeros(gray.shape, np.float32)
        v, u = np.mgrid[: size[1], : size[0]].astype(np.float32)
        expected = np.stack([u, v, np.ones_like(u)], axis=-1) @ matrix.T.astype(np.float32) - np.stack([u, v], axis=-1)
        speed = 2 * np.linalg.norm(flow - expected, axis=2)
        return cv2.resize(speed.astype(np.float32), gray.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _working(image: np.ndarray) -> np.ndarray:
    """A picture [H, W, 3] whose longer side is WORKING_SIZE."""
    scale = WORKING_SIZE / max(image.shape[:2])
    size = max(round(image.shape[1] * scale), 16), max(round(image.shape[0] * scale), 16)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)


def lit_picture(image: np.ndarray) -> np.ndarray:
    """Lit pixels of the endoscope's picture, bool [H, W], from RGB uint8 [H, W, 3].

    They are the largest connected region that is not black: the dark surround and clipped black pixels are left out.
    """
    bright = brightest_channel(cv2.blur(image, (5, 5))) > DARKEST_LIT
    count, regions = cv2.connectedComponents(bright.astype(np.uint8))
    if count <= 2:
        return bright
    return regions == 1 + int(np.argmax(np.bincount(regions[bright])[1:]))


def brightest_channel(image: np.ndarray) -> np.ndarray:
    """Largest of the three channels, [H, W]; many times faster than numpy's maximum over a short last axis."""
    first, second, third = cv2.split(image)
    return cv2.max(cv2.max(first, second), third)


def picture_field(lit: np.ndarray) -> np.ndarray:
    """Convex hull of the lit pixels, bool [H, W]: the endoscope's whole picture, shadows included."""
    field = np.zeros(lit.shape, np.uint8)
    outlines, _ = cv2.findContours(lit.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if outlines:
        cv2.fillConvexPoly(field, cv2.convexHull(np.concatenate(outlines)), 1)
    return field.astype(bool)


def redness(image: np.ndarray) -> np.ndarray:
    """(R − (G+B)/2)/max of every pixel, float32 [H, W]: about 0.5 for liver, 0.25 for pale organs, 0 for metal."""
    red, green, blue = cv2.split(image)
    return (red - (green + blue) / 2) / (cv2.max(cv2.max(red, green), blue) + 8)


def pallor(red: np.ndarray, bright: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """How much less red a pixel is than four fifths of the lit picture at its brightness, float32 [H, W].

    Tissue is redder the darker it is; metal and plastic are not, so that a comparison at equal brightness separates a
    dark instrument from pale tissue. All pixels of one brightness may be instrument, so the expected redness is at
    least 0.45 of the whole picture's median.

    Args:
        red: redness, [H, W].
        bright: brightest channel [8-bit value], [H, W].
        lit: lit pixels, bool [H, W].
    """
    if not lit.any():
        return np.zeros(red.shape, np.float32)
    bins = (bright * (1 / 16)).astype(np.uint8)
    counts = cv2.calcHist([bins.astype(np.float32), red], [0, 1], lit.astype(np.uint8), [16, LEVELS], [0, 16, -1, 1])
    least = 0.45 * float(_quantiles(counts.sum(axis=0, keepdims=True), 0.5)[0])
    expected = np.maximum(_quantiles(counts, 0.2), least).astype(np.float32)
    return np.where(lit, expected[bins] - red, np.float32(0))


def _quantiles(counts: np.ndarray, share: float) -> np.ndarray:
    """Redness that a share of the pixels lie below, by histograms [N, LEVELS] from -1 to 1, shape [N]."""
    below = np.cumsum(counts, axis=1)
    wanted = share * below[:, -1:]
    level = np.argmax(below >= wanted, axis=1)[:, None]
    inside = np.take_along_axis(counts, level, axis=1)
    over = (np.take_along_axis(below, level, axis=1) - wanted) / np.maximum(inside, 1)
    return 2 * (level + 1 - over)[:, 0] / counts.shape[1] - 1


def band_values(band: Band, values: np.ndarray) -> np.ndarray:
    """Samples of a map [h, w] on a grid inside a band."""
    along = np.linspace(0.0, band.length, max(int(band.length / 3), 4))
    across = np.linspace(-0.45, 0.45, 9) * band.width
    columns, rows = np.rint(band.points(along, across)).astype(int).reshape(-1, 2).T
    inside = (columns >= 0) & (columns < values.shape[1]) & (rows >= 0) & (rows < values.shape[0])
    return values[rows[inside], columns[inside]] if inside.any() else np.zeros(1, np.float32)


def outline_tool(band: Band, look: Look, field: np.ndarray) -> np.ndarray:
    """Pixels of the instrument of a band, bool [h, w].

    They are the band itself, extended to the border. Where it is an instrument by its colour, they are all connected
    pixels around it that share the colour: jaws and a second edge may lie outside the band.
    """
    core = np.zeros(field.shape, np.uint8)
    cv2.fillConvexPoly(core, band.outline(-band.gap - 2, band.length), 1)
    if not look.is_colorless(band):
        return (core > 0) & field
    around = np.zeros(field.shape, np.uint8)
    cv2.fillConvexPoly(around, band.outline(-band.gap - 2, band.length + COLOR_MARGIN, COLOR_MARGIN), 1)
    paleness, red = (float(np.median(band_values(band, values))) for values in (look.pale, look.red))
    # Highlights on the instrument are inside the band, those on tissue outside it.
    same = (look.pale > 0.5 * paleness) & (look.red < red + SAME_REDNESS) & (look.bright < SATURATED)
    same |= (core > 0) & (look.pale > 0.3 * paleness)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    closed = cv2.morphologyEx((same & (around > 0) & field).astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel)
    _, regions = cv2.connectedComponents(opened)
    overlap = np.bincount(regions[(core > 0) & (opened > 0)], minlength=1)
    return (regions == int(np.argmax(overlap))) & (opened > 0) & field if overlap.any() else np.zeros(field.shape, bool)
