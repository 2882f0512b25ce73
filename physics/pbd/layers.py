"""A sheet of triangles as a volume: its particles again in layers below, three tetrahedra in every prism."""

from __future__ import annotations

import numpy as np


def layered(upper: np.ndarray, faces: np.ndarray, below: np.ndarray, layers: int) -> tuple[np.ndarray, np.ndarray]:
    """Particles and tetrahedra under a surface of n particles.

    Args:
        upper: the surface's, shape [n, 3] [m].
        faces: its triangles, anticlockwise seen from above, shape [F, 3].
        below: from each particle to the one under it in the lowest layer, shape [n, 3] [m].
        layers: the surface and those below, 2 at least.

    Returns:
        Positions layer after layer, the surface's first, shape [layers·n, 3]; corners of the tetrahedra, shape [V, 4],
        3·F·(layers - 1) of them but where a prism would turn over, as below a step of the surface that leans over, or
        where layers below a bend cross each other: there are none. The volumes of a prism's three add up to a
        positive one.
    """
    rest = (upper + np.linspace(0, 1, layers)[:, None, None] * below).reshape(-1, 3)
    ordered = np.sort(faces, axis=1)  # the same for all: prisms side by side share the diagonals of their sides
    (one, two, three), lower = ordered.T, ordered.T + len(upper)
    prisms = np.stack([(one, two, three, lower[2]), (one, two, lower[2], lower[1]), (one, *lower)]).transpose(2, 0, 1)
    upright = (_normals(upper[ordered]) * _normals(upper[faces])).sum(axis=1) > 0
    prisms[upright] = prisms[upright][..., [1, 0, 2, 3]]
    tetrahedra = len(upper) * np.arange(layers - 1)[:, None, None, None] + prisms
    volumes = np.linalg.det(rest[tetrahedra[..., 1:]] - rest[tetrahedra[..., :1]]).sum(axis=2)
    return rest, tetrahedra[:, (volumes > 0).all(axis=0)].reshape(-1, 4)


def _normals(corners: np.ndarray) -> np.ndarray:
    """Of triangles [F, 3, 3], towards where they are anticlockwise, shape [F, 3]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
