"""The shape of tissue by its shading: that of the whole organ, without texture.

Under a light at the camera a plane n·X = h of one albedo sends back I ∝ (n·r)³/h² along the unit ray r: the distance is
h/(n·r), and the cosine to the light n·r. The gradient of brightness over a whole organ determines n to about ten
degrees. Changes over shorter distances are mostly albedo (vessels, fat, bruises): read as distance, they turn normals
by 50 degrees (docs/depth.md).
"""

import cv2
import numpy as np

from palpate.common.robust import median_sd
from palpate.data.source.camera import Camera, back_project

GRAZING = 0.05
"""Least cosine between the plane's normal and a ray."""


def organ_shape(depth: np.ndarray, tissue: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth from shading as a tilted plane, curved by the smooth residual over the whole organ.

    Args:
        depth: depth of the photometric model, I^-½·cos^1.5 of the ray's angle, shape [h, w], 0 = invalid.
        tissue: mask of tissue, shape [h, w] bool.
        camera: intrinsics of the grid.

    Returns:
        Depth of the same shape and kind, smooth wherever it is valid; tissue keeps its median. Instruments lie on that
        surface, too, as the brightness of metal doesn't determine its place. With too little tissue depth is unchanged.
    """
    lit = depth > 0
    valid = tissue & lit
    # Six pixels are left out at the border of tissue, where shadows and other colours lie.
    kept = cv2.erode(valid.astype(np.uint8), np.ones((13, 13), np.uint8), borderValue=1) > 0
    kept = valid if kept.sum() < 200 else kept
    if kept.sum() < 200:
        return depth
    rays = back_project(np.ones_like(depth), camera)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    brightness = 3 * np.log(rays[..., 2]) - 2 * np.log(np.where(valid, depth, 1.0))
    # One pixel in five is enough for the plane.
    rows, columns = (at[::5] for at in np.nonzero(kept))
    normal = _plane_normal(rays[rows, columns], brightness[rows, columns])
    facing = np.maximum(rays @ normal, GRAZING)
    left = brightness - 3 * np.log(facing)
    left = np.where(kept, np.clip(left - np.median(left[kept]), -1, 1), 0.0)
    # Standard deviation of the Gaussian that keeps an organ's curvature, as a share of the grid's width.
    total, weight = (_gaussian_sum(part.astype(np.float32), 0.4 * depth.shape[1]) for part in (left, kept))
    shape = rays[..., 2] / facing * np.exp(-0.5 * total / np.maximum(weight, 1e-3))
    return np.where(lit, shape * np.median(depth[valid] / shape[valid]), 0).astype(np.float32)


def _plane_normal(rays: np.ndarray, brightness: np.ndarray) -> np.ndarray:
    """Unit normal, away from the camera, of the plane whose brightness fits best.

    Args:
        rays: unit vectors, shape [N, 3].
        brightness: log I up to a constant, shape [N].
    """
    tangents = np.zeros(2)
    for _ in range(8):
        normal = np.append(tangents, 1.0)
        facing = np.maximum(rays @ normal, GRAZING)
        squared = normal @ normal
        left = brightness - 3 * np.log(facing) + 1.5 * np.log(squared)
        left -= np.median(left)
        spread = median_sd(left) + 1e-6
        # Texture is correlated over wide areas: a picture holds 50 independent observations of deviations from a plane.
        # Standard deviation of a plane's tangents before anything is known of it.
        prior = spread**2 / (50 * 0.35**2)
        # Scale of Cauchy's weights, in standard deviations of what the plane leaves.
        weights = 1 / (1 + (left / (5.0 * spread)) ** 2)
        slopes = 3 * (rays[:, :2] / facing[:, None] - tangents / squared)
        slopes -= weights @ slopes / weights.sum()
        information = (slopes * weights[:, None]).T @ slopes / len(rays) + prior * np.eye(2)
        step = (slopes * weights[:, None]).T @ left / len(rays) - prior * tangents
        tangents = np.clip(tangents + np.linalg.solve(information, step), -3.0, 3.0)
    normal = np.append(tangents, 1.0)
    return normal / np.linalg.norm(normal)


def _gaussian_sum(values: np.ndarray, scale: float) -> np.ndarray:
    """Sum weighted by a Gaussian of an image that is 0 around, shape [h, w] float32.

    Args:
        values: shape [h, w] float32.
        scale: standard deviation of the weights [grid pixels].
    """
    # A sum that is so wide has no detail: a quarter of the pixels along each axis tell it.
    if scale < 12.0:
        return cv2.GaussianBlur(values, (0, 0), scale, borderType=cv2.BORDER_CONSTANT)
    height, width = values.shape
    small = cv2.resize(values, (-(-width // 4), -(-height // 4)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), scale / 4, borderType=cv2.BORDER_CONSTANT)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
