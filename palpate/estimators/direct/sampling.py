"""Mean and covariance of a posterior in a box, by importance sampling around its known modes.

A normal distribution at the optimum (Laplace) is wrong where the posterior is a curved ridge, has several modes, or is
cut off. Points are drawn from a mixture of Student distributions and weighed by posterior over the mixture of all
rounds (Owen & Zhou 2000). The mixture is then moved to where the weights are (population Monte Carlo, Cappé et al.
2008). Points come from a Sobol sequence, so nothing is random.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv, gammaln, logsumexp, ndtri

FREEDOM = 5.0
"""Degrees of freedom of the mixture's Student distributions: tails heavier than the posterior's."""
ROUND = 64
"""Points of a round; a power of two, as Sobol points want."""
ENOUGH = 100.0
"""Effective draws after which no further round is made: a mean is then within a tenth of a standard deviation."""
ROUNDS = (2, 8)
"""Fewest and most rounds: the first one's mixture is a guess."""


@dataclass(frozen=True)
class Mixture:
    """Student distributions of FREEDOM degrees in D dimensions; K components."""

    shares: np.ndarray
    """Shape [K], sum 1."""
    means: np.ndarray
    """Shape [K, D]."""
    scales: np.ndarray
    """Scale matrices (the covariance is FREEDOM/(FREEDOM - 2) times as large), shape [K, D, D]."""

    def draw(self, points: np.ndarray) -> np.ndarray:
        """Return points of the mixture, shape [n, D], for points of the unit cube, shape [n, D + 2]."""
        component = np.searchsorted(np.cumsum(self.shares)[:-1], points[:, 0], side="right")
        radial = FREEDOM / (2 * gammaincinv(FREEDOM / 2, points[:, 1]))  # freedom over a chi-square variable
        normal = ndtri(points[:, 2:]) * np.sqrt(radial)[:, None]
        return self.means[component] + np.einsum("nij,nj->ni", np.linalg.cholesky(self.scales)[component], normal)

    def log_densities(self, points: np.ndarray) -> np.ndarray:
        """Log of share times density of every component at points [n, D], shape [n, K]."""
        size = points.shape[1]
        factors = np.linalg.cholesky(self.scales)
        apart = np.linalg.solve(factors, np.swapaxes(points - self.means[:, None], 1, 2))
        squares = np.square(apart).sum(axis=1).T
        log_volume = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        constant = gammaln((FREEDOM + size) / 2) - gammaln(FREEDOM / 2) - size / 2 * math.log(FREEDOM * math.pi)
        with np.errstate(divide="ignore"):
            shares = np.log(self.shares)
        return shares + constant - log_volume - (FREEDOM + size) / 2 * np.log1p(squares / FREEDOM)

    def moved(self, points: np.ndarray, weights: np.ndarray) -> Mixture:
        """Return the mixture after one step towards a weighted sample [n, D], [n]; the weights sum to 1."""
        parts = self.log_densities(points)
        parts = weights[:, None] * np.exp(parts - logsumexp(parts, axis=1, keepdims=True))
        shares = parts.sum(axis=0)
        used = shares > 1e-3
        parts, shares = parts[:, used] / shares[used], shares[used] / shares[used].sum()
        means = parts.T @ points
        apart = points[:, None] - means
        spreads = np.einsum("nk,nki,nkj->kij", parts, apart, apart)
        # Moved components are this much wider than the draws that they follow, in standard deviations.
        shape = 1.2**2 * (FREEDOM - 2) / FREEDOM
        # A tenth of a component's former covariance stays, so that few draws don't make it flat.
        return Mixture(shares, means, 0.9 * shape * spreads + 0.1 * self.scales[used])


@dataclass(frozen=True)
class Draws:
    """A weighted sample of a posterior; N points."""

    points: np.ndarray
    """Shape [N, D]."""
    weights: np.ndarray
    """Shape [N], sum 1."""

    @property
    def effective(self) -> float:
        """Number of equally weighted draws that would be as good (Kish)."""
        return 1 / float(np.square(self.weights).sum())

    @property
    def mean(self) -> np.ndarray:
        """Shape [D]."""
        return self.weights @ self.points

    @property
    def covariance(self) -> np.ndarray:
        """Shape [D, D]."""
        apart = self.points - self.mean
        return np.einsum("n,ni,nj->ij", self.weights, apart, apart)

    def thinned(self, count: int) -> np.ndarray:
        """Return `count` equally weighted points [count, D], evenly spread along the sample's widest direction."""
        order = np.argsort(self.points @ np.linalg.eigh(self.covariance)[1][:, -1])
        chosen = np.searchsorted(np.cumsum(self.weights[order]), (np.arange(count) + 0.5) / count)
        return self.points[order[np.minimum(chosen, len(order) - 1)]]


def sample_posterior(log_likelihood: Callable[[np.ndarray], np.ndarray], box: np.ndarray, start: Mixture) -> Draws:
    """Return weighted draws from a likelihood times a uniform prior; the caller judges whether enough of them count.

    Args:
        log_likelihood: of points inside the box, shapes [n, D] to [n], up to a constant.
        box: lower and upper ends, shape [2, D].
        start: where the first points are drawn: around the modes.
    """
    from scipy.stats.qmc import Sobol  # takes seconds to load

    low, high = box
    sequence = Sobol(box.shape[1] + 2, rng=1)
    points, values, mixtures = np.empty((0, box.shape[1])), np.empty(0), [start]
    while True:
        found = mixtures[-1].draw(np.clip(sequence.random(ROUND), 1e-9, 1 - 1e-9))
        found = found[((found >= low) & (found <= high)).all(axis=1)]
        points, values = np.concatenate((points, found)), np.concatenate((values, log_likelihood(found)))
        densities = [logsumexp(mixture.log_densities(points), axis=1) for mixture in mixtures]
        logs = values - logsumexp(densities, axis=0)
        weights = np.exp(logs - logs.max())
        draws = Draws(points, weights / weights.sum())
        rounds = len(mixtures)
        if rounds >= ROUNDS[1] or (rounds >= ROUNDS[0] and draws.effective >= ENOUGH):
            return draws
        mixtures.append(mixtures[-1].moved(draws.points, _flattened(draws.weights)))


def _flattened(weights: np.ndarray) -> np.ndarray:
    """Return weights [N] to the largest power up to 1 that makes 40 of them count, or to the smallest one tried.

    Where fewer count, a flattened posterior guides the mixture. Bounded errors cut jagged pieces out of a posterior,
    and a mixture that jumps to the first piece found misses the others.
    """
    for power in 0.75 ** np.arange(12):
        flat = weights**power / (weights**power).sum()
        if 1 / np.square(flat).sum() >= 40.0:
            break
    return flat
