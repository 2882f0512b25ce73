"""Where points are in a picture when a model gives their motion to within a pixel or so.

Lucas and Kanade's method (1981) in windows that leave out what is no tissue: an instrument drags windows along that
hold its edge, and highlights stay where light and surface want them, whatever the tissue does. What is left of the
motion is small and smooth, so that windows may be wide, and nothing is averaged with the neighbours', as a filter
would, which biases the motion at an instrument's edge, where neighbours lie on one side alone.
"""

from typing import NamedTuple

import cv2
import numpy as np

from palpate.data.tracks.linking import sampled

SMOOTH = 0.8
"""Standard deviation of the filter over pictures, between whose pixels values are linear [px]. (OpenCV's cubic ones
take a third off small motions: they don't keep a ramp.)"""
HALF, STEPS, MAX_STEP = 10, 2, 3.0
"""Windows reach so far to either side [px]; steps of Gauss and Newton's; what leads farther by axis is not believed
[px]."""
NARROW, BRIGHT, RARE, AROUND = 21, 30, 3.0, 2
"""Highlights are less than so wide [px], and brighter in all channels than what is around, by so much (of 255) and so
many times what half of the pixels are; pixels so near to them are left out, too [px]."""
MIN_SHARE, MIN_CORRELATION, MAX_DIFFERENCE = 0.6, 0.8, 5.0
"""A point is found where at least this share of its window is visible, the windows' correlation is above this, and
their mean square difference is below so many times the median: windows that hold something else settle anywhere."""
CORRELATED = 6.0
"""By which factor the variance of a point is larger than if windows differed independently from pixel to pixel: of 12
pictures of six drawn grips, in which it is so for the surest tenth of points (0.04 px) as for the least sure (0.12)."""
AT_ONCE = 1000
"""Points in memory together."""


class Fine(NamedTuple):
    """A picture in which points are measured."""

    gray: np.ndarray
    """Smoothed, float32 [H, W]."""
    plain: np.ndarray
    """1 where it shows tissue without a highlight, else 0, float32 [H, W]."""


class Measured(NamedTuple):
    """Where N points are."""

    moved: np.ndarray
    """Since the first picture, shape [N, 2] [px]; not a number where a point is not found."""
    noise: np.ndarray
    """Its standard deviation by axis, shape [N] [px]."""


def fine(gray: np.ndarray, least: np.ndarray, tissue: np.ndarray) -> Fine:
    """A picture for measuring.

    Args:
        gray: uint8 [H, W].
        least: the least of a pixel's channels, uint8 [H, W].
        tissue: where it shows tissue, bool [H, W].
    """
    brighter = cv2.morphologyEx(least, cv2.MORPH_TOPHAT, np.ones((NARROW, NARROW), np.uint8))
    least_highlight = max(BRIGHT, RARE * float(np.median(brighter[::4, ::4])))
    square = np.ones((2 * AROUND + 1, 2 * AROUND + 1), np.uint8)
    highlight = cv2.dilate((brighter > least_highlight).astype(np.uint8), square)
    plain = (tissue & (highlight == 0)).astype(np.float32)
    return Fine(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), SMOOTH), plain)


def measure(one: Fine, other: Fine, points: np.ndarray, motion: np.ndarray) -> Measured:
    """Where points of one picture are in another one.

    Args:
        one, other: the pictures.
        points: on whole pixels, shape [N, 2] (column, row) [px].
        motion: about how far every pixel moves, shape [H, W, 2] [px].
    """
    if not len(points):
        return Measured(np.zeros((0, 2)), np.zeros(0))
    slopes = np.gradient(one.gray)[::-1]
    some = np.array_split(points.astype(np.int64), -(-len(points) // AT_ONCE))
    pieces = [_steps(one, other, piece, motion, slopes) for piece in some]
    moved, variance, unlike, found = (np.concatenate(part) for part in zip(*pieces, strict=True))
    typical = float(np.median(unlike[found])) if found.any() else 0.0
    found &= unlike <= MAX_DIFFERENCE * typical
    noise = np.sqrt(CORRELATED * np.maximum(unlike, typical) * variance)
    return Measured(np.where(found[:, None], moved, np.nan), noise)


def _steps(
    one: Fine, other: Fine, points: np.ndarray, motion: np.ndarray, slopes: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of n points: motion [n, 2] [px], its variance by axis where pixels differ by 1 [n] [px²], the mean square by
    which windows differ [n], and which are found [n]."""
    offsets = np.moveaxis(np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1], 0, -1).reshape(-1, 2)[:, ::-1]
    size = np.array(one.gray.shape[::-1])
    place = points[:, None] + offsets
    column, row = np.moveaxis(np.clip(place, 0, size - 1), -1, 0)
    there = (place + motion[row, column]).astype(np.float32)
    visible = sampled(other.plain, there) > 1 - 1e-3
    visible &= ((there >= 0) & (there <= size - 1) & (place >= 0) & (place < size)).all(axis=-1)
    weight = one.plain[row, column] * visible
    total = np.maximum(weight.sum(axis=1), 1.0)

    def against_mean(values: np.ndarray) -> np.ndarray:
        return values - ((weight * values).sum(axis=1) / total)[:, None]

    shown = against_mean(one.gray[row, column])
    slope = np.stack([against_mean(axis[row, column]) for axis in slopes], axis=-1)
    weighted = slope * weight[..., None]
    # Without contrast nothing is determined; so small a number is noise's.
    normal = np.einsum("nka,nkb->nab", weighted, slope) + np.eye(2)
    left = np.zeros((len(points), 2), np.float32)
    for _ in range(STEPS):
        off = shown - against_mean(sampled(other.gray, there + left[:, None]))
        step = np.linalg.solve(normal, np.einsum("nka,nk->na", weighted, off)[..., None])[..., 0]
        left += np.clip(step, -MAX_STEP, MAX_STEP).astype(np.float32)
    last = against_mean(sampled(other.gray, there + left[:, None]))
    unlike = (weight * np.square(shown - last)).sum(axis=1) / total
    sizes = [(weight * np.square(values)).sum(axis=1) for values in (shown, last)]
    size = np.sqrt(np.maximum(sizes[0] * sizes[1], np.finfo(np.float32).tiny))
    similar = (weight * shown * last).sum(axis=1) / size > MIN_CORRELATION
    variance = 0.5 * np.trace(np.linalg.inv(normal), axis1=1, axis2=2)
    found = (total >= MIN_SHARE * len(offsets)) & similar & (np.abs(left).max(axis=1) < MAX_STEP)
    moved = motion[points[:, 1], points[:, 0]] + left
    return moved.astype(np.float64), variance, unlike, found
