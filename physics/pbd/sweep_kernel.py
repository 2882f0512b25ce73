"""Compiled time steps of position-based dynamics, and their adjoint: no linear system, nothing left out.

Source: Liang 2024, equation 3 (Macklin 2016): Δx = M⁻¹ ∇Cᵀ Δλ, Δλ = -(∇C M⁻¹ ∇Cᵀ + α)⁻¹ (C + α λ), α = 1/(k Δt²); with
w = k Δt² in place of 1/α a stiffness of 0 is a number like others. Distances have a loop of their own, where it needn't
be asked how many particles they join: several times as fast as one for all.

The way back is the chain rule, one constraint at a time. With Δλ = -(w C + λ)/g, g = w m + 1, m = ∇C M⁻¹ ∇Cᵀ and
x⁺ = x + M⁻¹ ∇Cᵀ Δλ, the derivative p by x⁺ and q by λ⁺ give s = q + p·M⁻¹ ∇C by Δλ, -s (C + m Δλ)/g by w, q - s/g by λ,
and by x: p - (w s/g) ∇C + ∇²C M⁻¹ (Δλ p - 2 (w s/g) Δλ ∇C).
"""

import numpy as np

from palpate.physics.jit import inlined, kernel
from palpate.physics.pbd.constraint_kernel import add, bent, dot, met, plus, put, row, scaled, stretched, stretched_bent


@inlined
def _begun(before, inverse_mass, rest, foundation, gripped, places, points):
    """Starts of a step's sweeps: free particles where they were, gripped ones placed; written to `points` [N, 3].

    The foundation is part of the inertia: both are squares of one particle's way, whose sum is one such square.
    """
    for particle in range(points.shape[0]):
        here = row(before, particle)
        back = plus(row(rest, particle), -1.0, here)
        put(points, particle, plus(here, foundation * inverse_mass[particle], back))
    for index in range(gripped.shape[0]):
        put(points, gripped[index], row(places, index))


@inlined
def _stepped(weight, value, multiplier, mobility):
    """Δλ = -(w C + λ)/(w ∇C M⁻¹ ∇Cᵀ + 1)."""
    return -(weight * value + multiplier) / (weight * mobility + 1)


@inlined
def _sweep(layout, weight, inverse_mass, points, multipliers, turn, slope, kept, every):
    """Go over all constraints once.

    Args:
        layout: a `Layout`.
        weight: k Δt² of every constraint, [K].
        inverse_mass: [N].
        points: [N, 3], changed.
        multipliers: [K], changed.
        turn: quaternions of the shapes, [P, 4], changed.
        slope: out, gradients of volumes and shapes by their members, [M, 3].
        kept: out, what the way back needs of distances [·, 5], and of volumes and shapes [·, 15].
        every: True = keep that, also for constraints without a weight, which have a slope.
    """
    starts, members, rest, _, firsts = layout
    distances, several = kept
    for index in range(firsts[0]):
        if weight[index] == 0.0 and not every:
            continue
        one, other = members[2 * index], members[2 * index + 1]
        value, normal = stretched(points, one, other, rest[index])
        mobility = (inverse_mass[one] + inverse_mass[other]) * dot(normal, normal)
        if every:
            distances[index, 0], distances[index, 1] = value, multipliers[index]
            distances[index, 2], distances[index, 3], distances[index, 4] = normal
        step = _stepped(weight[index], value, multipliers[index], mobility)
        multipliers[index] += step
        add(points, one, inverse_mass[one] * step, normal)
        add(points, other, -inverse_mass[other] * step, normal)
    for index in range(firsts[0], rest.shape[0]):
        if weight[index] == 0.0 and not every:
            continue
        value, left = met(layout, points, turn, index, slope)
        mobility = 0.0
        for m in range(starts[index], starts[index + 1]):
            normal = row(slope, m)
            mobility += inverse_mass[members[m]] * dot(normal, normal)
        if every:
            place, shape = index - firsts[0], index - firsts[1]
            several[place, 0], several[place, 1] = value, multipliers[index]
            for axis in range(4 if shape >= 0 else 0):
                several[place, 2 + axis] = turn[shape, axis]
            for axis in range(3):
                several[place, 6 + 3 * axis], several[place, 7 + 3 * axis], several[place, 8 + 3 * axis] = left[axis]
        step = _stepped(weight[index], value, multipliers[index], mobility)
        multipliers[index] += step
        for m in range(starts[index], starts[index + 1]):
            add(points, members[m], inverse_mass[members[m]] * step, row(slope, m))


@kernel
def sweep_forward(layout, weight, inverse_mass, rest, gripped, path, foundation, sweeps, turn, motion):
    """Step B bodies on.

    Args:
        layout: a `Layout`.
        weight: k Δt² of every constraint, [B, K].
        inverse_mass: inverse mass of a particle with its foundation, 1/(m + f Δt²), [N].
        rest: place to which the foundation pulls, [N, 3].
        gripped: particles, [G].
        path: places of the gripped particles after each step, [B, T, G, 3].
        foundation: f Δt².
        sweeps: over all constraints a step.
        turn: quaternions of the shapes to begin at, [B, P, 4]; used up.
        motion: positions, the start filled in; out: after each step, [B, T + 1, N, 3].
    """
    batch, steps = motion.shape[0], motion.shape[1] - 1
    slope = np.empty_like(layout.offsets)
    multipliers = np.zeros(layout.rest.shape[0])
    kept = np.empty((0, 5)), np.empty((0, 15))
    for b in range(batch):
        for t in range(steps):
            points = motion[b, t + 1]
            _begun(motion[b, t], inverse_mass, rest, foundation, gripped, path[b, t], points)
            multipliers[:] = 0
            for _ in range(sweeps):
                _sweep(layout, weight[b], inverse_mass, points, multipliers, turn[b], slope, kept, False)


@inlined
def _directed(pull, particle, inverse_mass, step, twice, normal):
    """M⁻¹ (Δλ p - 2 (w s/g) Δλ ∇C) of one particle."""
    return scaled(plus(scaled(row(pull, particle), step), twice, normal), inverse_mass[particle])


@inlined
def _by_step(index, by_step, weight, value, multiplier, mobility, pulled, slopes):
    """Δλ and -w s/g from s; the derivatives by λ and w are written."""
    step = _stepped(weight[index], value, multiplier, mobility)
    share = by_step / (weight[index] * mobility + 1)
    slopes[index] -= share * (value + mobility * step)
    pulled[index] -= share
    return step, -weight[index] * share


@inlined
def _distances_back(layout, weight, inverse_mass, kept, pull, pulled, slopes):
    members, rest = layout.members, layout.rest
    for index in range(layout.firsts[0] - 1, -1, -1):
        one, other = members[2 * index], members[2 * index + 1]
        value, multiplier = kept[index, 0], kept[index, 1]
        normal = kept[index, 2], kept[index, 3], kept[index, 4]
        back = scaled(normal, -1.0)
        mobility = (inverse_mass[one] + inverse_mass[other]) * dot(normal, normal)
        by_step = pulled[index] + inverse_mass[one] * dot(normal, row(pull, one))
        by_step += inverse_mass[other] * dot(back, row(pull, other))
        step, by_value = _by_step(index, by_step, weight, value, multiplier, mobility, pulled, slopes)
        twice = 2 * by_value * step
        a = _directed(pull, one, inverse_mass, step, twice, normal)
        b = _directed(pull, other, inverse_mass, step, twice, back)
        bent = stretched_bent(normal, value + rest[index], plus(a, -1.0, b))
        for particle, sign in ((one, 1.0), (other, -1.0)):
            add(pull, particle, sign * by_value, normal)
            add(pull, particle, sign, bent)


@inlined
def _several_back(layout, weight, inverse_mass, kept, slope, along, change, pull, pulled, slopes):
    """Back through volumes and shapes."""
    members, starts, first = layout.members, layout.starts, layout.firsts[0]
    for index in range(layout.rest.shape[0] - 1, first - 1, -1):
        own = kept[index - first]
        by_step, mobility = pulled[index], 0.0
        for m in range(starts[index], starts[index + 1]):
            normal = row(slope, m)
            mobility += inverse_mass[members[m]] * dot(normal, normal)
            by_step += inverse_mass[members[m]] * dot(normal, row(pull, members[m]))
        step, by_value = _by_step(index, by_step, weight, own[0], own[1], mobility, pulled, slopes)
        twice = 2 * by_value * step
        for m in range(starts[index], starts[index + 1]):
            put(along, m, _directed(pull, members[m], inverse_mass, step, twice, row(slope, m)))
        left = (own[6], own[7], own[8]), (own[9], own[10], own[11]), (own[12], own[13], own[14])
        bent(layout, index, (own[2], own[3], own[4], own[5]), left, slope, own[0], along, change)
        for m in range(starts[index], starts[index + 1]):
            add(pull, members[m], by_value, row(slope, m))
            add(pull, members[m], 1.0, row(change, m))


@kernel
def sweep_adjoint(layout, weight, inverse_mass, rest, gripped, path, foundation, sweeps, turn, motion, pulls, slopes):
    """Go back through `sweep_forward` and gather the derivatives of Σ pulls·motion.

    Every step is repeated from the positions before it, with what its sweeps met kept; then they are gone back through.

    Args:
        layout … sweeps: as given to `sweep_forward`.
        turn: quaternions to begin at, [B, P, 4]; used up.
        motion: output of the steps.
        pulls: derivatives by it, [B, T + 1, N, 3]; used up.
        slopes: out, derivatives by the weights [B, K].
    """
    batch, steps, count = motion.shape[0], motion.shape[1] - 1, motion.shape[2]
    constraints, members = layout.rest.shape[0], layout.members.shape[0]
    distances = np.empty((sweeps, layout.firsts[0], 5))
    several = np.empty((sweeps, constraints - layout.firsts[0], 15))
    slope = np.empty((sweeps, members, 3))
    along, change = np.empty((members, 3)), np.empty((members, 3))
    points = np.zeros((count, 3))
    multipliers, pulled = np.zeros(constraints), np.zeros(constraints)
    for b in range(batch):
        for t in range(steps - 1, -1, -1):
            _begun(motion[b, t], inverse_mass, rest, foundation, gripped, path[b, t], points)
            multipliers[:] = 0
            for index in range(sweeps):
                kept = distances[index], several[index]
                _sweep(layout, weight[b], inverse_mass, points, multipliers, turn[b], slope[index], kept, True)
            pull = pulls[b, t + 1]
            pulled[:] = 0
            for index in range(sweeps - 1, -1, -1):
                back = pull, pulled, slopes[b]
                _several_back(layout, weight[b], inverse_mass, several[index], slope[index], along, change, *back)
                _distances_back(layout, weight[b], inverse_mass, distances[index], *back)
            for index in range(gripped.shape[0]):  # where they are doesn't depend on anything
                put(pull, gripped[index], (0.0, 0.0, 0.0))
            for particle in range(count):  # the rest of its way is the foundation's
                add(pulls[b, t], particle, 1.0 - foundation * inverse_mass[particle], row(pull, particle))
