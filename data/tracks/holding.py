"""Where tissue is held, told by motion alone where no mask shows an instrument: the piece that moves most."""

from __future__ import annotations

import cv2
import numpy as np

SMOOTH = 1.5
"""Standard deviation of the filter over the points' motion [grid spacings]."""
PEAK = 98.0
"""Percentile of the filtered motion that counts as the most [%]."""
NEAREST = 0.05
"""Residuals below this weigh alike in the background's motion [px]."""
ROUNDS = 30
"""Of weighting the points anew."""


def held_distance(points: np.ndarray, spacing: int, moved: np.ndarray, share: float) -> np.ndarray:
    """Distance of every point from where tissue is held, shape [N] [px]: 0 there, infinite where nothing moves.

    That is the connected piece of the grid which holds the most motion of those that move by a share of the largest
    motion, against the background (`background_motion`).

    Args:
        points: places at rest on a grid, shape [N, 2] (column, row) [px].
        spacing: of the grid [px].
        moved: displacements, shape [N, 2] [px]; not a number where a point is lost.
        share: between 0 and 1.
    """
    cells = np.rint(points / spacing).astype(int)
    shape = tuple(cells.max(axis=0)[::-1] + 1) if len(cells) else (1, 1)
    columns, rows = cells.T
    known = np.isfinite(moved).all(axis=1)
    grid = np.zeros((*shape, 2), np.float32)
    length = np.linalg.norm(np.nan_to_num(moved - background_motion(points, moved)), axis=1)
    grid[rows, columns, 0], grid[rows, columns, 1] = length, known
    filtered = cv2.GaussianBlur(grid, (0, 0), SMOOTH)
    motion = np.where(grid[..., 1] > 0, filtered[..., 0] / np.maximum(filtered[..., 1], 1e-6), 0)
    seen = motion[rows, columns][known]
    if not len(seen) or np.percentile(seen, PEAK) <= 0:
        return np.full(len(points), np.inf)
    above = (motion > share * np.percentile(seen, PEAK)).astype(np.uint8)
    _, labels = cv2.connectedComponents(above)
    sums = np.bincount(labels.ravel(), (motion * above).ravel())
    held = labels == np.argmax(sums)
    away = cv2.distanceTransform((~held).astype(np.uint8), cv2.DIST_L2, 5)
    return spacing * away[rows, columns].astype(np.float64)


def background_motion(points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Affine motion of most points, shape [N, 2] [px], by least distances: what moves otherwise counts little.

    Iteratively reweighted (Weiszfeld 1937).

    Args:
        points: places at rest, shape [N, 2] [px].
        moved: displacements, shape [N, 2] [px]; not a number where a point is lost.
    """
    known = np.isfinite(moved).all(axis=1)
    terms = np.column_stack([points, np.ones(len(points))]).astype(np.float64)
    if known.sum() < terms.shape[1]:
        return np.zeros_like(terms[:, :2])
    weights = np.ones(int(known.sum()))
    found = np.zeros((terms.shape[1], 2))
    for _ in range(ROUNDS):
        root = np.sqrt(weights)[:, None]
        found = np.linalg.lstsq(root * terms[known], root * moved[known], rcond=None)[0]
        off = np.linalg.norm(moved[known] - terms[known] @ found, axis=1)
        weights = 1 / np.maximum(off, NEAREST)
    return terms @ found
