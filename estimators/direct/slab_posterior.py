"""What a film of a dent tells of a slab around the best fit: along the common scale, by a finer mesh, by a firm region.

E, d and F rise together along a valley that is far from normal: the larger they are the less inertia tells them apart.
So χ² is followed along it, d and F (and the delays) fitted at every E, with small motions by the slab's modes, to which
the fit's own strains are added as they are at the best fit. Elements of finite size let tissue move too early, which
passes for another E: a finer mesh says by how much. And tissue may be firmer in some place beneath: a handful of places
is compared to first order, the likeliest are fitted anew, and the posterior is the mean over these fits and that of
tissue that is alike throughout (Bayesian model averaging).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.direct.field import FilmProblem
from estimators.direct.slab_motion import FirmRegion, SlabMotion
from physics.identifiability import box_information

LONGEST, GROWTH = 0.2, 1.3
"""Steps along the valley, of log E: the first, a standard deviation of the normal distribution around the fit, at most;
and the next over the one before."""
UNLIKELY = 8.0
"""Rise of χ²/2 at which the valley ends."""
MOST = 14
"""Steps one way."""
ROUNDS = 2
"""Gauss–Newton steps of the other parameters at every E."""
DIFFERENCE = 0.02
"""Of a parameter, for derivatives."""
BETWEEN = 400
"""Values of log E by which the posterior is summed up."""
REGION = 9.0
"""Radius of a firm region [grid px]; its top lies an eighth of the thickness deep."""
ASIDE = 0.5, 1.0
"""Of its middle from the contact's normal, over its radius."""
WAYS = 8
"""Directions from the contact in which it may lie."""
USUAL, USUAL_SD = 3.0, 0.3
"""Its E over that around, and the standard deviation of the logarithm over it, by which places are compared."""


class Firm(NamedTuple):
    """A fit with a firm region, beside that of tissue that is alike throughout."""

    gain: float
    """Logarithm of its evidence over that fit's."""
    shift: np.ndarray
    """Of (log E, log d, log |F|) away from that fit, shape [3]."""


class Valley(NamedTuple):
    """The posterior of (log E, log d, log |F|) of a slab that is alike throughout."""

    mean: np.ndarray
    """Shape [3]."""
    covariance: np.ndarray
    """Shape [3, 3]."""
    best: np.ndarray
    """All parameters of the least χ² found, shape [D]."""
    fall: float
    """By so much χ²/2 is less there than where it began."""


def follow_valley(problem: FilmProblem[SlabMotion], logs: np.ndarray, box: np.ndarray, scale: float) -> Valley:
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


def moved_by_mesh(problem: FilmProblem[SlabMotion], finer: SlabMotion, logs: np.ndarray) -> np.ndarray:
    """By how much (log E, log d, log |F|) of a fit would be other by a finer mesh, to first order, shape [3]."""
    change = _change(problem, finer.by_modes(logs) - problem.motion.by_modes(logs))
    prior = box_information(problem.motion.box)
    jacobian = problem.jacobian(logs)
    return -np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ change)[:3]


def firm_regions(
    problem: FilmProblem[SlabMotion], logs: np.ndarray, thickness: float, scale: float
) -> list[tuple[FirmRegion, np.ndarray]]:
    """Firm regions beneath, likeliest first to first order, and the parameters [D] that would go with each.

    Args:
        problem: that has looked at a fit.
        logs: all parameters of it, shape [D].
        thickness: of the slab [scene units].
        scale: as of `follow_valley`.
    """
    motion, contact = problem.motion, problem.contact
    residual, jacobian = problem.linearise(logs)
    matrix = jacobian.T @ jacobian + box_information(motion.box)

    def suiting(values: np.ndarray) -> np.ndarray:
        return -np.linalg.solve(matrix, jacobian.T @ values)

    alike, left = motion.linear(logs), residual + jacobian @ suiting(residual)
    normal = np.asarray(contact.direction, np.float64)
    focal = float(motion.slab.focal_lengths.mean())
    radius = REGION * float(contact.mesh.vertices[contact.vertex, 2]) / focal
    below = contact.mesh.vertices[contact.vertex] - min(radius + thickness / 8, thickness) * normal
    found = []
    for aside in ASIDE:
        for angle in 2 * np.pi * np.arange(WAYS) / WAYS:
            centre = below + aside * radius * np.array([math.cos(angle), math.sin(angle), 0.0])
            region = FirmRegion(centre, radius, math.log(USUAL))
            change = _change(problem, motion.linear(logs, region) - alike)
            freed = change + jacobian @ suiting(change)
            # Its firmness has a normal prior around 1, in units of the usual one.
            known = float(freed @ freed) / scale + 1 / USUAL_SD**2
            firm = (1 / USUAL_SD**2 - float(left @ freed) / scale) / known
            fall = float(np.square(left).sum() - np.square(left + firm * freed).sum()) / scale
            gain = fall - ((firm - 1) / USUAL_SD) ** 2 - math.log(known)
            found.append((gain, region, np.clip(logs + suiting(residual + firm * change), *motion.box)))
    return [item[1:] for item in sorted(found, key=lambda item: -item[0])]


def averaged(fits: list[Firm]) -> tuple[float, np.ndarray, np.ndarray]:
    """Over tissue that is alike throughout and that with a firm region, alike likely beforehand.

    Returns:
        the probability that there is one; the mean shift of (log E, log d, log |F|), shape [3]; what it adds to their
        covariance, shape [3, 3].
    """
    gains = np.array([fit.gain for fit in fits] + [math.log(len(fits))] if fits else [0.0])
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    shifts = np.stack([*(fit.shift for fit in fits), np.zeros(3)])
    mean = weights @ shifts
    return float(weights[:-1].sum()), mean, np.einsum("w,wi,wj->ij", weights, shifts - mean, shifts - mean)


def _change(problem: FilmProblem[SlabMotion], moved: np.ndarray) -> np.ndarray:
    """What a small difference in the places' motion [N, V, 3] makes of the whitened residual."""
    return problem.whitened(np.nan_to_num(problem.patches.shown(problem.patches.sunk(moved), problem.covering)))
