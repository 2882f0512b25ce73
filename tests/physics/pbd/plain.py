"""Extended position-based dynamics in plain numpy, one constraint at a time: what the compiled code must equal.

Source: Liang 2024, equation 3 (Macklin 2016): Δx = M⁻¹ ∇Cᵀ Δλ, Δλ = -(∇C M⁻¹ ∇Cᵀ + α)⁻¹ (C + α λ), α = 1/(k Δt²). Every
constraint gives C and its gradient by its points.
"""

from collections.abc import Iterator

import numpy as np

from palpate.physics.fem.polar import rotations
from palpate.physics.mesh import NORM_GUARD
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.simulation import Stepping


def distance(points: np.ndarray, rest: float) -> tuple[float, np.ndarray]:
    """C = |x₁ - x₂| - ℓ₀ of points [2, 3]."""
    apart = points[0] - points[1]
    length = np.sqrt(apart @ apart + NORM_GUARD)
    return float(length - rest), np.stack([apart, -apart]) / length


def volume(points: np.ndarray, rest: float) -> tuple[float, np.ndarray]:
    """C = (x₂ - x₁)×(x₃ - x₁)·(x₄ - x₁)/6 - V₀ of points [4, 3]."""
    two, three, four = points[1:] - points[0]
    slopes = np.stack([np.cross(three, four), np.cross(four, two), np.cross(two, three)]) / 6
    return float(np.cross(two, three) @ four / 6 - rest), np.concatenate([-slopes.sum(axis=0)[None], slopes])


def shape(points: np.ndarray, offsets: np.ndarray) -> tuple[float, np.ndarray]:
    """C = √(Σ |xᵢ - x̄ - R qᵢ|²), R the best rotation, of points and rest positions from their mean [n, 3]."""
    centred = points - points.mean(axis=0)
    apart = centred - offsets @ rotations(centred.T @ offsets).T
    value = np.sqrt((apart * apart).sum() + NORM_GUARD)
    return float(value), apart / value


def constraint(body: Body, index: int, positions: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Particles of one of a body's constraints, its C and its gradient by them."""
    layout, own = body.layout, slice(*body.layout.starts[index : index + 2])
    members = layout.members[own]
    if index >= layout.firsts[1]:
        return members, *shape(positions[members], layout.offsets[own])
    return members, *(distance if index < layout.firsts[0] else volume)(positions[members], layout.rest[index])


def project(body: Body, positions: np.ndarray, multipliers: np.ndarray, weight: np.ndarray, inverse_mass) -> None:
    """One sweep of Gauss–Seidel, which changes positions [N, 3] and multipliers [K]; with w = k Δt² in place of 1/α."""
    for index in range(len(body.layout.rest)):
        members, value, slope = constraint(body, index, positions)
        mobility = inverse_mass[members, None]
        step = -(weight[index] * value + multipliers[index]) / (weight[index] * (mobility * slope * slope).sum() + 1)
        multipliers[index] += step
        positions[members] += mobility * slope * step


def steps(
    body: Body, stiffness: np.ndarray, start: np.ndarray, gripped: np.ndarray, path: np.ndarray, how: Stepping
) -> Iterator[np.ndarray]:
    """Positions after each step [N, 3], by the constraints' stiffness [K], gripped particles along a path [T, G, 3]."""
    free = (body.inverse_mass(gripped) > 0)[:, None]
    # ½ m|x - a|²/Δt² + ½ f|x - r|² is ½ (m + f Δt²)|x - b|²/Δt² and a constant, b the weighted mean.
    back = how.foundation * how.time_step**2 / (1 + how.foundation * how.time_step**2)
    inverse_mass = body.inverse_mass(gripped) * (1 - back)
    positions = start.copy()
    for places in path:
        positions += np.where(free, back, 0.0) * (body.rest - positions)
        positions[gripped] = places
        multipliers = np.zeros(len(body.layout.rest))
        for _ in range(how.iterations):
            project(body, positions, multipliers, stiffness * how.time_step**2, inverse_mass)
        yield positions.copy()
