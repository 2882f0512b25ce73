"""What a moving camera does to points on uneven tissue, learnt over a clip's first frames.

Beyond a smooth function of place, the points of a rigid scene move in three ways, one for each direction of the camera,
and every point by its own share of each, which stays the same (Tomasi and Kanade 1992, of a camera without
perspective). The shares are learnt; how much of each way a later frame shows is told by points far from the instrument.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import block_diag, coo_array, csc_array, diags_array, identity, kron
from scipy.sparse.linalg import splu

from data.tracks.background import far_points
from data.tracks.holding import AFFINE, background_terms

WAYS = 3
"""In which points move beyond a quadratic function of their place."""
ALIKE = 1.0
"""Weight of how much neighbours' shares differ, squared, over that of a squared pixel."""
ROUNDS = 4
"""Of learning shares and ways in turn."""
WEIGHED = 6
"""Rounds of weighting points anew: a point counts less the more pixels it is off."""
CURVED = 0.3
"""The quadratic part is held back as if this share of the far points said that there is none: it grows from there
towards the instrument."""
TINY = 1e-6
"""Added to products, so that what nothing tells is zero."""


def camera_motion(points: np.ndarray, spacing: int, moved: np.ndarray, distance: np.ndarray, learnt: int) -> np.ndarray:
    """Displacement of all points by the camera's motion alone, shape [T, N, 2] [px].

    Of frames after those that are learnt from, only the points farthest from the instrument are looked at.

    Args:
        points: places at rest on a square grid, shape [N, 2] (column, row) [px].
        spacing: of the grid [px].
        moved: displacements, shape [T, N, 2] [px]; not a number where a point is lost.
        distance: from the instrument at rest, shape [N] [px].
        learnt: number of the first frames, which tell every point's shares.
    """
    known = np.asarray(np.isfinite(moved).all(axis=2))
    motion = np.nan_to_num(moved).astype(np.float64)
    far = np.array([far_points(frame, distance) for frame in moved]).reshape(known.shape)
    terms, springs = background_terms(points, camera=True), _differences(points, spacing)
    early, seen = motion[:learnt], far[:learnt]
    shares = np.zeros((len(points), 2, 0))
    smooth, _ = _by_far_points(terms, shares, early, seen)
    count = min(WAYS, len(early) - 1)
    if count > 0 and seen.any():
        left = np.where(seen[..., None], early - smooth, 0).reshape(len(early), -1)
        found, sizes, _ = np.linalg.svd(left, full_matrices=False)
        ways = found[:, :count] * sizes[:count] / np.sqrt(max(seen.sum() / len(early), 1))
        weights = known[:learnt].astype(np.float64)
        for _ in range(ROUNDS):
            shares = _shares(early - smooth, weights, ways, springs)
            shares /= np.maximum(np.sqrt(np.square(shares[seen.any(axis=0)]).mean(axis=(0, 1))), TINY)
            smooth, ways = _by_far_points(terms, shares, early, seen)
            off = np.linalg.norm(early - smooth - _along(ways, shares), axis=2)
            weights = known[:learnt] / np.hypot(1.0, off)
    smooth, ways = _by_far_points(terms, shares, motion, far)
    return smooth + _along(ways, shares)


def _along(ways: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Motion [T, N, 2] of points with shares [N, 2, K] along ways [T, K]."""
    return np.einsum("tk,nck->tnc", ways, shares)


def _by_far_points(
    terms: np.ndarray, shares: np.ndarray, motion: np.ndarray, far: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The smooth part of the camera's motion at all points [T, N, 2] and its ways [T, K], of frames [T, N, 2].

    By least distances beyond a pixel of the far points, [T, N].
    """
    each, count = terms.shape[1], shares.shape[2]
    along = [np.stack([terms, 0 * terms], axis=1), np.stack([0 * terms, terms], axis=1)]
    design = np.concatenate([shares, *along], axis=2)
    curved = np.r_[np.zeros(count), np.tile(np.arange(each) >= AFFINE, 2)]
    smooth, ways = np.zeros_like(motion), np.zeros((len(motion), count))
    for index, (frame, used) in enumerate(zip(motion, far, strict=True)):
        rows, seen, found = design[used].reshape(-1, design.shape[2]), frame[used].ravel(), np.zeros(design.shape[2])
        weights, held = np.ones(len(seen) // 2), np.diag(TINY + CURVED * used.sum() * curved)
        for _ in range(WEIGHED):
            weighted = rows.T * np.repeat(weights, 2)
            found = np.linalg.solve(weighted @ rows + held, weighted @ seen)
            weights = 1 / np.hypot(1, np.linalg.norm((seen - rows @ found).reshape(-1, 2), axis=1))
        ways[index], smooth[index] = found[:count], terms @ found[count:].reshape(2, each).T
    return smooth, ways


def _shares(left: np.ndarray, weights: np.ndarray, ways: np.ndarray, differences: csc_array) -> np.ndarray:
    """Every point's shares [N, 2, K] of ways [T, K] by what is left of its motion [T, N, 2], with weights [T, N]."""
    points, count = weights.shape[1], ways.shape[1]
    products = np.einsum("tn,tk,tl->nkl", weights, ways, ways)
    matrix = block_diag(list(products), format="csc") + kron(ALIKE * differences, identity(count), format="csc")
    solved = splu((matrix + TINY * identity(points * count)).tocsc())
    given = np.einsum("tn,tnc,tk->cnk", weights, left, ways)
    return np.stack([solved.solve(axis.ravel()).reshape(points, count) for axis in given], axis=1)


def _differences(points: np.ndarray, spacing: int) -> csc_array:
    """Matrix [N, N] of the summed squared differences between neighbours on the grid."""
    cells = {tuple(cell): index for index, cell in enumerate(np.rint(points / spacing).astype(int).tolist())}
    pairs = [
        (index, cells[other])
        for (column, row), index in cells.items()
        for other in ((column + 1, row), (column, row + 1))
        if other in cells
    ]
    one, two = np.array(pairs, int).reshape(-1, 2).T
    ends = np.concatenate([one, two]), np.concatenate([two, one])
    ties = coo_array((np.ones(2 * len(one)), ends), shape=(len(points), len(points)))
    return (diags_array(ties.sum(axis=0)) - ties).tocsc()
