"""Compiled time steps of position-based dynamics.

Source: Liang 2024, equation 3 (Macklin 2016): Δx = M⁻¹ ∇Cᵀ Δλ, Δλ = -(∇C M⁻¹ ∇Cᵀ + α)⁻¹ (C + α λ), α = 1/(k Δt²); with
w = k Δt² in place of 1/α a stiffness of 0 is a number like others. A loop for each kind of constraint, so that what is
known of it (how many particles, which of them) needn't be asked: several times as fast as one for all.
"""

from __future__ import annotations

import numpy as np

from palpate.physics.jit import inlined, kernel
from palpate.physics.pbd.constraint_kernel import (
    add,
    dot,
    rotation_of,
    row,
    sides,
    stretched,
    swelled,
    turned_back,
    warped,
)


@inlined
def begun(before, inverse_mass, rest, foundation, gripped, places, points):
    """Where a step's sweeps begin: free particles where they were, gripped ones placed; written to `points` [N, 3].

    The foundation is part of the inertia: both are squares of one particle's way, whose sum is one such square.
    """
    for particle in range(points.shape[0]):
        back = foundation * inverse_mass[particle]
        for axis in range(3):
            points[particle, axis] = before[particle, axis] + back * (rest[particle, axis] - before[particle, axis])
    for index in range(gripped.shape[0]):
        for axis in range(3):
            points[gripped[index], axis] = places[index, axis]


@inlined
def stepped(weight, value, multiplier, mobility):
    """Δλ = -(w C + λ)/(w ∇C M⁻¹ ∇Cᵀ + 1)."""
    return -(weight * value + multiplier) / (weight * mobility + 1)


@inlined
def sweep(layout, weight, inverse_mass, points, multipliers, turn, slope, kept, every):
    """Go over all constraints once.

    Args:
        layout: a `Layout`.
        weight: k Δt² of every constraint, [K].
        inverse_mass: [N].
        points: [N, 3], changed.
        multipliers: [K], changed.
        turn: quaternions of the shapes, [P, 4], changed.
        slope: out, gradients of the shapes by their members, [M, 3].
        kept: out, what the way back needs of distances [·, 5], volumes [·, 11] and shapes [P, 15].
        every: whether to keep that, and to go over constraints without a weight, too: they have a slope.
    """
    starts, members, rest, offsets, firsts = layout
    distances, volumes, shapes = kept
    for index in range(firsts[0]):
        if weight[index] == 0.0 and not every:
            continue
        one, other = members[2 * index], members[2 * index + 1]
        value, normal = stretched(points, one, other, rest[index])
        mobility = (inverse_mass[one] + inverse_mass[other]) * dot(normal, normal)
        if every:
            distances[index, 0], distances[index, 1] = value, multipliers[index]
            distances[index, 2], distances[index, 3], distances[index, 4] = normal
        step = stepped(weight[index], value, multipliers[index], mobility)
        multipliers[index] += step
        add(points, one, inverse_mass[one] * step, normal)
        add(points, other, -inverse_mass[other] * step, normal)
    for index in range(firsts[0], firsts[1]):
        if weight[index] == 0.0 and not every:
            continue
        first = starts[index]
        w, x, y, z = members[first], members[first + 1], members[first + 2], members[first + 3]
        b, c, d = sides(points, members, first)
        value, by_b, by_c, by_d = swelled(b, c, d, rest[index])
        by_a = -(by_b[0] + by_c[0] + by_d[0]), -(by_b[1] + by_c[1] + by_d[1]), -(by_b[2] + by_c[2] + by_d[2])
        mobility = inverse_mass[w] * dot(by_a, by_a) + inverse_mass[x] * dot(by_b, by_b)
        mobility += inverse_mass[y] * dot(by_c, by_c) + inverse_mass[z] * dot(by_d, by_d)
        if every:
            volume = index - firsts[0]
            volumes[volume, 0], volumes[volume, 1] = value, multipliers[index]
            volumes[volume, 2], volumes[volume, 3], volumes[volume, 4] = b
            volumes[volume, 5], volumes[volume, 6], volumes[volume, 7] = c
            volumes[volume, 8], volumes[volume, 9], volumes[volume, 10] = d
        step = stepped(weight[index], value, multipliers[index], mobility)
        multipliers[index] += step
        add(points, w, inverse_mass[w] * step, by_a)
        add(points, x, inverse_mass[x] * step, by_b)
        add(points, y, inverse_mass[y] * step, by_c)
        add(points, z, inverse_mass[z] * step, by_d)
    for index in range(firsts[1], rest.shape[0]):
        if weight[index] == 0.0 and not every:
            continue
        shape = index - firsts[1]
        value, matrix = warped(starts, members, offsets, points, turn, shape, index, slope)
        mobility = 0.0
        for m in range(starts[index], starts[index + 1]):
            normal = row(slope, m)
            mobility += inverse_mass[members[m]] * dot(normal, normal)
        if every:
            w, x, y, z = turn[shape, 0], turn[shape, 1], turn[shape, 2], turn[shape, 3]
            left = turned_back(rotation_of((w, x, y, z)), matrix)
            shapes[shape, 0], shapes[shape, 1] = value, multipliers[index]
            shapes[shape, 2], shapes[shape, 3], shapes[shape, 4], shapes[shape, 5] = w, x, y, z
            for axis in range(3):
                for other in range(3):
                    shapes[shape, 6 + 3 * axis + other] = left[axis][other]
        step = stepped(weight[index], value, multipliers[index], mobility)
        multipliers[index] += step
        for m in range(starts[index], starts[index + 1]):
            add(points, members[m], inverse_mass[members[m]] * step, row(slope, m))


@kernel
def sweep_forward(layout, weight, inverse_mass, rest, gripped, path, foundation, iterations, turn, motion):
    """Step B bodies on.

    Args:
        layout: a `Layout`.
        weight: k Δt² of every constraint, [B, K].
        inverse_mass: of a particle with its foundation, 1/(m + f Δt²), [N].
        rest: where the foundation pulls to, [N, 3].
        gripped: particles, [G].
        path: where they are after each step, [B, T, G, 3].
        foundation: f Δt².
        iterations: sweeps a step.
        turn: quaternions of the shapes to begin at, [B, P, 4]; used up.
        motion: positions, the start filled in; out: after each step, [B, T + 1, N, 3].
    """
    batch, steps = motion.shape[0], motion.shape[1] - 1
    slope = np.empty_like(layout.offsets)
    multipliers = np.zeros(layout.rest.shape[0])
    kept = np.empty((0, 5)), np.empty((0, 11)), np.empty((0, 15))
    for b in range(batch):
        for t in range(steps):
            points = motion[b, t + 1]
            begun(motion[b, t], inverse_mass, rest, foundation, gripped, path[b, t], points)
            multipliers[:] = 0
            for _ in range(iterations):
                sweep(layout, weight[b], inverse_mass, points, multipliers, turn[b], slope, kept, False)
