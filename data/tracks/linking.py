"""Links from places of one picture to those in another, checked forwards and backwards (Kalal 2010).

A few places are linked each for itself by pyramidal Lucas and Kanade (`followed`; Bouguet 2001). Hundreds on a grid are
linked together (`Linker`). Their rough motion is known already, or is found by dense inverse search flow (Kroeger 2016,
OpenCV's DIS) of pictures of a quarter of the size. A few steps of Lucas and Kanade's method (1981) refine it at the
places themselves, in whole pictures without their local mean, which changes with the light.
"""

import functools
from typing import NamedTuple

import cv2
import numpy as np

WINDOW = 9
"""Width of Lucas and Kanade's windows for places whose motion is roughly known [px]; 9 px cost less than 7."""
TEXTURE = 1e-3
"""Smaller eigenvalue of a window's slopes below which places are not followed, as OpenCV scales it."""
MAX_STEP = 3.0
"""Largest step by axis that is believed [px]."""
SMOOTH = 1.0
"""Standard deviation of the filter over the motion of neighbouring places [grid spacings]."""
REACH, STEP = 6, 3
"""Half width of a pattern around a point, and distance of its samples [px]."""

Mask = np.ndarray | None
"""Mask of some of N places, bool [N]; None = all."""


class _Search(NamedTuple):
    """Settings of Lucas and Kanade's method."""

    levels: int
    """Levels of the pyramid beyond the picture itself; with three of them motion is found up to some 50 px."""
    steps: int
    """Most steps on every level; where motion is roughly known, more of them follow noise."""
    last_step: float
    """Length of the step after which there is no other [px]."""
    texture: float
    """Least eigenvalue of a window's gradients; below it the window is too smooth to be tracked."""


class Prepared(NamedTuple):
    """A picture for linking."""

    fine: np.ndarray
    """Picture without its local mean, float32 [H, W]. It is warped before it is rounded: rounding hides a shift by a
    few hundredths of a pixel where contrast is low."""
    exact: np.ndarray
    """Picture rounded to whole numbers, uint8 [H, W]."""
    rough: np.ndarray
    """Picture of a quarter of the size, uint8."""
    shares: np.ndarray
    """Width and height of the whole picture over those of the small one, float32 [2]."""


class Links(NamedTuple):
    """Links of N places of one picture to another one, float32."""

    places: np.ndarray
    """Places in the other picture, shape [N, 2] [px]."""
    returned: np.ndarray
    """Distance between a place and the end of the way back, shape [N] [px]. It is not filtered, as both ways would
    share the filter's error."""


class Linker:
    """Links pictures, two of one size at a time.

    Args:
        grid: mask of a grid's N linked places [rows, columns]; None = the places are on no grid, and
            their motion is not filtered.
        spacing: spacing of the grid [px]; infinite where windows are small against it.
    """

    def __init__(self, grid: np.ndarray | None = None, spacing: float = np.inf) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._flow.setFinestScale(0)  # the small picture's own
        self._flow.setPatchStride(5)
        self._flow.setGradientDescentIterations(12)
        self._flow.setVariationalRefinementIterations(0)
        self._grid = None if grid is None else (grid.shape, np.flatnonzero(grid))
        """Shape of the grid, and indices of the places in it."""
        # Windows and filter widen what dies away within tens of pixels by variance/2 · ∇²: of 2·filter - this none.
        self._wider = float(np.sqrt(2 * SMOOTH**2 + WINDOW**2 / 12 / spacing**2))
        self._spacing = spacing

    def prepared(self, picture: np.ndarray) -> Prepared:
        """Prepare a picture, uint8 [H, W]."""
        fine = _flat(picture)
        height, width = picture.shape
        size = max(width // 4, 16), max(height // 4, 16)  # DIS refuses smaller pictures
        # Shrinking by a whole number costs a tenth, at up to three pixels along two edges.
        covered = min(size[0] * 4, width), min(size[1] * 4, height)
        small = cv2.resize(picture[: covered[1], : covered[0]], size, interpolation=cv2.INTER_AREA)
        return Prepared(fine, _rounded(fine), small, (np.array(covered) / size).astype(np.float32))

    def link(
        self, one: Prepared, other: Prepared, places: np.ndarray, counted: Mask = None, apart: Mask = None
    ) -> Links:
        """Link places of one picture to the other.

        Args:
            one, other: the pictures.
            places: shape [N, 2] (column, row) [px].
            counted: mask of places that count for their neighbours' motion [N]; None = all.
            apart: mask of places away from an instrument's edge [N]; those at it count only for one another.
        """
        if not len(places):
            return _no_links()
        here = places.astype(np.float32)
        step = self._filtered(_step(one, other, here, self._rough(one, other, here))[0], counted, apart)
        there = here + step
        back = _step(other, one, there, self._rough(other, one, there))[0]
        return Links(there, _length(step + back))

    def refine(
        self, one: Prepared, other: Prepared, places: np.ndarray, motion: np.ndarray, apart: np.ndarray
    ) -> Links:
        """Return the motion where the way is known to a few pixels; infinite where that is not confirmed.

        The other picture is warped back by it first: a window that is stretched or turned resembles itself again.

        Args:
            one, other: the pictures.
            places: shape [N, 2] (column, row) [px].
            motion: motion of the grid, whose first place is a spacing from both edges, shape [rows, columns, 2] [px].
            apart: mask as in `link`.
        """
        if not len(places):
            return _no_links()
        here = places.astype(np.float32)
        field = self.dense(motion, one.fine.shape)
        fine = sampled(other.fine, field + _pixels(one.fine.shape))
        bent = other._replace(fine=fine, exact=_rounded(fine))
        left, found = _step(one, bent, here, np.zeros_like(here))
        back, returned = _step(bent, one, here + left, -left)
        off = np.where(found & returned, _length(left + back), np.inf).astype(np.float32)
        step = left + sampled(field, (here + left)[:, None])[:, 0]
        return Links(here + self._filtered(step, found, apart), off)

    def dense(self, motion: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Motion of the grid at every pixel of a picture of a shape (H, W), smooth, float32 [H, W, 2]."""
        height, width = shape
        grid_per_pixel = np.array([[1 / self._spacing, 0, -1], [0, 1 / self._spacing, -1]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(motion, grid_per_pixel, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)

    def _rough(self, one: Prepared, other: Prepared, places: np.ndarray) -> np.ndarray:
        """Motion of places, shape [N, 2] [px], by flow of the small pictures, bilinear between its pixels."""
        flow = self._flow.calc(one.rough, other.rough, None)  # ty: ignore[no-matching-overload]  None is a guess
        # In place of DIS's variational refinement, which costs twice as much.
        flow = cv2.GaussianBlur(flow, (0, 0), 1.0)
        return sampled(flow, ((places + 0.5) / one.shares - 0.5)[:, None])[:, 0] * one.shares

    def _filtered(self, step: np.ndarray, counted: Mask, apart: Mask = None) -> np.ndarray:
        """Motion [N, 2] with that of those neighbours on the grid that count; by itself where there are none.

        Places at an instrument's edge, which drags them along, don't count for those that are apart from it.
        """
        if self._grid is None:
            return step
        shown = np.ones(len(step), bool) if counted is None else counted
        everywhere = self._among(step, shown)
        return everywhere if apart is None else np.where(apart[:, None], self._among(step, shown & apart), everywhere)

    def _among(self, step: np.ndarray, counted: np.ndarray) -> np.ndarray:
        """Motion [N, 2] with that of those neighbours that count, bool [N]."""
        assert self._grid is not None
        shape, cells = self._grid
        weight = counted[:, None].astype(np.float32)
        field = np.zeros((shape[0] * shape[1], 3), np.float32)
        field[cells] = np.hstack([step * weight, weight])

        def around(deviation: float) -> np.ndarray:
            total = cv2.GaussianBlur(field.reshape(*shape, 3), (0, 0), deviation).reshape(-1, 3)[cells]
            return np.where(total[:, 2:] > 0, total[:, :2] / np.maximum(total[:, 2:], np.finfo(np.float32).tiny), step)

        return 2 * around(SMOOTH) - around(self._wider)


def _no_links() -> Links:
    return Links(np.zeros((0, 2), np.float32), np.zeros(0, np.float32))


def flat(picture: np.ndarray) -> np.ndarray:
    """A picture, uint8 [H, W], without its local mean, which changes with the light."""
    return _rounded(_flat(picture))


def _flat(picture: np.ndarray) -> np.ndarray:
    mean = cv2.boxFilter(picture, cv2.CV_32F, (15, 15))
    return cv2.addWeighted(picture, 1, mean, -1, 128, dtype=cv2.CV_32F)


@functools.lru_cache(maxsize=1)
def _pixels(shape: tuple[int, int]) -> np.ndarray:
    """Places (column, row) of all pixels of a picture, float32 [H, W, 2]."""
    height, width = shape
    return np.moveaxis(np.mgrid[:height, :width], 0, -1)[..., ::-1].astype(np.float32)


def _rounded(picture: np.ndarray) -> np.ndarray:
    """A picture as uint8, 0 or 255 where it is darker or brighter."""
    return cv2.addWeighted(picture, 1, picture, 0, 0, dtype=cv2.CV_8U)


def sampled(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values of a picture [H, W, …] at places [h, w, 2] (column, row) [px], bilinear, shape [h, w, …]."""
    columns, rows = cv2.split(places)
    return cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.hypot(*vectors.T)


def _lucas_kanade(
    one: np.ndarray, other: np.ndarray, places: np.ndarray, near: np.ndarray, window: int, search: _Search
) -> tuple[np.ndarray, np.ndarray]:
    """Places [N, 2] of one picture in another one, searched from `near` [N, 2], and mask of those found, bool [N]."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        one,
        other,
        places,
        near.copy(),
        winSize=(window, window),
        maxLevel=search.levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, search.steps, search.last_step),
        # What else it gives is not used; eigenvalues it knows anyway, how far the pictures differ costs a third more.
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW | cv2.OPTFLOW_LK_GET_MIN_EIGENVALS,
        minEigThreshold=search.texture,
    )
    return there, found[:, 0] > 0


def _step(one: Prepared, other: Prepared, places: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion of places [N, 2] near a guess [N, 2] [px], and mask of those found, bool [N]; others move as guessed."""
    near = (places + guess).astype(np.float32)
    there, found = _lucas_kanade(one.exact, other.exact, places, near, WINDOW, _Search(0, 4, 0.02, 1e-4))
    believed = found & (np.abs(there - near).max(axis=1) < MAX_STEP)
    return np.where(believed[:, None], there, near) - places, believed


def followed(
    one: np.ndarray, other: np.ndarray, places: np.ndarray, window: int = 15, near: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of places of one picture to another one, each for itself (pyramidal Lucas and Kanade, Bouguet 2001).

    Args:
        one, other: the pictures, uint8 [H, W].
        places: shape [N, 2] (column, row) [px].
        window: width of the windows that are compared [px].
        near: about where they are in the other picture, shape [N, 2] [px]; None = where they were.

    Returns:
        Displacements, shape [N, 2] [px], and mask of those known, bool [N].
    """
    if not len(places):
        return np.zeros((0, 2)), np.zeros(0, bool)
    start, search = places.astype(np.float32), _Search(3, 10, 0.03, TEXTURE)
    guess = start if near is None else near.astype(np.float32)
    there, found = _lucas_kanade(one, other, start, guess, window, search)
    back, returned = _lucas_kanade(other, one, there, there + start - guess, window, search)
    # Largest distance to where following backwards takes such a place [px].
    return (there - start).astype(np.float64), found & returned & (_length(back - start) < 1.0)


def textured(picture: np.ndarray, places: np.ndarray, window: int = 15) -> np.ndarray:
    """Mask of the places that `followed` may find, in a fraction of its time; arguments as there."""
    if not len(places):
        return np.zeros(0, bool)
    start = places.astype(np.float32)
    return _lucas_kanade(picture, picture, start, start, window, _Search(0, 1, 1.0, TEXTURE))[1]


def patterns(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Patterns around places [N, 2] of a picture [H, W], float32 [N, K], without mean and of unit length.

    Zero where the picture is plain.
    """
    steps = np.arange(-REACH, REACH + 1, STEP, dtype=np.float32)
    columns, rows = (axis.ravel() for axis in np.meshgrid(steps, steps))
    if not len(places):
        return np.zeros((0, len(rows)), np.float32)
    column, row = places.astype(np.float32).T[..., None]
    values = sampled(picture, np.stack([column + columns, row + rows], axis=-1)).astype(np.float32)
    values -= values.mean(axis=1, keepdims=True)
    return values / np.sqrt(np.maximum(np.einsum("nk,nk->n", values, values), 1))[:, None]


def resemblance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Correlation of patterns [N, K], shape [N], from -1 to 1."""
    return np.einsum("nk,nk->n", one, other)
