"""How far particles are from what was observed of them: squared distances with gradients.

`slope` of either term of the residual mapping gives its value [m²], its gradient [N, 3] [m], and its second derivatives
by one axis [N, N], the same for all three and none below 0. Once its pairs are fixed a term is quadratic in positions.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree


class Chamfer:
    """Distance to a cloud both ways (Liang 2024, equation 4), as means: the sums' rate of 50 would diverge.

    Where nearest neighbours change, the derivative is that on one side.
    """

    def __init__(self, cloud: np.ndarray, seen: np.ndarray) -> None:
        """Keep what is seen.

        Args:
            cloud: observed points, shape [m, 3] [m].
            seen: particles of the surface that the camera sees, shape [n].

        Raises:
            ValueError: an empty or infinite cloud, or nobody seen.
        """
        if np.ndim(cloud) != 2 or np.shape(cloud)[1:] != (3,) or len(cloud) == 0 or not np.isfinite(cloud).all():
            raise ValueError(f"the cloud has shape {np.shape(cloud)}; give finite points, [m, 3], one at least.")
        if len(seen) == 0:
            raise ValueError("no particle is seen, so there is nothing to match with the cloud.")
        self.cloud, self.seen = np.asarray(cloud, np.float64), np.asarray(seen, np.int64)
        self._tree = KDTree(self.cloud)

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """Value, gradient and second derivatives.

        Raises:
            ValueError: a position that is not finite.
        """
        shown = points[self.seen]
        if not np.isfinite(shown).all():
            raise ValueError("a point to match is not finite: what is simulated has diverged.")
        out, there = self._tree.query(shown)
        back, here = KDTree(shown).query(self.cloud)
        own, others = len(shown), len(self.cloud)
        counts = np.bincount(here, minlength=own)
        drawn = np.stack([np.bincount(here, axis, minlength=own) for axis in self.cloud.T], axis=1)
        gradient, weight = np.zeros_like(points), np.zeros(len(points))
        gradient[self.seen] = 2 * (shown - self.cloud[there]) / own + 2 * (counts[:, None] * shown - drawn) / others
        weight[self.seen] = 2 / own + 2 * counts / others
        curved = csr_array((weight, np.arange(len(points)), np.arange(len(points) + 1)))
        return float(np.square(out).mean() + np.square(back).mean()), gradient, curved


class Tracks:
    """Mean squared distance between followed points and where they are on the mesh."""

    def __init__(self, places: csr_array, observed: np.ndarray) -> None:
        """Leave out what isn't seen.

        Args:
            places: shares of the particles in every point's position, shape [P, N], rows adding up to 1.
            observed: where the points are, shape [P, 3] [m]; not seen = NaN.

        Raises:
            ValueError: shapes that don't fit, nothing seen.
        """
        if np.shape(observed) != (places.shape[0], 3):
            raise ValueError(f"observed has shape {np.shape(observed)}; give {(places.shape[0], 3)}.")
        seen = np.isfinite(observed).all(axis=1)
        if not seen.any():
            raise ValueError("none of the followed points is seen.")
        self.places, self.observed = places[np.flatnonzero(seen)], np.asarray(observed, np.float64)[seen]
        self._curved = (2 / len(self.observed) * (self.places.T @ self.places)).tocsr()

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """Value, gradient and second derivatives."""
        apart = self.places @ points - self.observed
        count = len(apart)
        return float((apart * apart).sum() / count), 2 / count * (self.places.T @ apart), self._curved


Match = Chamfer | Tracks
