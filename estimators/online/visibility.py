"""Which particles of a sheet the camera sees: they face it as they did at rest, and no other tissue covers them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

_TOUCHING = 1e-6
"""Share of a depth by which tissue lies before a particle, or of a triangle beside it: less is rounding."""


def facing(points: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Particles of a triangle whose side towards the camera is that of rest, shape [N], bool.

    Args:
        points: positions, shape [N, 3], of a camera at the origin that looks along z [scene units].
        rest: positions at rest, where all of the sheet is seen, shape [N, 3].
        faces: triangles, shape [F, 3].
    """
    same = np.linalg.det(points[faces]) * np.linalg.det(rest[faces]) > 0  # of corners: which side the origin is on
    return np.isin(np.arange(len(points)), faces[same])


def uncovered(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Particles before the camera with no triangle on their line of sight, shape [N], bool; arguments as in `facing`.

    x = Σ wᵢ xᵢ by a triangle's corners: its line of sight meets it if no wᵢ is negative, nearer than x if Σ wᵢ > 1.
    """
    before = points[:, 2] > 0
    used = faces[before[faces].all(axis=1)]
    found = np.flatnonzero(before)
    if len(used) == 0 or len(found) == 0:
        return before
    across = points[:, :2] / np.where(before, points[:, 2], 1.0)[:, None]
    middle = across[used].mean(axis=1)
    reach = np.linalg.norm(across[used] - middle[:, None], axis=2).max()
    near = KDTree(middle).query_ball_point(across[found], reach * (1 + _TOUCHING))
    particle, face = np.repeat(found, [len(each) for each in near]), np.concatenate(near).astype(np.int64)
    other = (used[face] != particle[:, None]).all(axis=1)
    particle, corners = particle[other], points[used[face[other]]].transpose(0, 2, 1)
    sized = np.abs(np.linalg.det(corners)) > 0  # one that is seen from its edge hides nothing
    particle, corners = particle[sized], corners[sized]
    shares = np.linalg.solve(corners, points[particle][..., None])[..., 0]
    hidden = (shares.min(axis=1) > _TOUCHING) & (shares.sum(axis=1) > 1 + _TOUCHING)
    before[particle[hidden]] = False
    return before
