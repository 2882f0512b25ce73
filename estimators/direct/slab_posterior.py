"""What a sequence of a dent tells of a slab around the best fit: along the common scale, and by a finer mesh.

E, d and F rise together along a valley that is far from normal: the larger they are the less inertia tells them apart.
So χ² is followed along it, d and F (and the delays) fitted at every E, with small motions by the slab's modes, to which
the fit's own strains are added as they are at the best fit. Elements of finite size let tissue move too early, which
passes for another E: a finer mesh says by how much.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_descent import DIFFERENCE
from palpate.estimators.direct.slab_motion import SlabMotion
from palpate.physics.identifiability import box_information

LONGEST, GROWTH = 0.2, 1.3
"""Steps along the valley, of log E: the first, a standard deviation of the normal distribution around the fit, at most;
and the next over the one before."""
UNLIKELY = 8.0
"""Rise of χ²/2 at which the valley ends."""
MOST = 14
"""Steps one way."""
ROUNDS = 2
"""Gauss–Newton steps of the other parameters at every E."""
BETWEEN = 400
"""Values of log E by which the posterior is summed up."""


class Valley(NamedTuple):
    """The posterior of (log E, log d, log |F|) of a slab that is homogeneous."""

    mean: np.ndarray
    """Shape [3]."""
    covariance: np.ndarray
    """Shape [3, 3]."""
    best: np.ndarray
    """All parameters of the least χ² found, shape [D]."""
    fall: float
    """By so much χ²/2 is less there than where it began."""


def follow_valley(problem: SequenceProblem[SlabMotion], logs: np.ndarray, box: np.ndarray, scale: float) -> Valley:
    """Follow χ² along the common scale from a fit.

    Args:
        problem: that has looked at it.
        logs: all parameters of it, shape [D].
        box: ends of the parameters, shape [2, D].
        scale: of χ²: the square of the misfit.
    """
    motion, prior = problem.motion, box_information(box)
    strained = motion.at(logs)[0] - motion.by_modes(logs)

    def residual(tried: np.ndarray) -> np.ndarray:
        return problem.whitened(problem.change(strained + motion.by_modes(tried), tried) - problem.observed)

    def settled(tried: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """With all but E as they suit it, χ²/2, and the covariance of log d and log |F| there."""
        for _ in range(ROUNDS):
            left = residual(tried)
            steps = DIFFERENCE * np.eye(len(tried))[1:]
            slopes = np.stack([(residual(tried + step) - left) / DIFFERENCE for step in steps], axis=1)
            curvature = slopes.T @ slopes / scale + prior[1:, 1:]
            change = -np.linalg.solve(curvature, slopes.T @ left / scale)
            change *= min(1.0, 1.0 / max(np.abs(change).max(), 1e-12))
            tried = np.clip(np.append(tried[0], tried[1:] + change), *box)
        return tried, 0.5 * float(np.square(residual(tried)).sum()) / scale, np.linalg.inv(curvature)

    spread = np.linalg.inv(problem.information(logs) / scale + prior)
    first = min(math.sqrt(spread[0, 0]), LONGEST)
    points = [settled(logs)]
    for way in (1.0, -1.0):
        here, length, least = points[0][0], first, points[0][1]
        for _ in range(MOST):
            here = here + way * length * (np.arange(len(logs)) < 3)
            if not (box[0, 0] < here[0] < box[1, 0]):
                break
            point = settled(np.clip(here, *box))
            here, length, least = point[0], GROWTH * length, min(least, point[1])
            points.append(point)
            if point[1] > least + UNLIKELY:
                break
    points.sort(key=lambda item: item[0][0])
    young = np.array([item[0][0] for item in points])
    density = -np.array([item[1] - 0.5 * np.linalg.slogdet(item[2])[1] for item in points])
    fine = np.linspace(young[0], young[-1], BETWEEN)
    weights = np.exp(np.interp(fine, young, density) - density.max())
    weights /= weights.sum()
    path = np.stack([np.interp(fine, young, [item[0][index] for item in points]) for index in range(3)], axis=1)
    mean = weights @ path
    covariance = np.einsum("w,wi,wj->ij", weights, path - mean, path - mean)
    beside = np.array([item[2][:2, :2] for item in points])
    nearest = np.abs(fine[:, None] - young).argmin(axis=1)
    covariance[1:, 1:] += np.einsum("w,wij->ij", weights, beside[nearest])
    best = min(points, key=lambda item: item[1])
    value = 0.5 * float(np.square(residual(logs)).sum()) / scale
    return Valley(mean, covariance, best[0], scale * (value - best[1]))


def moved_by_mesh(problem: SequenceProblem[SlabMotion], finer: SlabMotion, logs: np.ndarray) -> np.ndarray:
    """By how much (log E, log d, log |F|) of a fit would be other by a finer mesh, to first order, shape [3]."""
    change = shown_change(problem, finer.by_modes(logs) - problem.motion.by_modes(logs))
    prior = box_information(problem.motion.box)
    jacobian = problem.jacobian(logs)
    return -np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ change)[:3]


def shown_change(problem: SequenceProblem[SlabMotion], moved: np.ndarray) -> np.ndarray:
    """What a small difference in the places' motion [N, V, 3] makes of the whitened residual."""
    return problem.whitened(np.nan_to_num(problem.patches.shown(problem.patches.sunk(moved), problem.covering)))
