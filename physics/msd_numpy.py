"""The mass-spring-damper rollout in plain numpy: short enough to be read beside the equation, and needs no compiler.

Source: Bini 2026, equation 9 and table 1: m ẍ + k_d ẋ + k_s x = F_ext per vertex, springs along the mesh's edges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from physics.mechanics import Mechanics
from physics.mesh import Mesh

NORM_GUARD = 1e-18
"""Added under every square root [scene units²], so that a spring of zero length has a direction: none."""


class Integrator(NamedTuple):
    """Coefficients of one step: v⁺ = keep·v + kick·f, u⁺ = u + Δt·v⁺, and the output is u⁺ − lag·v⁺."""

    keep: np.ndarray
    """Share of the velocity that damping leaves [1]."""
    kick: np.ndarray
    """Velocity that a force gives [s/kg]."""
    keep_slope: np.ndarray
    """Derivative of ``keep`` by k_d."""
    kick_slope: np.ndarray
    """Derivative of ``kick`` by k_d."""
    lag: float
    """How far the output lies behind the state [s]."""


def integrator(damping: np.ndarray, mechanics: Mechanics) -> Integrator:
    """Coefficients of one step for k_d of any shape, float64.

    Drift–kick–drift runs in the same form on the half-step positions w = u + ½Δt·v, with v' = (f − k_d·v)/m solved
    exactly over the step; its output goes half a drift back.
    """
    damping = np.asarray(damping, dtype=np.float64)
    step = mechanics.time_step / mechanics.mass
    ratio = step * damping
    if mechanics.scheme == "dkd":
        keep = np.exp(-ratio)
        # φ(c) = (1 − e⁻ᶜ)/c and φ'(c) by their series where the quotients would cancel.
        small = ratio < 0.05
        safe = np.where(small, 1.0, ratio)
        power = np.polynomial.polynomial.polyval
        share = np.where(small, power(ratio, SHARE), -np.expm1(-safe) / safe)
        slope = np.where(small, power(ratio, SHARE[1:] * np.arange(1, 10)), ((safe + 1) * np.exp(-safe) - 1) / safe**2)
        return Integrator(keep, step * share, -step * keep, step**2 * slope, mechanics.time_step / 2)
    if mechanics.damping == "explicit":
        ones = np.ones_like(ratio)
        return Integrator(1 - ratio, step * ones, -step * ones, 0 * ones, 0.0)
    keep = 1 / (1 + ratio)
    return Integrator(keep, step * keep, -step * keep**2, -(step**2) * keep**2, 0.0)


SHARE = np.array([(-1) ** n / math.factorial(n + 1) for n in range(10)])
"""Coefficients of φ(c) = Σ (−c)ⁿ/(n+1)!."""


def spring_force(displacement: np.ndarray, rest: np.ndarray, springs: np.ndarray) -> np.ndarray:
    """Pull of every spring on its first vertex for unit stiffness: the elongation along the spring's direction.

    Displacement form: e = |d| − |d₀| = (2 d₀·δu + δu²) / (|d| + |d₀|), which keeps the digits that |d| − |d₀| loses.

    Args:
        displacement: u = x − x₀, shape [N, 3] [scene units].
        rest: rest vectors d₀ from first to second vertex, shape [S, 3] [scene units].
        springs: vertex indices, shape [S, 2].

    Returns:
        Force on the first vertex, the second one's is opposite, shape [S, 3].
    """
    stretch = displacement[springs[:, 1]] - displacement[springs[:, 0]]
    current = rest + stretch
    length = np.sqrt((current * current).sum(axis=1) + NORM_GUARD)
    rest_length = np.sqrt((rest * rest).sum(axis=1) + NORM_GUARD)
    elongation = ((2 * rest + stretch) * stretch).sum(axis=1) / (length + rest_length)
    return (elongation / length)[:, None] * current


def free_vertices(mesh: Mesh, vertex: int, mechanics: Mechanics) -> np.ndarray:
    """Vertices that may move, shape [N], bool: all but the rim if it is fixed, and the contact vertex always."""
    free = ~mesh.rim if mechanics.boundary == "fixed" else np.ones(len(mesh.vertices), dtype=bool)
    free[vertex] = True
    return free


def steps(
    theta: np.ndarray, mesh: Mesh, vertex: int, direction: np.ndarray, mechanics: Mechanics, load: np.ndarray
) -> Iterator[np.ndarray]:
    """Displacement of the whole mesh after each step, shape [N, 3] [scene units], in θ's precision.

    Args:
        theta: k_s, k_d and signed F, shape [3], floating point.
        mesh: the mesh at rest.
        vertex: contact vertex, on which F·direction acts; never held.
        direction: shape [3].
        mechanics: constants.
        load: factor of F in each step, shape [T].
    """
    dtype = theta.dtype
    stiffness, damping, force = theta
    keep, kick, _, _, lag = (dtype.type(value) for value in integrator(damping, mechanics))
    time_step, anchor = dtype.type(mechanics.time_step), dtype.type(mechanics.anchor)
    vertices = mesh.vertices.astype(dtype)
    rest = vertices[mesh.springs[:, 1]] - vertices[mesh.springs[:, 0]]
    gather = _incidence(mesh, dtype)
    mobile = free_vertices(mesh, vertex, mechanics).astype(dtype)
    push = force * np.asarray(direction, dtype=dtype)
    displacement = np.zeros_like(vertices)
    velocity = np.zeros_like(vertices)
    for factor in load.astype(dtype):
        total = stiffness * (gather @ spring_force(displacement, rest, mesh.springs) - anchor * displacement)
        total[vertex] += factor * push
        velocity = (keep * velocity + kick * total) * mobile[:, None]
        displacement = displacement + time_step * velocity
        yield displacement - lag * velocity


def sensitivities(
    theta: np.ndarray, mesh: Mesh, vertex: int, direction: np.ndarray, mechanics: Mechanics, load: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the contact vertex [T, 3] and its derivatives by θ [T, 3, 3]; arguments as in `steps`.

    Forward mode: with g(u) the spring force for unit stiffness and p the load, the derivatives follow
    v̇⁺ = a·v̇ + b·k_s·ġ + ȧ·v + ḃ·(k_s·g + F·p) + b·(k̇_s·g + Ḟ·p), u̇⁺ = u̇ + Δt·v̇⁺.
    """
    dtype = theta.dtype
    stiffness, damping, force = theta
    step = integrator(damping, mechanics)
    keep, kick, keep_slope, kick_slope, lag = (dtype.type(value) for value in step)
    time_step, anchor = dtype.type(mechanics.time_step), dtype.type(mechanics.anchor)
    vertices = mesh.vertices.astype(dtype)
    rest = vertices[mesh.springs[:, 1]] - vertices[mesh.springs[:, 0]]
    gather = _incidence(mesh, dtype)
    mobile = free_vertices(mesh, vertex, mechanics).astype(dtype)[:, None]
    push = np.zeros_like(vertices)
    push[vertex] = direction
    displacement, velocity = np.zeros_like(vertices), np.zeros_like(vertices)
    moved, speed = np.zeros((3, *vertices.shape), dtype), np.zeros((3, *vertices.shape), dtype)
    trajectory, jacobian = np.empty((len(load), 3), dtype), np.empty((len(load), 3, 3), dtype)
    for index, factor in enumerate(load.astype(dtype)):
        pulls, turns = spring_tangents(displacement, moved, rest, mesh.springs)
        elastic = gather @ pulls - anchor * displacement
        bend = np.stack([gather @ turn for turn in turns]) - anchor * moved
        total = stiffness * elastic + factor * force * push
        own = [kick * elastic, keep_slope * velocity + kick_slope * total, kick * factor * push]
        speed = mobile * (keep * speed + kick * stiffness * bend + np.stack(own))
        velocity = mobile * (keep * velocity + kick * total)
        moved = moved + time_step * speed
        displacement = displacement + time_step * velocity
        trajectory[index] = displacement[vertex] - lag * velocity[vertex]
        jacobian[index] = (moved[:, vertex] - lag * speed[:, vertex]).T
    return trajectory, jacobian


def spring_tangents(
    displacement: np.ndarray, moved: np.ndarray, rest: np.ndarray, springs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Force of every spring for unit stiffness, shape [S, 3], and its change along `moved` [P, N, 3], shape [P, S, 3].

    ġ = α·δu̇ + β·(d·δu̇)·d with α = (ℓ − ℓ₀)/ℓ and β = ℓ₀/ℓ³; other arguments as in `spring_force`.
    """
    pull = spring_force(displacement, rest, springs)
    current = rest + displacement[springs[:, 1]] - displacement[springs[:, 0]]
    squared = (current * current).sum(axis=1) + NORM_GUARD
    length, rest_length = np.sqrt(squared), np.sqrt((rest * rest).sum(axis=1) + NORM_GUARD)
    alpha = (pull * current).sum(axis=1) / squared
    beta = rest_length / (squared * length)
    stretch = moved[:, springs[:, 1]] - moved[:, springs[:, 0]]
    along = (stretch * current).sum(axis=2)
    return pull, alpha[:, None] * stretch + (beta * along)[..., None] * current


def _incidence(mesh: Mesh, dtype: np.dtype) -> csr_array:
    """Matrix [N, S] that sums spring forces at the vertices: +1 at a spring's first vertex, −1 at its second."""
    count = len(mesh.springs)
    columns = np.arange(count)
    values = np.concatenate([np.ones(count, dtype), -np.ones(count, dtype)])
    places = (mesh.springs.T.ravel(), np.concatenate([columns, columns]))
    return csr_array((values, places), shape=(len(mesh.vertices), count))
