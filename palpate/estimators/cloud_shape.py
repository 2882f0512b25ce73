"""The surface that a cloud of tissue shows, over the plane across the line of sight."""

import numpy as np
from scipy.spatial import KDTree

from palpate.data.source.layout import InputError
from palpate.physics.mesh import Mesh, grid_mesh


def view_across(cloud: np.ndarray, eye: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """Return the pose of a cloud's frame for an eye along its mean normal, shape [4, 4], the same in whatever frame it
    is.

    Args:
        cloud: shape [m, 3] [m].
        eye: that looks from the same side, shape [3] [m].
        tip: which lies to the right, shape [3] [m].
    """
    middle = cloud.mean(axis=0)
    axes = np.linalg.svd(cloud - middle, full_matrices=False)[2]
    axes[2] *= -1.0 if axes[2] @ (eye - middle) > 0 else 1.0  # the third leads away from the eye
    axes[0] *= -1.0 if axes[0] @ (tip - middle) < 0 else 1.0
    axes[1] *= np.sign(np.linalg.det(axes))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ middle
    # From which tissue is looked at, over its size.
    pose[2, 3] += 10.0 * float(np.ptp(cloud @ axes.T, axis=0).max())
    return pose


class CloudShape:
    """Heights over a plane, of a cloud that is looked at along z.

    Args:
        cloud: shape [m, 3] [m].
        what: its file, for messages.

    Raises:
        InputError: there are too few points; so does `mesh`, and where some lie far off.
    """

    neighbours = 16
    """Points of a cloud that tell the height of a place."""

    def __init__(self, cloud: np.ndarray, what: str) -> None:
        text = f"{what} has too few points for a surface, or some far off; give a denser cloud of tissue alone."
        self._cloud, self._sparse = cloud, InputError(text)
        if len(cloud) < self.neighbours:
            raise self._sparse
        self._tree = KDTree(cloud[:, :2])
        # One must be so near, by their usual distance.
        self._apart = max(4.0 * float(np.median(self._tree.query(cloud[:, :2], 2)[0][:, 1])), 1e-9)
        self.area = len(np.unique(np.floor(cloud[:, :2] / self._apart), axis=0)) * self._apart**2
        """Area of the cloud across the line of sight [m²]."""

    def heights(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights along z at places [..., 2] [m], shape [...] [m], and whether the cloud covers them, bool."""
        away, near = self._tree.query(places, self.neighbours)
        middle = self._cloud[near, :2].mean(axis=-2)
        # How far the middle of these is away, over their mean distance, where a place lies outside of the cloud.
        beside = np.linalg.norm(middle - places, axis=-1) > 0.75 * away.mean(axis=-1)
        heights = np.average(self._cloud[near, 2], axis=-1, weights=1 / (away**2 + self._apart**2))
        return heights, (away[..., 0] <= self._apart) & ~beside

    def mesh(self, wide: float) -> Mesh:
        """Return a grid's triangles over what is covered, its places so far apart [m]."""
        low, high = self._tree.mins, self._tree.maxes
        counts = np.maximum(np.round((high - low) / wide), 1).astype(int) + 1
        # Area of a grid over that of the cloud on it.
        if counts.prod() * wide**2 > 20 * self.area:
            raise self._sparse
        across = [np.linspace(*ends) for ends in zip(low, high, counts, strict=True)]
        nodes = np.stack(np.meshgrid(*across), axis=-1)
        heights, covered = self.heights(nodes)
        # Longest edge of a triangle, over the distance of vertices across the line of sight.
        mesh = grid_mesh(np.dstack([nodes, heights]), covered, max_edge=3.0 * wide, alternating=True)
        if len(mesh.vertices) < 3:
            raise self._sparse
        return mesh
