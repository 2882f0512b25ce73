"""Compiled rollout on any spring mesh, spring by spring: forward, forward mode by θ, and the adjoint for fields.

Source: Bini 2026, equation 9 and table 1; equations and names as in `physics.msd.grid_kernel`. Vertices and springs are
sorted by their distance from the load, so what lies within a radius is a prefix of the arrays.
"""

from __future__ import annotations

import numpy as np

from physics.jit import inlined, kernel


@inlined
def _direction(displacement, springs, rest, length, guard, spring):
    """d of one spring, and α and β: g = α·d, ġ = α·δu̇ + β·(d·δu̇)·d."""
    near, far = springs[spring, 0], springs[spring, 1]
    stretch_x = displacement[far, 0] - displacement[near, 0]
    stretch_y = displacement[far, 1] - displacement[near, 1]
    stretch_z = displacement[far, 2] - displacement[near, 2]
    rest_x, rest_y, rest_z = rest[spring, 0], rest[spring, 1], rest[spring, 2]
    x, y, z = rest_x + stretch_x, rest_y + stretch_y, rest_z + stretch_z
    squared = x * x + y * y + z * z + guard
    now = np.sqrt(squared)
    stretched = (rest_x + x) * stretch_x + (rest_y + y) * stretch_y + (rest_z + z) * stretch_z
    return near, far, x, y, z, stretched / (now * (now + length[spring])), length[spring] / (squared * now)


@inlined
def _elastic(displacement, springs, rest, length, stiffness, spring_count, guard, force):
    """Add the springs' force to `force` [n, 3]."""
    for spring in range(spring_count):
        near, far, x, y, z, alpha, _ = _direction(displacement, springs, rest, length, guard, spring)
        pull = stiffness[spring] * alpha
        force[near, 0] += pull * x
        force[near, 1] += pull * y
        force[near, 2] += pull * z
        force[far, 0] -= pull * x
        force[far, 1] -= pull * y
        force[far, 2] -= pull * z


@inlined
def _grip(displacement, velocity, gripped, positions, step):
    """Put gripped vertices where they are in a step; they have no velocity of their own."""
    for index in range(gripped.shape[0]):
        for axis in range(3):
            displacement[gripped[index], axis] = positions[step, index, axis]
            velocity[gripped[index], axis] = 0


@inlined
def _show(trajectory, displacement, velocity, watched, step, lag):
    """Note where the watched vertices are after a step."""
    for index in range(watched.shape[0]):
        for axis in range(3):
            trajectory[step, index, axis] = displacement[watched[index], axis] - lag * velocity[watched[index], axis]


@kernel
def edge_forward(
    springs,
    rest,
    length,
    stiffness,
    anchor,
    keep,
    kick,
    counts,
    spring_counts,
    load,
    loaded,
    push,
    gripped,
    positions,
    watched,
    numbers,
    trajectory,
    speeds,
    field,
):
    """Roll out with a stiffness per spring and a damping per vertex.

    Args:
        springs, rest, length: of the `SpringGraph`.
        stiffness: k_s of each spring, [s].
        anchor: stiffness of the spring to the rest position, [n].
        keep, kick: coefficients of each vertex's step, 0 where it is held, [n].
        counts, spring_counts: vertices and springs that each step computes, [T].
        load: factor of F in each step, [T].
        loaded, push: pressed vertices and F·weight·direction of each, [P] and [P, 3].
        gripped, positions: gripped vertices, whose keep and kick are 0, and where they are in each step, [G] and
            [T, G, 3].
        watched: vertices, [M].
        numbers: Δt, lag, tiny, guard.
        trajectory: out, displacement of the watched vertices, [T, M, 3].
        speeds: out, velocities after each step, [T, n, 3], or [0, n, 3].
        field: out, displacements after each step, [T, n, 3], or [0, n, 3].
    """
    time_step, lag, tiny, guard = numbers
    displacement = np.zeros((keep.shape[0], 3), keep.dtype)
    velocity, force = np.zeros_like(displacement), np.zeros_like(displacement)
    for step in range(load.shape[0]):
        count = counts[step]
        force[:] = 0
        _grip(displacement, velocity, gripped, positions, step)
        _elastic(displacement, springs, rest, length, stiffness, spring_counts[step], guard, force)
        for index in range(loaded.shape[0]):
            for axis in range(3):
                force[loaded[index], axis] += load[step] * push[index, axis]
        for vertex in range(count):
            for axis in range(3):
                total = force[vertex, axis] - anchor[vertex] * displacement[vertex, axis]
                value = keep[vertex] * velocity[vertex, axis] + kick[vertex] * total
                value = tiny - tiny if abs(value) < tiny else value
                velocity[vertex, axis] = value
                displacement[vertex, axis] += time_step * value
        _show(trajectory, displacement, velocity, watched, step, lag)
        if speeds.shape[0] > 0:
            speeds[step, :count] = velocity[:count]
        if field.shape[0] > 0:
            field[step] = displacement - lag * velocity


@inlined
def _elastic_tangents(displacement, moved, springs, rest, length, spring_count, guard, force, turned):
    """Add g to `force` [n, 3] and ġ of the three parameters to `turned` [n, 3 axes, 3 parameters]."""
    for spring in range(spring_count):
        near, far, x, y, z, alpha, beta = _direction(displacement, springs, rest, length, guard, spring)
        along = (x, y, z)
        for axis in range(3):
            force[near, axis] += alpha * along[axis]
            force[far, axis] -= alpha * along[axis]
        for parameter in range(3):
            turn = guard - guard
            for axis in range(3):
                turn += along[axis] * (moved[far, axis, parameter] - moved[near, axis, parameter])
            for axis in range(3):
                stretch = moved[far, axis, parameter] - moved[near, axis, parameter]
                pull = alpha * stretch + beta * turn * along[axis]
                turned[near, axis, parameter] += pull
                turned[far, axis, parameter] -= pull


@kernel
def edge_sensitivity(
    springs, rest, length, free, counts, spring_counts, load, loaded, push, gripped, positions, watched, force_size,
    numbers, trajectory, jacobian, elastic_out, elastic_slopes,
):  # fmt: skip
    """Roll out with uniform parameters and carry ∂/∂(k_s, k_d, F) along.

    Args:
        springs, rest, length: of the `SpringGraph`.
        free: 1 where a vertex may move, else 0, [n].
        counts, spring_counts: vertices and springs that each step computes, [T].
        load … watched: as in `edge_forward`, but `push` is weight·direction, without F.
        force_size: F.
        numbers: as in `physics.msd.grid_kernel`: k_s, keep, kick, their slopes by k_d, Δt, anchor, lag, tiny, guard.
        trajectory: out, [T, M, 3].
        jacobian: out, [T, M, 3, 3].
        elastic_out, elastic_slopes: out, force on the gripped vertices and its derivatives, [T, G, 3] and [T, G, 3, 3].
    """
    stiffness, keep, kick, keep_slope, kick_slope, time_step, anchor, lag, tiny, guard = numbers
    displacement = np.zeros((free.shape[0], 3), free.dtype)
    velocity, elastic = np.zeros_like(displacement), np.zeros_like(displacement)
    moved = np.zeros((free.shape[0], 3, 3), free.dtype)
    speed, turned = np.zeros_like(moved), np.zeros_like(moved)
    pressed = np.zeros_like(displacement)
    for index in range(loaded.shape[0]):
        for axis in range(3):
            pressed[loaded[index], axis] += push[index, axis]
    for step in range(load.shape[0]):
        elastic[:] = 0
        turned[:] = 0
        _grip(displacement, velocity, gripped, positions, step)
        _elastic_tangents(displacement, moved, springs, rest, length, spring_counts[step], guard, elastic, turned)
        for vertex in range(counts[step]):
            for axis in range(3):
                pull = elastic[vertex, axis] - anchor * displacement[vertex, axis]
                push_now = load[step] * pressed[vertex, axis]
                total = stiffness * pull + force_size * push_now
                before = velocity[vertex, axis]
                for parameter in range(3):
                    bend = turned[vertex, axis, parameter] - anchor * moved[vertex, axis, parameter]
                    value = keep * speed[vertex, axis, parameter] + kick * stiffness * bend
                    if parameter == 0:
                        value += kick * pull
                    elif parameter == 1:
                        value += keep_slope * before + kick_slope * total
                    else:
                        value += kick * push_now
                    value *= free[vertex]
                    value = tiny - tiny if abs(value) < tiny else value
                    speed[vertex, axis, parameter] = value
                    moved[vertex, axis, parameter] += time_step * value
                value = free[vertex] * (keep * before + kick * total)
                value = tiny - tiny if abs(value) < tiny else value
                velocity[vertex, axis] = value
                displacement[vertex, axis] += time_step * value
        _show(trajectory, displacement, velocity, watched, step, lag)
        for index in range(watched.shape[0]):
            vertex = watched[index]
            for axis in range(3):
                for parameter in range(3):
                    value = moved[vertex, axis, parameter] - lag * speed[vertex, axis, parameter]
                    jacobian[step, index, axis, parameter] = value
        for index in range(gripped.shape[0]):
            vertex = gripped[index]
            for axis in range(3):
                pull = elastic[vertex, axis] - anchor * positions[step, index, axis]
                elastic_out[step, index, axis] = stiffness * pull
                for parameter in range(3):
                    elastic_slopes[step, index, axis, parameter] = stiffness * turned[vertex, axis, parameter]
                elastic_slopes[step, index, axis, 0] += pull


@inlined
def _elastic_adjoint(displacement, pushed, springs, rest, length, stiffness, spring_count, guard, pulled, slope):
    """Chain the adjoint of the force, `pushed` [n, 3], on to displacements (`pulled`) and stiffness (`slope` [s])."""
    for spring in range(spring_count):
        near, far, x, y, z, alpha, beta = _direction(displacement, springs, rest, length, guard, spring)
        along_x = pushed[near, 0] - pushed[far, 0]
        along_y = pushed[near, 1] - pushed[far, 1]
        along_z = pushed[near, 2] - pushed[far, 2]
        turn = x * along_x + y * along_y + z * along_z
        slope[spring] += alpha * turn
        pull, bend = stiffness[spring] * alpha, stiffness[spring] * beta * turn
        pulled[far, 0] += pull * along_x + bend * x
        pulled[far, 1] += pull * along_y + bend * y
        pulled[far, 2] += pull * along_z + bend * z
        pulled[near, 0] -= pull * along_x + bend * x
        pulled[near, 1] -= pull * along_y + bend * y
        pulled[near, 2] -= pull * along_z + bend * z


@inlined
def _kick_adjoint(force, before, keep, kick, placed, carried, pushed, count, time_step, keep_slope, kick_slope):
    """Chain the adjoints of displacement and velocity, `placed` and `carried` [n, 3], through v⁺ = keep·v + kick·f.

    The adjoint of f goes to `pushed` [n, 3], that of v to `carried`; `before` is v, [n, 3].
    """
    for vertex in range(count):
        for axis in range(3):
            value = carried[vertex, axis] + time_step * placed[vertex, axis]
            keep_slope[vertex] += value * before[vertex, axis]
            kick_slope[vertex] += value * force[vertex, axis]
            pushed[vertex, axis] = kick[vertex] * value
            carried[vertex, axis] = keep[vertex] * value


@kernel
def edge_adjoint(
    springs,
    rest,
    length,
    stiffness,
    anchor,
    keep,
    kick,
    counts,
    spring_counts,
    load,
    loaded,
    push,
    gripped,
    positions,
    watched,
    numbers,
    final,
    speeds,
    weights,
    slope,
    anchor_slope,
    keep_slope,
    kick_slope,
):
    """Go back through `edge_forward` and gather the slopes of Σ weights·trajectory.

    Args:
        springs … numbers: as given to `edge_forward`; displacements are run backwards from the velocities it stored.
        final: displacements after the last step, without the lag, [n, 3]; used up.
        speeds: velocities after each step, [T, n, 3].
        weights: derivative of the loss by the trajectory, [T, M, 3].
        slope: out, by the springs' stiffness, [s].
        anchor_slope, keep_slope, kick_slope: out, by the vertices' anchor, keep and kick, [n].

    Returns:
        Derivative by `push`, [P, 3].
    """
    time_step, lag, _, guard = numbers
    displacement = final
    placed, carried = np.zeros_like(displacement), np.zeros_like(displacement)
    pushed, force = np.zeros_like(displacement), np.zeros_like(displacement)
    by_push = np.zeros((loaded.shape[0], 3), keep.dtype)
    for step in range(load.shape[0] - 1, -1, -1):
        count = counts[step]
        for index in range(watched.shape[0]):
            for axis in range(3):
                placed[watched[index], axis] += weights[step, index, axis]
                carried[watched[index], axis] -= lag * weights[step, index, axis]
        for vertex in range(count):
            for axis in range(3):
                displacement[vertex, axis] -= time_step * speeds[step, vertex, axis]
        force[:] = 0
        pushed[:] = 0
        for index in range(gripped.shape[0]):
            for axis in range(3):
                displacement[gripped[index], axis] = positions[step, index, axis]
        _elastic(displacement, springs, rest, length, stiffness, spring_counts[step], guard, force)
        for index in range(loaded.shape[0]):
            for axis in range(3):
                force[loaded[index], axis] += load[step] * push[index, axis]
        before = speeds[step - 1] if step > 0 else np.zeros_like(displacement)
        force -= anchor.reshape(-1, 1) * displacement
        _kick_adjoint(force, before, keep, kick, placed, carried, pushed, count, time_step, keep_slope, kick_slope)
        for vertex in range(count):
            for axis in range(3):
                anchor_slope[vertex] -= pushed[vertex, axis] * displacement[vertex, axis]
                placed[vertex, axis] -= anchor[vertex] * pushed[vertex, axis]
        for index in range(loaded.shape[0]):
            for axis in range(3):
                by_push[index, axis] += load[step] * pushed[loaded[index], axis]
        _elastic_adjoint(
            displacement, pushed, springs, rest, length, stiffness, spring_counts[step], guard, placed, slope
        )
        for index in range(gripped.shape[0]):  # where they are doesn't depend on anything
            for axis in range(3):
                placed[gripped[index], axis] = 0
    return by_push
