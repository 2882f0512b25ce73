"""What else explains the sequence of a dent than a slab that is homogeneous and damped in proportion to its mass.

Tissue may be firmer in some place beneath: a handful of places is compared to first order, the likeliest are fitted
anew, and the posterior is the mean over these fits and that of homogeneous tissue (Bayesian model averaging). And it
may relax: where a standard linear solid explains the sequence better than damping does, with a firm region or without,
that model is refuted, however small its misfit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_motion import FirmRegion, SlabMotion
from palpate.estimators.direct.slab_posterior import DONE, ROUGH, descend, shown_change
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.identifiability import box_information

REGION = 9.0
"""Radius of a firm region [grid px]; its top lies an eighth of the thickness deep."""
ASIDE = 0.5, 1.0
"""Of its middle from the contact's normal, over its radius."""
WAYS = 8
"""Directions from the contact in which it may lie."""
USUAL, USUAL_SD = MODEL_ERRORS.firm_usual, MODEL_ERRORS.firm_usual_sd
"""Its E over that around, and the standard deviation of the logarithm over it, by which places are compared."""
REGIONS, FIRMER = 2, (1.8, 3.2)
"""Firm regions that are fitted, the likeliest ones, and by which factors they are firmer."""
RELAXING = np.log([1 / 1.8, 1.0, 1 / 1.6, 0.1])
"""Where the fit of a standard linear solid begins: log E and log |F| added to those of damping by mass, which takes the
fast modulus for the slow one; log γ; log τ."""
REFUTED = 10.0
"""Fall of χ²/2 over the square of the misfit, from which on the standard linear solid is believed."""


class Firm(NamedTuple):
    """A fit with a firm region, in addition to that of tissue that is homogeneous."""

    gain: float
    """Logarithm of how much likelier it makes the sequence: that it was picked from many, and fitted, is not paid
    for."""
    shift: np.ndarray
    """Of (log E, log d, log |F|) away from that fit, shape [3]."""


def firm_regions(
    problem: SequenceProblem[SlabMotion], logs: np.ndarray, thickness: float, scale: float
) -> list[tuple[FirmRegion, np.ndarray]]:
    """Regions beneath that may be firm, likeliest first to first order, and where the fit of each may begin [D].

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

    homogeneous, left = motion.linear(logs), residual + jacobian @ suiting(residual)
    normal = np.asarray(contact.direction, np.float64)
    focal = float(motion.slab.focal_lengths.mean())
    radius = REGION * float(contact.mesh.vertices[contact.vertex, 2]) / focal
    below = contact.mesh.vertices[contact.vertex] - min(radius + thickness / 8, thickness) * normal
    found = []
    for aside in ASIDE:
        for angle in 2 * np.pi * np.arange(WAYS) / WAYS:
            centre = below + aside * radius * np.array([math.cos(angle), math.sin(angle), 0.0])
            region = FirmRegion(centre, radius, math.log(USUAL))
            change = shown_change(problem, motion.linear(logs, region) - homogeneous)
            freed = change + jacobian @ suiting(change)
            # Its firmness has a normal prior around 1, in units of the usual one.
            known = float(freed @ freed) / scale + 1 / USUAL_SD**2
            firm = (1 / USUAL_SD**2 - float(left @ freed) / scale) / known
            less = float(np.square(left).sum() - np.square(left + firm * freed).sum()) / scale
            gain = less - ((firm - 1) / USUAL_SD) ** 2 - math.log(known)
            found.append((gain, region, np.clip(logs + suiting(residual + firm * change), *motion.box)))
    return [item[1:] for item in sorted(found, key=lambda item: -item[0])]


def with_firm_regions(
    plain: SequenceProblem[SlabMotion],
    logs: np.ndarray,
    regions: list[tuple[FirmRegion, np.ndarray]],
    problem_of: Callable[[FirmRegion], SequenceProblem[SlabMotion]],
    scale: float,
) -> list[Firm]:
    """Fits of the likeliest firm regions, firmer by each of FIRMER; those that can't be followed are left out.

    Args:
        plain: of tissue that is homogeneous, fitted, at parameters `logs`.
        regions: likeliest first, with where their fits begin.
        problem_of: the depth-change sequence with a region.
        scale: as of `follow_valley`.
    """
    found = []
    for region, start in regions[:REGIONS]:
        for times in FIRMER:
            other = problem_of(dataclasses.replace(region, firmer=math.log(times)))
            other.look(start, outliers=True)
            try:
                start = descend(other, start, other.motion.box, DONE)
            except NoEstimate:
                continue
            found.append(Firm(fall(plain, logs, other, start) / scale, start[:3] - logs[:3]))
    return found


def averaged(fits: list[Firm]) -> tuple[float, np.ndarray, np.ndarray]:
    """Over tissue that is homogeneous and that with a firm region, equally likely beforehand.

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


def relaxation(
    plain: SequenceProblem[SlabMotion],
    logs: np.ndarray,
    other: SequenceProblem[SlabMotion],
    fits: list[Firm],
    scale: float,
) -> str:
    """A sentence where a standard linear solid explains a sequence better than the best fit of a slab damped by mass.

    Args:
        plain: fitted, at parameters `logs`.
        other: of a standard linear solid.
        fits: with firm regions, than which it has to explain more by REFUTED.
        scale: as of `follow_valley`.
    """
    box = other.motion.box
    start = np.concatenate([RELAXING, logs[3:]])
    start[[0, 2]] += logs[[0, 2]]
    start = np.clip(start, *box)
    other.look(start)
    try:
        found = descend(other, start, box, ROUGH)
    except NoEstimate:
        return ""
    if not fall(plain, logs, other, found) / scale > REFUTED + max([0.0, *(fit.gain for fit in fits)]):
        return ""
    ratio, time = np.exp(found[[1, 3]])
    return (
        f"The motion relaxes: a standard linear solid (γ {ratio:.2g}, τ {time:.2g} s) explains it better than damping "
        "proportional to mass does, so stiffness and damping are not the tissue's."
    )


def fall(
    plain: SequenceProblem[SlabMotion], logs: np.ndarray, other: SequenceProblem[SlabMotion], others: np.ndarray
) -> float:
    """Of χ²/2, as a fit weights it, from that fit to another, by the pixels that show tissue in both."""
    after = other.change(other.motion.at(others)[0], others)
    before = plain.change(plain.motion.at(logs)[0], logs)
    worse, better = (
        plain.whitened(np.where(np.isfinite(after), change - plain.observed, 0.0)) for change in (before, after)
    )
    return 0.5 * float(worse @ worse - better @ better)
