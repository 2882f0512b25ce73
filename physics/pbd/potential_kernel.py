"""Compiled elastic energy of position-based dynamics and its derivatives (Liang 2024, equation 2)."""

from __future__ import annotations

import numpy as np

from palpate.physics.jit import kernel
from palpate.physics.pbd.constraint_kernel import (
    add,
    dot,
    less,
    rotation_of,
    row,
    sides,
    stretched,
    stretched_bent,
    swelled,
    swelled_bent,
    turned_back,
    warped,
    warped_bent,
)


@kernel
def energy_slope(layout, stiffness, points, turn, out):
    """U = ½ Σ k C², and its gradient.

    Args:
        layout: a `Layout`.
        stiffness: k of every constraint, [K].
        points: [N, 3].
        turn: quaternions of the shapes to begin at, [P, 4]; out: those found.
        out: gradient, added to, [N, 3].

    Returns:
        U.
    """
    starts, members, rest, offsets, firsts = layout
    slope = np.empty_like(offsets)
    total = 0.0
    for index in range(firsts[0]):
        one, other = members[2 * index], members[2 * index + 1]
        value, normal = stretched(points, one, other, rest[index])
        force = stiffness[index] * value
        total += 0.5 * force * value
        add(out, one, force, normal)
        add(out, other, -force, normal)
    for index in range(firsts[0], firsts[1]):
        if stiffness[index] == 0.0:
            continue
        first = starts[index]
        b, c, d = sides(points, members, first)
        value, by_b, by_c, by_d = swelled(b, c, d, rest[index])
        force = stiffness[index] * value
        total += 0.5 * force * value
        for corner, by in ((1, by_b), (2, by_c), (3, by_d)):
            add(out, members[first + corner], force, by)
            add(out, members[first], -force, by)
    for index in range(firsts[1], rest.shape[0]):
        if stiffness[index] == 0.0:
            continue
        value, _ = warped(starts, members, offsets, points, turn, index - firsts[1], index, slope)
        force = stiffness[index] * value
        total += 0.5 * force * value
        for m in range(starts[index], starts[index + 1]):
            add(out, members[m], force, row(slope, m))
    return total


@kernel
def energy_bend(layout, stiffness, points, turn, direction, out):
    """Second derivatives of U times a direction [N, 3], added to `out` [N, 3]; other arguments as in `energy_slope`."""
    starts, members, rest, offsets, firsts = layout
    slope, along, change = np.empty_like(offsets), np.empty_like(offsets), np.empty_like(offsets)
    for index in range(firsts[0]):
        one, other = members[2 * index], members[2 * index + 1]
        value, normal = stretched(points, one, other, rest[index])
        apart = less(direction, one, other)
        bent = stretched_bent(normal, value + rest[index], apart)
        ahead = stiffness[index] * dot(normal, apart)
        for particle, sign in ((one, 1.0), (other, -1.0)):
            add(out, particle, sign * ahead, normal)
            add(out, particle, sign * stiffness[index] * value, bent)
    for index in range(firsts[0], firsts[1]):
        if stiffness[index] == 0.0:
            continue
        first = starts[index]
        b, c, d = sides(points, members, first)
        db, dc, dd = sides(direction, members, first)
        value, by_b, by_c, by_d = swelled(b, c, d, rest[index])
        bent_b, bent_c, bent_d = swelled_bent(b, c, d, db, dc, dd)
        ahead = stiffness[index] * (dot(by_b, db) + dot(by_c, dc) + dot(by_d, dd))
        for corner, by, bent in ((1, by_b, bent_b), (2, by_c, bent_c), (3, by_d, bent_d)):
            for particle, sign in ((members[first + corner], 1.0), (members[first], -1.0)):
                add(out, particle, sign * ahead, by)
                add(out, particle, sign * stiffness[index] * value, bent)
    for index in range(firsts[1], rest.shape[0]):
        if stiffness[index] == 0.0:
            continue
        shape = index - firsts[1]
        value, matrix = warped(starts, members, offsets, points, turn, shape, index, slope)
        rotation = rotation_of((turn[shape, 0], turn[shape, 1], turn[shape, 2], turn[shape, 3]))
        ahead = 0.0
        for m in range(starts[index], starts[index + 1]):
            along[m, 0], along[m, 1], along[m, 2] = row(direction, members[m])
            ahead += dot(row(slope, m), row(along, m))
        left = turned_back(rotation, matrix)
        warped_bent(starts, offsets, rotation, left, index, slope, value, along, change)
        for m in range(starts[index], starts[index + 1]):
            add(out, members[m], stiffness[index] * ahead, row(slope, m))
            add(out, members[m], stiffness[index] * value, row(change, m))
