"""Tissue points in space from places in a picture, and their motion if the tissue moved rigidly."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.data.contact.geometry import TISSUE
from palpate.data.source.camera import Camera


def grid_to_picture(pixels: np.ndarray, grid_shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Grid pixels (u, v), shape [P, 2], as pixels of the full picture of `size` (width, height)."""
    scale = np.array([size[0] / grid_shape[1], size[1] / grid_shape[0]])
    return (np.asarray(pixels, np.float64) + 0.5) * scale - 0.5


def picture_to_grid(pixels: np.ndarray, grid_shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Pixels (u, v) of the full picture, shape [P, 2], on the grid; the inverse of `grid_to_picture`."""
    scale = np.array([size[0] / grid_shape[1], size[1] / grid_shape[0]])
    return (np.asarray(pixels, np.float64) + 0.5) / scale - 0.5


def lift(pixels: np.ndarray, depth: np.ndarray, labels: np.ndarray, camera: Camera) -> np.ndarray:
    """Tissue points at sub-pixel places of the grid, each with the depth of the nearest tissue pixel.

    A point load makes a dent hardly wider than a pixel, and a mean over several would flatten it.

    Args:
        pixels: grid pixels (u, v), shape [P, 2].
        depth: z, shape [h, w] [scene units], 0 = invalid.
        labels: label map, shape [h, w].
        camera: intrinsics of the grid.

    Returns:
        Shape [P, 3] float64 [scene units]; NaN where no tissue depth is near.
    """
    valid = (labels == TISSUE) & (depth > 0)
    columns, rows = np.asarray(pixels, np.float64).reshape(-1, 2).T
    inside = (rows >= -0.5) & (columns >= -0.5) & (rows < depth.shape[0] - 0.5) & (columns < depth.shape[1] - 0.5)
    places = tuple(np.rint(np.where(inside, each, 0)).astype(int) for each in (rows, columns))
    heights = np.where(inside & valid[places], depth[places], np.nan).astype(np.float64)
    for hidden in np.flatnonzero(np.isnan(heights)):
        heights[hidden] = _depth_near(columns[hidden], rows[hidden], depth, valid)
    return np.stack((heights * (columns - camera.cx) / camera.fx, heights * (rows - camera.cy) / camera.fy, heights), 1)


def _depth_near(u: float, v: float, depth: np.ndarray, valid: np.ndarray) -> float:
    if not (math.isfinite(u) and math.isfinite(v)):
        return math.nan
    top, left = max(round(v) - 8, 0), max(round(u) - 8, 0)  # tissue farther away gives no depth
    window = np.s_[top : max(round(v) + 9, 0), left : max(round(u) + 9, 0)]
    rows, columns = np.nonzero(valid[window])
    if len(rows) == 0:
        return math.nan
    return float(depth[window][rows, columns][np.argmin(np.hypot(columns + left - u, rows + top - v))])


def rigid_motion(before: np.ndarray, after: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Displacement that a point would have if it moved rigidly with the others.

    Least-squares rotation and translation (Kabsch) are fitted again without the points that fit worse than three times
    the median: a deforming part does not count as camera motion.

    Args:
        before, after: points in two frames, shape [P, 3] [scene units]; rows that are not finite are ignored.
        at: the point, shape [3] [scene units].

    Returns:
        Shape [3] [scene units]; NaN with fewer than six points.
    """
    finite = np.isfinite(before).all(1) & np.isfinite(after).all(1)
    before, after = before[finite], after[finite]
    rotation, shift = np.eye(3), np.zeros(3)
    for _ in range(3):
        if len(before) < 6:
            return np.full(3, math.nan)
        centre, target = before.mean(0), after.mean(0)
        rotation = Rotation.align_vectors(after - target, before - centre)[0].as_matrix()
        shift = target - rotation @ centre
        residual = np.linalg.norm(before @ rotation.T + shift - after, axis=1)
        kept = residual <= 3 * np.median(residual) + 1e-12
        before, after = before[kept], after[kept]
    return rotation @ at + shift - at


def reference_pixels(depth: np.ndarray, labels: np.ndarray, contact: np.ndarray, most: int = 64) -> np.ndarray:
    """Evenly spaced tissue pixels (u, v) far from the contact, shape [P, 2], P at most `most`."""
    rows, columns = np.nonzero((labels == TISSUE) & (depth > 0))
    far = np.hypot(columns - contact[0], rows - contact[1]) >= 25
    pixels = np.stack((columns[far], rows[far]), 1)
    chosen = np.linspace(0, len(pixels) - 1, min(most, len(pixels))).round().astype(int)
    return pixels[chosen].astype(np.float64)
