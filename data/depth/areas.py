"""Means of a map over the pixels of a coarse grid, label by label: `cv2.resize` by area of every label, in one pass."""

import math
from functools import lru_cache, partial

import cv2
import numpy as np

from palpate.data.labels import OTHER, TISSUE, TOOL
from palpate.physics.jit import kernel

ORDER = (TOOL, TISSUE, OTHER, 255)
"""Labels by their rank where they cover equal areas; 255 is outside the picture."""
Covered = tuple[np.ndarray, np.ndarray, np.ndarray]


def label_areas(depth: np.ndarray, labels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Share of every label of ORDER in a grid's pixels, share with a depth above 0, and depth summed over that.

    Args:
        depth: shape [H, W] float32.
        labels: shape [H, W] uint8.
        size: (height, width) of the grid.

    Returns:
        Shape [3, 4, h, w] float32, to the bit what `resized_map` gives of every label's maps.
    """
    sides = list(zip(labels.shape, size, strict=True))
    if any(side < own for side, own in sides) or all(side % own == 0 for side, own in sides):
        found = np.zeros((3, len(ORDER), *size), np.float32)
        for index, label in enumerate(ORDER):
            member = (labels == label).astype(np.float32)
            if member.any():
                usable = member * (depth > 0)
                found[:, index] = [resized_map(each, size) for each in (member, usable, depth * usable)]
        return found
    sums, number = np.zeros((3, len(ORDER) + 1, *size), np.float32), np.full(256, len(ORDER))
    number[list(ORDER)] = range(len(ORDER))
    _add_areas(np.ascontiguousarray(depth, np.float32), labels, number, *(_covered(*each) for each in sides), sums)
    return sums[:, :-1]


def resized_map(map_: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A map at a size (height, width): area average when shrinking, bilinear when enlarging."""
    shrinking = size[0] <= map_.shape[0] and size[1] <= map_.shape[1]
    return cv2.resize(map_, size[::-1], interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR)


@lru_cache(maxsize=8)
def _covered(side: int, own: int) -> Covered:
    """What pixels of a grid of `own` along an axis cover of `side`, as OpenCV has it.

    Returns:
        Where each one's part begins in the others, shape [own + 1]; pixels covered; share of each in the mean, float32.
    """
    scale, begins, at, shares = 1 / (own / side), [0], [], []
    for index in range(own):
        begin, end = index * scale, index * scale + scale
        whole = min(scale, side - begin)
        last = min(math.floor(end), side - 1)
        first = min(math.ceil(begin), last)
        parts = [(first - 1, first - begin)] if first - begin > 1e-3 else []
        parts += [(pixel, 1.0) for pixel in range(first, last)]
        parts += [(last, min(end - last, 1.0, whole))] if end - last > 1e-3 else []
        at += [pixel for pixel, _ in parts]
        shares += [part / whole for _, part in parts]
        begins.append(len(at))
    return np.array(begins), np.array(at), np.array(shares, np.float32)


@partial(kernel, fastmath=False)  # sums are rounded as OpenCV's
def _add_areas(
    depth: np.ndarray, labels: np.ndarray, number: np.ndarray, down: Covered, across: Covered, sums: np.ndarray
) -> None:
    begins, at, shares = across
    _, count, height, width = sums.shape
    zero = np.float32(0)
    for row in range(height):
        for line in range(down[0][row], down[0][row + 1]):
            z, shown, weight = depth[down[1][line]], labels[down[1][line]], down[2][line]
            for column in range(width):
                begin, end = begins[column], begins[column + 1]
                left, label = end - begin, number[shown[at[begin]]]
                while left > 0:  # most often all are of one label
                    area = known = total = zero
                    for part in range(begin, end):
                        pixel, share = at[part], shares[part]
                        if number[shown[pixel]] == label:
                            left -= 1
                            area += share
                            if z[pixel] > 0:
                                known += share
                                total += z[pixel] * share
                    sums[0, label, row, column] += weight * area
                    sums[1, label, row, column] += weight * known
                    sums[2, label, row, column] += weight * total
                    label = (label + 1) % count
