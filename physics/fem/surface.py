"""Places on a surface of triangles that are closest to points."""

import numpy as np
from scipy.spatial import KDTree

from palpate.physics.mesh import crosses


def closest(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Barycentric coordinates of the place of a triangle that is closest to a point (Ericson 2005, section 5.1.5).

    Args:
        points: shape [..., 3].
        triangles: corners, shape [..., 3, 3]; not flat.

    Returns:
        shape [..., 3].
    """
    import trimesh  # takes a second

    corners = triangles.reshape(-1, 3, 3)
    spread = np.broadcast_to(points, (*triangles.shape[:-2], 3)).reshape(-1, 3)
    sizes = np.ptp(corners, axis=1).max(axis=1)[:, None]  # to trimesh 1e-14 is nothing, whatever the unit
    corners = corners / sizes[..., None]
    places = trimesh.triangles.closest_point(corners, spread / sizes)
    return trimesh.triangles.points_to_barycentric(corners, places, method="cross").reshape(triangles.shape[:-1])


def even_shares(rows: int) -> np.ndarray:
    """Barycentric coordinates of places that are spread evenly over a triangle in rows, shape [S, 3]."""
    places = [[i + 1 / 3, j + 1 / 3, rows - i - j - 2 / 3] for i in range(rows) for j in range(rows - i)]
    return np.array(places) / rows


def rows_needed(triangles: np.ndarray, spacing: float) -> int:
    """Rows of samples, as `nearest` takes them, that lie at most half a spacing apart on triangles [F, 3, 3]."""
    return int(np.clip(np.ceil(2 * np.sqrt(areas(triangles).max()) / spacing), 1, 24))


def areas(triangles: np.ndarray) -> np.ndarray:
    """Return the areas of triangles [F, 3, 3], shape [F]."""
    return np.linalg.norm(crosses(triangles), axis=1) / 2


def nearest(points: np.ndarray, triangles: np.ndarray, samples: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Triangle closest to each point, shape [P], and where on it, as barycentric coordinates [P, 3].

    Args:
        points: shape [P, 3].
        triangles: corners, shape [F, 3, 3].
        samples: rows of samples on each triangle, at whose closest ones is looked: 1 = the centre, which does where
            triangles are of similar size.
    """
    rows = even_shares(samples)
    seeds = np.einsum("sk,fkx->fsx", rows, triangles).reshape(-1, 3)
    count = min(16, len(seeds))
    _, near = KDTree(seeds).query(points, k=count)
    near = near.reshape(len(points), count) // len(rows)
    shares = closest(points[:, None], triangles[near])
    places = np.einsum("pck,pckx->pcx", shares, triangles[near])
    best = np.square(points[:, None] - places).sum(-1).argmin(axis=1)
    index = np.arange(len(points))
    return near[index, best], shares[index, best]
