"""Which piece of the picture an instrument and the tissue in it are, by motion alone where no mask shows one."""

from __future__ import annotations

import cv2
import numpy as np

SMOOTH = 1.5
"""Standard deviation of the filter over the points' motion [grid spacings]."""
NEAREST = 0.05
"""Residuals below this weigh alike in a fit by least distances [px]."""
ROUNDS = 30
"""Of weighting the points anew."""
AFFINE = 3
"""Terms of an affine motion, the first ones of a quadratic."""
TINY = 1e-9
"""Added to the terms' products, so that points that don't tell a term leave it at zero."""


def held_distance(points: np.ndarray, spacing: int, own: np.ndarray, place: np.ndarray, share: float) -> np.ndarray:
    """Distance of every point from the piece that is held, shape [N] [px]: 0 in it, infinite where it doesn't move.

    That is the connected piece of the grid around a place which moves with it: by a share of its motion, along it.

    Args:
        points: places at rest on a grid, shape [N, 2] (column, row) [px].
        spacing: of the grid [px].
        own: displacements without the background's, shape [N, 2] [px]; not a number where a point is lost.
        place: of tissue that is held, shape [2] [px].
        share: between 0 and 1.
    """
    cells = np.rint(points / spacing).astype(int)
    shape = tuple(cells.max(axis=0)[::-1] + 1) if len(cells) else (1, 1)
    columns, rows = cells.T
    grid = np.zeros((*shape, 3), np.float32)
    grid[rows, columns, :2], grid[rows, columns, 2] = np.nan_to_num(own), np.isfinite(own).all(axis=1)
    filtered = cv2.GaussianBlur(grid, (0, 0), SMOOTH)
    motion = np.where(grid[..., 2:] > 0, filtered[..., :2] / np.maximum(filtered[..., 2:], 1e-6), 0)
    if not grid[..., 2].any():
        return np.full(len(points), np.inf)
    seen = np.argwhere(grid[..., 2] > 0)
    row, column = seen[np.argmin(np.linalg.norm(seen - place[::-1] / spacing, axis=1))]
    most = motion[row, column]
    if not most.any():
        return np.full(len(points), np.inf)
    _, labels = cv2.connectedComponents((motion @ most >= share * most @ most).astype(np.uint8))
    held = labels == labels[row, column]
    away = cv2.distanceTransform((~held).astype(np.uint8), cv2.DIST_L2, 5)
    return spacing * away[rows, columns].astype(np.float64)


def background_terms(points: np.ndarray, camera: bool) -> np.ndarray:
    """Of an affine motion, shape [N, 3], or of a quadratic one, [N, 6]: a moving camera over curved tissue.

    Every one of about unit size; points [N, 2] [px].
    """
    column, row = ((points - points.mean(axis=0)) / np.maximum(points.std(axis=0), 1)).T.astype(np.float64)
    curved = (column**2, column * row, row**2) if camera else ()
    return np.column_stack([np.ones(len(points)), column, row, *curved])


def least_distances(terms: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Coefficients of a motion's terms, shape [K, 2], by least distances: what moves otherwise counts little.

    Iteratively reweighted (Weiszfeld 1937).

    Args:
        terms: shape [N, K].
        moved: displacements, shape [N, 2] [px], all known.
    """
    weights, found = np.ones(len(terms)), np.zeros((terms.shape[1], 2))
    for _ in range(ROUNDS):
        weighted = terms.T * weights
        found = np.linalg.solve(weighted @ terms + TINY * np.eye(len(found)), weighted @ moved)
        weights = 1 / np.maximum(np.linalg.norm(moved - terms @ found, axis=1), NEAREST)
    return found
