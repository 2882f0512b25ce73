"""Neighbours' errors are correlated: a transform after which they are independent.

Every point is predicted from neighbours before it, and what is left is divided by its standard deviation (Vecchia 1988,
Estimation and model identification for continuous spatial processes): the inverse of the covariance's Cholesky factor,
sparse.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from palpate.estimators.model_errors import MODEL_ERRORS

REACH, MEASURED_REACH = MODEL_ERRORS.followed_reach, MODEL_ERRORS.measured_reach
"""Of the correlation between neighbours' errors, Matérn's of 3/2, of points as they are followed, and of those measured
in wide windows where a model tells their motion [px]."""
NEAR, MOST = 42.0, 24
"""Neighbours are nearer [px]; the most of a point. With half as many smooth motion would tell a fifth too much."""


class Whitening:
    """What the frames of n points have in common.

    Args:
        points: shape [n, 2] [px].
        reach: of the correlation between their errors [px].
    """

    def __init__(self, points: np.ndarray, reach: float = REACH) -> None:
        count = len(points)
        # Of all neighbours about half come before a point.
        apart, near = KDTree(points).query(points, k=2 * MOST + 1, distance_upper_bound=NEAR)
        before = near < np.arange(count)[:, None]
        order = np.argsort(np.where(before, apart, np.inf), axis=1)[:, :MOST]
        self._known = np.take_along_axis(before, order, axis=1)
        self._near = np.where(self._known, np.take_along_axis(near, order, axis=1), 0)
        places = points[self._near]
        self._to = matern(np.linalg.norm(places - points[:, None], axis=-1) / reach)
        self._between = matern(np.linalg.norm(places[:, :, None] - places[:, None], axis=-1) / reach)

    def transform(self, sizes: np.ndarray) -> csr_array:
        """The transform, shape [n, n]; rows of points that are not visible are zero.

        Two points share what the better one errs by: what spoils the other one is its own.

        Args:
            sizes: standard deviations by axis, shape [n] [px]; not a number where a point is not visible.
        """
        seen = np.isfinite(sizes)
        own = np.square(np.where(seen, sizes, 1.0))
        known = self._known & seen[self._near] & seen[:, None]
        theirs = own[self._near]
        between = np.minimum(theirs[:, :, None], theirs[:, None]) * self._between
        between *= known[:, :, None] & known[:, None]
        own_place = np.arange(between.shape[1])
        between[:, own_place, own_place] = theirs
        to = np.minimum(own[:, None], theirs) * self._to * known
        shares = np.linalg.solve(between, to[..., None])[..., 0]
        left = np.sqrt(own - (shares * to).sum(axis=1))
        here = np.arange(len(sizes))
        rows = np.concatenate([here[seen], np.broadcast_to(here[:, None], known.shape)[known]])
        columns = np.concatenate([here[seen], self._near[known]])
        values = np.concatenate([1 / left[seen], (-shares / left[:, None])[known]])
        return csr_array((values, (rows, columns)), shape=(len(sizes), len(sizes)))


def matern(distance: np.ndarray) -> np.ndarray:
    """Matérn's correlation of smoothness 3/2 at distances over its reach."""
    return (1 + distance) * np.exp(-distance)


def points_as_one(spacing: float, reach: float = REACH) -> float:
    """How many points of a square grid [px] err together: the sum of the correlation over the grid, as its integral."""
    return 6 * np.pi * (reach / spacing) ** 2


def correlated_points(points: np.ndarray, spacing: int, errors: np.ndarray) -> float:
    """How many points on a square grid have the same error, effectively: the sum of its autocorrelation.

    Args:
        points: shape [N, 2] [px].
        spacing: of the grid [px].
        errors: by axis, shape [N, 2] [px]; not a number where a point is lost.
    """
    cells = np.rint(points / spacing).astype(int)
    cells -= cells.min(axis=0)
    shape = tuple(2 * (cells.max(axis=0) + 1))
    known = np.isfinite(errors).all(axis=1)
    fields = np.zeros((3, *shape))
    fields[(0, *cells[known].T)] = 1
    fields[(slice(1, 3), *cells[known].T)] = errors[known].T
    # Of pairs of points, by the way from one to the other there and back: how many, and their errors' products.
    pairs, *products = np.fft.irfft2(np.square(np.abs(np.fft.rfft2(fields))), shape)
    steps = (np.minimum(np.arange(side), side - np.arange(side)) for side in shape)
    rings = np.rint(np.hypot(*np.meshgrid(*steps, indexing="ij"))).astype(int).ravel()
    pairs = pairs.round().ravel()
    correlation = np.where(pairs > 0, sum(products).ravel() / np.maximum(pairs, 1), 0.0)
    correlation /= correlation[0]
    mean = np.bincount(rings, correlation) / np.bincount(rings)
    # Beyond the first ring without correlation there is only chance.
    end = int(np.argmax(mean <= 0)) if (mean <= 0).any() else len(mean)
    return max(float(correlation[rings < end].sum()), 1.0)
