"""Force–depth curves of many probes on one piece of tissue, and what a probe elsewhere on it will feel.

Scores of the curves' first two principal components (uncentred, so that the first is the region's curve) vary over the
surface as Gaussian processes with a Matérn kernel of smoothness 3/2 (Rasmussen & Williams 2006, section 4.2.1), whose
length and noise are those of greatest marginal likelihood (section 5.4.1). Intervals are as wide as leaving out each
probe in turn (section 5.4.2) says they must be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.distance import cdist

from palpate.estimators.palpation.curves import Probe

DEPTHS = 10
"""At which curves are compared, evenly down to the median probe's largest."""
COMPONENTS = 2
LEAST_PROBES = 5
MOST_FOR_LENGTH = 300
"""Probes among which length and noise are looked for, spread evenly over the table: enough to tell them."""
LEVEL = 0.9
"""Of the intervals."""


@dataclass(frozen=True, eq=False)
class _Field:
    """A score over the surface: posterior of a Gaussian process given P probes."""

    places: np.ndarray
    length: float
    size: float
    """Variance of the process."""
    factor: tuple[np.ndarray, bool]
    """Cholesky's, of the kernel with the noise, over `size`."""
    mean: float
    weights: np.ndarray
    noise: float
    """Variance of a probe's own deviation over `size`."""
    left_out: np.ndarray
    """By how much each probe's score differs from what the others say, shape [P]."""
    left_out_variance: np.ndarray
    """Of that, shape [P]."""

    def at(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of scores of new probes, shape [Q] each."""
        across = _matern(places, self.places, self.length)
        reduced = solve_triangular(self.factor[0], across.T, lower=True)
        variance = self.size * np.maximum(1 + self.noise - np.square(reduced).sum(axis=0), 0.0)
        return self.mean + across @ self.weights, variance


@dataclass(frozen=True, eq=False)
class Region:
    """What probes of one region say of others."""

    depths: np.ndarray
    """Where curves are compared, shape [DEPTHS] [mm]."""
    curves: np.ndarray
    """Components, unit vectors, shape [COMPONENTS, DEPTHS]."""
    fields: tuple[_Field, ...]
    """Of the components' scores."""
    rest: np.ndarray
    """Variance that the components leave at each depth, shape [DEPTHS] [N²]."""
    widening: float
    """Half of an interval over the standard deviation."""
    stiffness: float
    """Mean of the probes' linear stiffness, lines through 0 [N/mm]: what the region is compared with."""

    def predict(self, place: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force that a probe will feel, and half the width of its 90 % interval, both of shape [D] [N].

        Args:
            place: where the surface is touched, shape [3] [mm].
            depth: shape [D] [mm]; beyond what was probed the curve goes on as a straight line.
        """
        found = [field.at(place[None]) for field in self.fields]
        shares = list(zip(found, self.curves, strict=True))
        force = sum(mean[0] * curve for (mean, _), curve in shares)
        variance = self.rest + sum(value[0] * np.square(curve) for (_, value), curve in shares)
        spread = np.interp(depth, self.depths, np.sqrt(variance))
        return _along(self.depths, force, depth), self.widening * spread


def fit_region(probes: Sequence[Probe]) -> Region:
    """Learn a region from its probes.

    Raises:
        ValueError: fewer than LEAST_PROBES, or none that goes deep.
    """
    if len(probes) < LEAST_PROBES:
        raise ValueError(f"a region of {len(probes)} probes tells nothing of others; give {LEAST_PROBES} or more.")
    deepest = float(np.median([probe.depth.max() for probe in probes]))
    if not deepest > 0:
        raise ValueError("most probes never press; give ones with depths above 0.")
    depths = np.linspace(0.0, deepest, DEPTHS)
    # A probe that ended early says nothing of what is below.
    deep = [probe for probe in probes if probe.depth.max() > 0.9 * deepest]
    measured = np.array([np.interp(depths, probe.depth, probe.force) for probe in deep])
    places = np.array([probe.place for probe in deep])
    curves = np.linalg.svd(measured, full_matrices=False)[2][:COMPONENTS]
    curves = curves * np.where(curves.sum(axis=1) < 0, -1.0, 1.0)[:, None]
    scores = measured @ curves.T
    rest = np.mean(np.square(measured - scores @ curves), axis=0)
    fields = tuple(_field(places, column) for column in scores.T)
    missed = np.stack([field.left_out for field in fields], axis=1)
    variance = np.stack([field.left_out_variance for field in fields], axis=1) @ np.square(curves) + rest
    errors = missed @ curves + measured - scores @ curves
    ratio = np.abs(errors) / np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    lines = [float(probe.depth @ probe.force / (probe.depth @ probe.depth)) for probe in deep]
    return Region(depths, curves, fields, rest, float(np.quantile(ratio, LEVEL)), float(np.mean(lines)))


def _field(places: np.ndarray, scores: np.ndarray) -> _Field:
    length, noise = _likeliest(places, scores)
    kernel = _matern(places, places, length) + noise * np.eye(len(places))
    factor = cho_factor(kernel, lower=True)
    inverse = cho_solve(factor, np.eye(len(places)))
    ones = inverse.sum(axis=1)
    mean = float(ones @ scores / ones.sum())
    weights = inverse @ (scores - mean)
    size = float((scores - mean) @ weights) / max(len(places) - 1, 1)
    precision = np.diag(inverse)
    return _Field(places, length, size, factor, mean, weights, noise, weights / precision, size / precision)


def _likeliest(places: np.ndarray, scores: np.ndarray) -> tuple[float, float]:
    """Length [mm], and noise over the process's variance, of greatest marginal likelihood, mean and size profiled."""
    some = np.unique(np.linspace(0, len(places) - 1, min(len(places), MOST_FOR_LENGTH)).astype(int))
    places, scores = places[some], scores[some]
    apart = cdist(places, places)
    span = max(float(apart.max()), 1e-6)
    nearest = float(np.median(np.sort(apart, axis=1)[:, 1]))
    best = (-np.inf, span, 1.0)
    for length in np.geomspace(min(max(nearest, span / 100), span), span, 8):
        values, vectors = np.linalg.eigh(_matern(places, places, length))
        seen, ones = vectors.T @ scores, vectors.sum(axis=0)
        for noise in np.geomspace(1e-3, 30, 12):
            spread = np.maximum(values, 0.0) + noise
            mean = float((ones * seen / spread).sum() / (ones * ones / spread).sum())
            size = float(np.mean(np.square(seen - mean * ones) / spread))
            likely = -0.5 * float(np.log(spread).sum()) - 0.5 * len(scores) * np.log(max(size, 1e-300))
            best = max(best, (likely, float(length), float(noise)))
    return best[1:]


def _matern(one: np.ndarray, two: np.ndarray, length: float) -> np.ndarray:
    far = np.sqrt(3) * cdist(one, two) / length
    return (1 + far) * np.exp(-far)


def _along(depths: np.ndarray, force: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """A curve at other depths, its last and first pieces prolonged."""
    inside = np.interp(depth, depths, force)
    last, first = (force[-1] - force[-2]) / (depths[-1] - depths[-2]), (force[1] - force[0]) / (depths[1] - depths[0])
    return inside + last * np.maximum(depth - depths[-1], 0) + first * np.minimum(depth - depths[0], 0)
