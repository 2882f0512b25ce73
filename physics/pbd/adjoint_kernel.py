"""Compiled adjoint through all sweeps of position-based dynamics: no linear system, nothing left out.

Source: the chain rule of what `physics.pbd.sweep_kernel` computes, one constraint at a time. With Δλ = -(w C + λ)/g,
g = w m + 1, m = ∇C M⁻¹ ∇Cᵀ and x⁺ = x + M⁻¹ ∇Cᵀ Δλ, the derivative p by x⁺ and q by λ⁺ give s = q + p·M⁻¹ ∇C by Δλ,
-s (C + m Δλ)/g by w, q - s/g by λ, and by x: p - (w s/g) ∇C + ∇²C M⁻¹ (Δλ p - 2 (w s/g) Δλ ∇C).
"""

from __future__ import annotations

import numpy as np

from palpate.physics.jit import inlined, kernel
from palpate.physics.pbd.constraint_kernel import (
    add,
    dot,
    rotation_of,
    row,
    stretched_bent,
    swelled,
    swelled_bent,
    warped_bent,
)
from palpate.physics.pbd.sweep_kernel import begun, stepped, sweep


@inlined
def _directed(pull, particle, inverse_mass, step, twice, normal):
    """M⁻¹ (Δλ p - 2 (w s/g) Δλ ∇C) of one particle."""
    share = inverse_mass[particle]
    return (
        share * (step * pull[particle, 0] + twice * normal[0]),
        share * (step * pull[particle, 1] + twice * normal[1]),
        share * (step * pull[particle, 2] + twice * normal[2]),
    )


@inlined
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _by_step(index, by_step, weight, value, multiplier, mobility, pulled, slopes):
    """From s: Δλ and -w s/g; the derivatives by λ and w are written."""
    step = stepped(weight[index], value, multiplier, mobility)
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
        back = -normal[0], -normal[1], -normal[2]
        mobility = (inverse_mass[one] + inverse_mass[other]) * dot(normal, normal)
        by_step = pulled[index] + inverse_mass[one] * dot(normal, row(pull, one))
        by_step += inverse_mass[other] * dot(back, row(pull, other))
        step, by_value = _by_step(index, by_step, weight, value, multiplier, mobility, pulled, slopes)
        twice = 2 * by_value * step
        apart = _less(
            _directed(pull, one, inverse_mass, step, twice, normal),
            _directed(pull, other, inverse_mass, step, twice, back),
        )
        bent = stretched_bent(normal, value + rest[index], apart)
        for particle, sign in ((one, 1.0), (other, -1.0)):
            add(pull, particle, sign * by_value, normal)
            add(pull, particle, sign, bent)


@inlined
def _volumes_back(layout, weight, inverse_mass, kept, pull, pulled, slopes):
    members, starts, firsts = layout.members, layout.starts, layout.firsts
    for index in range(firsts[1] - 1, firsts[0] - 1, -1):
        volume, first = index - firsts[0], starts[index]
        w, x, y, z = members[first], members[first + 1], members[first + 2], members[first + 3]
        b = kept[volume, 2], kept[volume, 3], kept[volume, 4]
        c = kept[volume, 5], kept[volume, 6], kept[volume, 7]
        d = kept[volume, 8], kept[volume, 9], kept[volume, 10]
        _, by_b, by_c, by_d = swelled(b, c, d, layout.rest[index])
        by_a = -(by_b[0] + by_c[0] + by_d[0]), -(by_b[1] + by_c[1] + by_d[1]), -(by_b[2] + by_c[2] + by_d[2])
        mobility = inverse_mass[w] * dot(by_a, by_a) + inverse_mass[x] * dot(by_b, by_b)
        mobility += inverse_mass[y] * dot(by_c, by_c) + inverse_mass[z] * dot(by_d, by_d)
        by_step = pulled[index]
        for particle, by in ((w, by_a), (x, by_b), (y, by_c), (z, by_d)):
            by_step += inverse_mass[particle] * dot(by, row(pull, particle))
        value, multiplier = kept[volume, 0], kept[volume, 1]
        step, by_value = _by_step(index, by_step, weight, value, multiplier, mobility, pulled, slopes)
        twice = 2 * by_value * step
        da = _directed(pull, w, inverse_mass, step, twice, by_a)
        bent_b, bent_c, bent_d = swelled_bent(
            b,
            c,
            d,
            _less(_directed(pull, x, inverse_mass, step, twice, by_b), da),
            _less(_directed(pull, y, inverse_mass, step, twice, by_c), da),
            _less(_directed(pull, z, inverse_mass, step, twice, by_d), da),
        )
        add(pull, w, by_value, by_a)
        for particle, by, bent in ((x, by_b, bent_b), (y, by_c, bent_c), (z, by_d, bent_d)):
            add(pull, particle, by_value, by)
            add(pull, particle, 1.0, bent)
            add(pull, w, -1.0, bent)


@inlined
def _shapes_back(layout, weight, inverse_mass, kept, slope, along, change, pull, pulled, slopes):
    members, starts, offsets, firsts = layout.members, layout.starts, layout.offsets, layout.firsts
    for index in range(layout.rest.shape[0] - 1, firsts[1] - 1, -1):
        shape = index - firsts[1]
        by_step, mobility = pulled[index], 0.0
        for m in range(starts[index], starts[index + 1]):
            normal = row(slope, m)
            mobility += inverse_mass[members[m]] * dot(normal, normal)
            by_step += inverse_mass[members[m]] * dot(normal, row(pull, members[m]))
        value, multiplier = kept[shape, 0], kept[shape, 1]
        step, by_value = _by_step(index, by_step, weight, value, multiplier, mobility, pulled, slopes)
        twice = 2 * by_value * step
        for m in range(starts[index], starts[index + 1]):
            along[m, 0], along[m, 1], along[m, 2] = _directed(
                pull, members[m], inverse_mass, step, twice, row(slope, m)
            )
        rotation = rotation_of((kept[shape, 2], kept[shape, 3], kept[shape, 4], kept[shape, 5]))
        left = (
            (kept[shape, 6], kept[shape, 7], kept[shape, 8]),
            (kept[shape, 9], kept[shape, 10], kept[shape, 11]),
            (kept[shape, 12], kept[shape, 13], kept[shape, 14]),
        )
        warped_bent(starts, offsets, rotation, left, index, slope, value, along, change)
        for m in range(starts[index], starts[index + 1]):
            add(pull, members[m], by_value, row(slope, m))
            add(pull, members[m], 1.0, row(change, m))


@kernel
def sweep_adjoint(
    layout, weight, inverse_mass, rest, gripped, path, foundation, iterations, turn, motion, pulls, slopes
):
    """Go back through `sweep_forward` and gather the derivatives of Σ pulls·motion.

    Every step is repeated from the positions before it, with what its sweeps met kept; then they are gone back through.

    Args:
        layout … iterations: as given to `sweep_forward`.
        turn: quaternions to begin at, [B, P, 4]; used up.
        motion: what it wrote.
        pulls: derivatives by it, [B, T + 1, N, 3]; used up.
        slopes: out, derivatives by the weights [B, K].
    """
    batch, steps, count = motion.shape[0], motion.shape[1] - 1, motion.shape[2]
    constraints, members = layout.rest.shape[0], layout.members.shape[0]
    distances = np.empty((iterations, layout.firsts[0], 5))
    volumes = np.empty((iterations, layout.firsts[1] - layout.firsts[0], 11))
    shapes = np.empty((iterations, turn.shape[1], 15))
    slope = np.empty((iterations, members, 3))
    along, change = np.empty((members, 3)), np.empty((members, 3))
    points = np.zeros((count, 3))
    multipliers, pulled = np.zeros(constraints), np.zeros(constraints)
    for b in range(batch):
        for t in range(steps - 1, -1, -1):
            begun(motion[b, t], inverse_mass, rest, foundation, gripped, path[b, t], points)
            multipliers[:] = 0
            for index in range(iterations):
                kept = distances[index], volumes[index], shapes[index]
                sweep(layout, weight[b], inverse_mass, points, multipliers, turn[b], slope[index], kept, True)
            pull = pulls[b, t + 1]
            pulled[:] = 0
            for index in range(iterations - 1, -1, -1):
                back = pull, pulled, slopes[b]
                _shapes_back(layout, weight[b], inverse_mass, shapes[index], slope[index], along, change, *back)
                _volumes_back(layout, weight[b], inverse_mass, volumes[index], *back)
                _distances_back(layout, weight[b], inverse_mass, distances[index], *back)
            for index in range(gripped.shape[0]):  # where they are doesn't depend on anything
                for axis in range(3):
                    pull[gripped[index], axis] = 0.0
            for particle in range(count):
                left = 1.0 - foundation * inverse_mass[particle]  # the rest of its way is the foundation's
                for axis in range(3):
                    pulls[b, t, particle, axis] += left * pull[particle, axis]
