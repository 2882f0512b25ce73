"""Values and gradients of the constraints, one at a time in plain numpy.

Source: Liang 2024, section III-B, names distance, volume and shape matching; their forms are those of Müller 2005
(shape matching), Müller 2007 and Macklin 2016 (XPBD). The paper doesn't say which it uses.
"""

from __future__ import annotations

import numpy as np

from physics.fem.polar import rotations
from physics.pbd.body import NORM_GUARD


def distance(points: np.ndarray, rest: float) -> tuple[float, np.ndarray]:
    """C = |x₁ - x₂| - ℓ₀ [m].

    Args:
        points: x₁ and x₂, shape [2, 3] [m].
        rest: ℓ₀ [m].

    Returns:
        C, and its gradient by the points, shape [2, 3].
    """
    apart = points[0] - points[1]
    length = np.sqrt(apart @ apart + NORM_GUARD)
    return float(length - rest), np.stack([apart, -apart]) / length


def volume(points: np.ndarray, rest: float) -> tuple[float, np.ndarray]:
    """C = (x₂ - x₁)×(x₃ - x₁)·(x₄ - x₁)/6 - V₀ [m³].

    Args:
        points: x₁ to x₄, shape [4, 3] [m].
        rest: V₀, signed as C is [m³].

    Returns:
        C, and its gradient by the points, shape [4, 3] [m²].
    """
    two, three, four = points[1:] - points[0]
    slopes = np.stack([np.cross(three, four), np.cross(four, two), np.cross(two, three)]) / 6
    return float(np.cross(two, three) @ four / 6 - rest), np.concatenate([-slopes.sum(axis=0)[None], slopes])


def shape(points: np.ndarray, offsets: np.ndarray) -> tuple[float, np.ndarray]:
    """C = √(Σ |xᵢ - x̄ - R qᵢ|²) [m], R the rotation that makes it smallest (Müller 2005, with equal weights).

    Since R and x̄ are where the sum is smallest, its gradient is that with both held: it adds up to no force and to no
    moment, whatever the masses.

    Args:
        points: xᵢ, shape [n, 3] [m].
        offsets: qᵢ, rest positions from their mean, shape [n, 3] [m].

    Returns:
        C, and its gradient by the points, shape [n, 3].
    """
    centred = points - points.mean(axis=0)
    apart = centred - offsets @ rotations(centred.T @ offsets).T
    value = np.sqrt((apart * apart).sum() + NORM_GUARD)
    return float(value), apart / value
