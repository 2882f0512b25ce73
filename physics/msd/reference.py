"""The mass-spring-damper rollout in plain numpy: short enough to be read next to the equation, and needs no compiler.

Source: Bini 2026, equation 9 and table 1: m ẍ + k_d ẋ + k_s x = F_ext per vertex, springs along the mesh's edges.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import exprel, hyp1f1

from palpate.physics.load import Grip, Load, Press
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import NORM_GUARD, Mesh, incidence


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
    """Delay of the output behind the state [s]."""


def integrator(damping: float | np.ndarray, mechanics: Mechanics) -> Integrator:
    """Coefficients of one step for k_d of any shape, float64.

    Drift–kick–drift has the same form on the half-step positions w = u + ½Δt·v: v' = (f − k_d·v)/m is solved exactly
    over the step, and the output goes half a drift back.
    """
    damping = np.asarray(damping, dtype=np.float64)
    step = mechanics.time_step / mechanics.mass
    ratio = step * damping
    if mechanics.scheme == "dkd":
        keep = np.exp(-ratio)
        # φ(c) = (1 − e⁻ᶜ)/c is Kummer's function 1F1(1; 2; −c), whose slope by c is −½·1F1(2; 3; −c).
        share, slope = exprel(-ratio), -hyp1f1(2, 3, -ratio) / 2
        return Integrator(keep, step * share, -step * keep, step**2 * slope, mechanics.time_step / 2)
    keep = 1 / (1 + ratio)
    return Integrator(keep, step * keep, -step * keep**2, -(step**2) * keep**2, 0.0)


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


def free_vertices(mesh: Mesh, load: Load) -> np.ndarray:
    """Vertices that move by themselves, shape [N], bool: all but gripped ones and the rim; pressed ones always."""
    free = ~mesh.rim
    free[load.vertices] = isinstance(load, Press)
    return free


def push_of(press: Press, dtype: np.dtype) -> np.ndarray:
    """weight·direction of every pressed vertex, shape [P, 3], in one precision."""
    return np.outer(press.weights.astype(dtype), press.direction.astype(dtype))


def steps(
    theta: np.ndarray, mesh: Mesh, load: Load, mechanics: Mechanics, *, sensitive: bool = False
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Roll out in θ's precision: displacement [N, 3] [scene units] and its derivatives by θ [3, N, 3] after each step.

    Forward mode: with g(u) the spring force for unit stiffness and p the load, the derivatives follow
    v̇⁺ = a·v̇ + b·k_s·ġ + ȧ·v + ḃ·(k_s·g + F·p) + b·(k̇_s·g + Ḟ·p), u̇⁺ = u̇ + Δt·v̇⁺.

    Args:
        theta: k_s, k_d and signed F, shape [3], floating point; F means nothing under a grip.
        mesh: the mesh at rest.
        load: load on the mesh; its steps are the simulation's.
        mechanics: constants.
        sensitive: True = the derivatives by θ are carried along; False = they stay 0.
    """
    dtype = theta.dtype
    stiffness, damping, force = theta
    keep, kick, keep_slope, kick_slope, lag = (dtype.type(value) for value in integrator(damping, mechanics))
    time_step = dtype.type(mechanics.time_step)
    vertices = mesh.vertices.astype(dtype)
    rest = vertices[mesh.springs[:, 1]] - vertices[mesh.springs[:, 0]]
    gather = incidence(mesh.springs, len(vertices)).astype(dtype)
    mobile = free_vertices(mesh, load).astype(dtype)[:, None]
    push, factors = np.zeros_like(vertices), np.zeros(load.steps, dtype)
    if isinstance(load, Press):
        factors = load.factor.astype(dtype)
        np.add.at(push, load.vertices, push_of(load, dtype))
    else:  # where it is while each step's forces act: at its beginning, or in its middle
        before = np.concatenate([np.zeros_like(load.displacement[:1]), load.displacement[:-1]])
        during = (before + load.displacement) / 2 if mechanics.scheme == "dkd" else before
    displacement, velocity = np.zeros_like(vertices), np.zeros_like(vertices)
    moved, speed = np.zeros((3, *vertices.shape), dtype), np.zeros((3, *vertices.shape), dtype)
    for index, factor in enumerate(factors):
        if isinstance(load, Grip):
            displacement[load.vertices] = during[index]
        unit = gather @ spring_force(displacement, rest, mesh.springs)
        total = stiffness * unit + factor * force * push
        if sensitive:
            turns = spring_tangents(displacement, moved, rest, mesh.springs)
            by_theta = stiffness * np.stack([gather @ turn for turn in turns])
            by_theta[0] += unit
            own = np.stack([np.zeros_like(unit), keep_slope * velocity + kick_slope * total, kick * factor * push])
            speed = mobile * (keep * speed + kick * by_theta + own)
            moved = moved + time_step * speed
        velocity = mobile * (keep * velocity + kick * total)
        displacement = displacement + time_step * velocity
        shown = displacement - lag * velocity
        if isinstance(load, Grip):
            shown[load.vertices] = load.displacement[index]
        yield shown, moved - lag * speed


def spring_tangents(displacement: np.ndarray, moved: np.ndarray, rest: np.ndarray, springs: np.ndarray) -> np.ndarray:
    """Change of every `spring_force` along `moved` [P, N, 3], shape [P, S, 3].

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
    return alpha[:, None] * stretch + (beta * along)[..., None] * current
