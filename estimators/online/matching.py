"""How far particles are from what was seen of them: squared distances with gradients, both kinds behind one face."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from palpate.estimators.online.nearest import gathered, grid_of


class Match(Protocol):
    """A term of the residual mapping; once its pairs are fixed it is quadratic in the positions."""

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """Value [m²], gradient [N, 3] [m], and second derivatives of one axis [N, N], alike for all three, none < 0."""
        ...


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
        self._grid = grid_of(self.cloud)

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray, csr_array]:
        """As `Match` says."""
        shown = points[self.seen]
        out, there = self._grid.nearest(shown)
        cloud = self._grid.points  # in an order that keeps neighbours together, which is faster
        back, here = grid_of(shown).nearest(cloud)
        own, others = len(shown), len(cloud)
        counts, drawn = gathered(cloud, here, own)
        gradient, weight = np.zeros_like(points), np.zeros(len(points))
        gradient[self.seen] = 2 * (shown - self.cloud[there]) / own + 2 * (counts[:, None] * shown - drawn) / others
        weight[self.seen] = 2 / own + 2 * counts / others
        curved = csr_array((weight, np.arange(len(points)), np.arange(len(points) + 1)))
        return float(out.mean() + back.mean()), gradient, curved


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
        """As `Match` says."""
        apart = self.places @ points - self.observed
        count = len(apart)
        return float((apart * apart).sum() / count), 2 / count * (self.places.T @ apart), self._curved
