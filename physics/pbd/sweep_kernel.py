"""Compiled time steps of position-based dynamics, and the adjoint through all their sweeps.

Source: Liang 2024, equation 3; equations and names as in `physics.pbd.reference`.
"""

from __future__ import annotations

import numpy as np

from physics.jit import inlined, kernel
from physics.pbd.constraint_kernel import bent, evaluated


@inlined
def _begun(before, speed, inverse_mass, rest, numbers, acceleration, gripped, places, points):
    """Where a step's sweeps begin: free particles carried on, gripped ones placed; written to `points` [N, 3].

    The foundation is part of the inertia: both are squares of one particle's way, whose sum is one such square.
    """
    time_step, keep, foundation = numbers
    for particle in range(points.shape[0]):
        free = 1.0 if inverse_mass[particle] > 0 else 0.0
        back = foundation * inverse_mass[particle]
        for axis in range(3):
            carried = time_step * keep * speed[particle, axis] + time_step * time_step * acceleration[axis]
            ahead = before[particle, axis] + free * carried
            points[particle, axis] = ahead + back * (rest[particle, axis] - ahead)
    for index in range(gripped.shape[0]):
        for axis in range(3):
            points[gripped[index], axis] = places[index, axis]


@inlined
def _mobility(layout, inverse_mass, slope, index):
    """∇C M⁻¹ ∇Cᵀ of one constraint."""
    total = 0.0
    for m in range(layout.starts[index], layout.starts[index + 1]):
        size = slope[m, 0] * slope[m, 0] + slope[m, 1] * slope[m, 1] + slope[m, 2] * slope[m, 2]
        total += inverse_mass[layout.members[m]] * size
    return total


@inlined
def _pushed(layout, inverse_mass, slope, index, step, points):
    """Move the particles of one constraint by M⁻¹ ∇Cᵀ Δλ."""
    for m in range(layout.starts[index], layout.starts[index + 1]):
        particle = layout.members[m]
        for axis in range(3):
            points[particle, axis] += inverse_mass[particle] * slope[m, axis] * step


@kernel
def sweep_forward(
    layout, weight, inverse_mass, rest, speed, gripped, path, numbers, acceleration, iterations, turn, motion
):
    """Step B bodies on.

    Args:
        layout: a `Layout`.
        weight: k Δt² of every constraint, [B, K].
        inverse_mass: of a particle with its foundation, 1/(m + f Δt²), [N].
        rest: where the foundation pulls to, [N, 3].
        speed: velocities at the start, [B, N, 3].
        gripped: particles, [G].
        path: where they are after each step, [B, T, G, 3].
        numbers: Δt, share of the velocity that is kept, f Δt².
        acceleration: [3].
        iterations: sweeps a step.
        turn: quaternions of the shapes to begin at, [B, P, 4]; used up.
        motion: positions, the start filled in; out: after each step, [B, T + 1, N, 3].

    Returns:
        Largest change of a multiplier in the last sweep of every step, [B, T].
    """
    batch, steps = motion.shape[0], motion.shape[1] - 1
    slope = np.zeros_like(layout.offsets)
    multipliers = np.zeros(layout.rest.shape[0])
    last = np.zeros((batch, steps))
    now = np.zeros_like(speed[0])
    for b in range(batch):
        now[:] = speed[b]
        for t in range(steps):
            points, before = motion[b, t + 1], motion[b, t]
            _begun(before, now, inverse_mass, rest, numbers, acceleration, gripped, path[b, t], points)
            multipliers[:] = 0
            for _ in range(iterations):
                last[b, t] = 0.0
                for index in range(layout.rest.shape[0]):
                    if weight[b, index] == 0.0:
                        continue
                    value = evaluated(layout, points, turn[b], index, slope)
                    give = weight[b, index] * _mobility(layout, inverse_mass, slope, index) + 1
                    step = -(weight[b, index] * value + multipliers[index]) / give
                    multipliers[index] += step
                    last[b, t] = max(last[b, t], abs(step))
                    _pushed(layout, inverse_mass, slope, index, step, points)
            for particle in range(now.shape[0]):
                for axis in range(3):
                    now[particle, axis] = (points[particle, axis] - before[particle, axis]) / numbers[0]
    return last


@kernel
def sweep_adjoint(
    layout,
    weight,
    inverse_mass,
    rest,
    speed,
    gripped,
    path,
    numbers,
    acceleration,
    iterations,
    turn,
    motion,
    pulls,
    slopes,
):
    """Go back through `sweep_forward` and gather the derivatives of Σ pulls·motion.

    Every step is repeated from the positions before it, with what its sweeps met kept; then they are gone back through
    one constraint at a time, by the chain rule of what was computed: no linear system, nothing left out.

    Args:
        layout … acceleration, iterations: as given to `sweep_forward`.
        turn: quaternions to begin at, [B, P, 4]; used up.
        motion: what it wrote.
        pulls: derivatives by it, [B, T + 1, N, 3]; out: its first step becomes that by the start.
        slopes: out, derivatives by the weights [B, K].

    Returns:
        Derivatives by the velocities at the start, [B, N, 3].
    """
    batch, steps, count = motion.shape[0], motion.shape[1] - 1, motion.shape[2]
    constraints, members = layout.rest.shape[0], layout.members.shape[0]
    slope, held = np.zeros((iterations, members, 3)), np.zeros((iterations, members, 3))
    value, begun = np.zeros((iterations, constraints)), np.zeros((iterations, constraints))
    turns = np.zeros((iterations, turn.shape[1], 4))
    along, change = np.zeros((members, 3)), np.zeros((members, 3))
    points, before = np.zeros((count, 3)), np.zeros((count, 3))
    multipliers, pulled = np.zeros(constraints), np.zeros(constraints)
    by_speed = np.zeros_like(speed)
    for b in range(batch):
        for t in range(steps - 1, -1, -1):
            if t > 0:
                for particle in range(count):
                    for axis in range(3):
                        moved = motion[b, t, particle, axis] - motion[b, t - 1, particle, axis]
                        before[particle, axis] = moved / numbers[0]
            else:
                before[:] = speed[b]
            _begun(motion[b, t], before, inverse_mass, rest, numbers, acceleration, gripped, path[b, t], points)
            multipliers[:] = 0
            for sweep in range(iterations):
                if sweep > 0:
                    turns[sweep] = turns[sweep - 1]
                else:
                    turns[0] = turn[b]
                for index in range(constraints):
                    for m in range(layout.starts[index], layout.starts[index + 1]):
                        for axis in range(3):
                            held[sweep, m, axis] = points[layout.members[m], axis]
                    value[sweep, index] = evaluated(layout, points, turns[sweep], index, slope[sweep])
                    begun[sweep, index] = multipliers[index]
                    give = weight[b, index] * _mobility(layout, inverse_mass, slope[sweep], index) + 1
                    step = -(weight[b, index] * value[sweep, index] + multipliers[index]) / give
                    multipliers[index] += step
                    _pushed(layout, inverse_mass, slope[sweep], index, step, points)
            turn[b] = turns[iterations - 1]
            pull = pulls[b, t + 1]
            for particle in range(count):  # v = (x - x before)/Δt, which the step after this one began with
                for axis in range(3):
                    pull[particle, axis] += by_speed[b, particle, axis] / numbers[0]
                    pulls[b, t, particle, axis] -= by_speed[b, particle, axis] / numbers[0]
            pulled[:] = 0
            for sweep in range(iterations - 1, -1, -1):
                for index in range(constraints - 1, -1, -1):
                    first, last = layout.starts[index], layout.starts[index + 1]
                    for m in range(first, last):
                        for axis in range(3):
                            points[layout.members[m], axis] = held[sweep, m, axis]
                    mobility = _mobility(layout, inverse_mass, slope[sweep], index)
                    give = weight[b, index] * mobility + 1
                    step = -(weight[b, index] * value[sweep, index] + begun[sweep, index]) / give
                    by_step = pulled[index]
                    for m in range(first, last):
                        particle = layout.members[m]
                        for axis in range(3):
                            by_step += inverse_mass[particle] * slope[sweep, m, axis] * pull[particle, axis]
                    slopes[b, index] -= by_step * (value[sweep, index] + mobility * step) / give
                    pulled[index] -= by_step / give
                    by_value = -weight[b, index] * by_step / give
                    by_mobility = by_value * step
                    for m in range(first, last):
                        particle = layout.members[m]
                        for axis in range(3):
                            ahead = step * pull[particle, axis] + 2 * by_mobility * slope[sweep, m, axis]
                            along[m, axis] = inverse_mass[particle] * ahead
                    bent(layout, points, turns[sweep], index, slope[sweep], value[sweep, index], along, change)
                    for m in range(first, last):
                        particle = layout.members[m]
                        for axis in range(3):
                            pull[particle, axis] += by_value * slope[sweep, m, axis] + change[m, axis]
            for index in range(gripped.shape[0]):  # where they are doesn't depend on anything
                for axis in range(3):
                    pull[gripped[index], axis] = 0.0
            for particle in range(count):
                free = 1.0 if inverse_mass[particle] > 0 else 0.0
                left = 1.0 - numbers[2] * inverse_mass[particle]  # the rest of its way is the foundation's
                for axis in range(3):
                    pulls[b, t, particle, axis] += left * pull[particle, axis]
                    by_speed[b, particle, axis] = free * left * numbers[0] * numbers[1] * pull[particle, axis]
    return by_speed
