"""Extended position-based dynamics in plain numpy: short enough to be read beside the equation, and needs no compiler.

Source: Liang 2024, equation 3 (Macklin 2016): Δx = M⁻¹ ∇Cᵀ Δλ, Δλ = -(∇C M⁻¹ ∇Cᵀ + α)⁻¹ (C + α λ), α = 1/(k Δt²).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from physics.pbd.body import Body
from physics.pbd.constraints import distance, shape, volume


def project(
    body: Body, positions: np.ndarray, multipliers: np.ndarray, weight: np.ndarray, inverse_mass: np.ndarray
) -> float:
    """One sweep of Gauss–Seidel over all constraints, which changes positions and multipliers in place.

    With w = k Δt² in place of α = 1/w, Δλ = -(w C + λ) / (w ∇C M⁻¹ ∇Cᵀ + 1): k = 0 is then a number like others.

    Args:
        body: the body.
        positions: x, shape [N, 3] [m].
        multipliers: λ, shape [K].
        weight: k Δt² of every constraint, shape [K].
        inverse_mass: 1/m, shape [N] [1/kg].

    Returns:
        Largest change of a coordinate by any one constraint [m].
    """
    layout, changed = body.layout, 0.0
    for index, rest in enumerate(layout.rest):
        own = slice(layout.starts[index], layout.starts[index + 1])
        members = layout.members[own]
        if index < layout.firsts[0]:
            value, slope = distance(positions[members], rest)
        elif index < layout.firsts[1]:
            value, slope = volume(positions[members], rest)
        else:
            value, slope = shape(positions[members], layout.offsets[own])
        mobility = inverse_mass[members, None]
        give = weight[index] * (mobility * slope * slope).sum() + 1
        step = -(weight[index] * value + multipliers[index]) / give
        multipliers[index] += step
        positions[members] += mobility * slope * step
        changed = max(changed, float(np.abs(mobility * slope * step).max()))
    return changed


def steps(
    body: Body,
    stiffness: np.ndarray,
    start: np.ndarray,
    speed: np.ndarray,
    gripped: np.ndarray,
    path: np.ndarray,
    *,
    time_step: float,
    iterations: int,
    keep: float,
    acceleration: np.ndarray,
    foundation: float = 0.0,
) -> Iterator[np.ndarray]:
    """Positions after each step, shape [N, 3] [m].

    Args:
        body: the body.
        stiffness: k of every constraint, shape [K].
        start: x, shape [N, 3] [m].
        speed: v, shape [N, 3] [m/s].
        gripped: particles, shape [G].
        path: where they are after each step, shape [T, G, 3] [m].
        time_step: Δt [s].
        iterations: sweeps a step.
        keep: share of the velocity that a step begins with.
        acceleration: of all free particles, shape [3] [m/s²].
        foundation: what holds every particle to its rest [N/m].
    """
    free = (body.inverse_mass(gripped) > 0)[:, None]
    # ½ m|x - a|²/Δt² + ½ f|x - r|² is ½ (m + f Δt²)|x - b|²/Δt² and a constant, b the weighted mean.
    back = foundation * time_step**2 / (body.mass + foundation * time_step**2)
    inverse_mass = body.inverse_mass(gripped) * (1 - back)
    back = np.where(free, back[:, None], 0.0)
    positions = start.copy()
    for places in path:
        before = positions.copy()
        positions += np.where(free, time_step * keep * speed + time_step**2 * acceleration, 0.0)
        positions += back * (body.rest - positions)
        positions[gripped] = places
        multipliers = np.zeros(len(body.layout.rest))
        for _ in range(iterations):
            project(body, positions, multipliers, stiffness * time_step**2, inverse_mass)
        speed = (positions - before) / time_step
        yield positions.copy()
