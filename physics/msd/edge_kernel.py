"""Compiled rollout on any spring mesh, spring by spring: forward, forward mode by θ, and the adjoint for fields.

Source: Bini 2026, equation 9 and table 1; equations and names as in `physics.msd.grid_kernel`. Vertices and springs are
sorted by their distance from the load, so what lies within a radius is a prefix of the arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from physics.jit import inlined, kernel


class Tissue(NamedTuple):
    """What may differ from place to place, or derivatives by it; n vertices, s springs."""

    stiffness: np.ndarray
    """k_s of each spring, shape [s]."""
    anchor: np.ndarray
    """Stiffness of each vertex's spring to its rest position, shape [n]."""
    keep: np.ndarray
    """Share of each vertex's velocity that damping leaves, 0 where it is held, shape [n]."""
    kick: np.ndarray
    """Velocity that a force gives each vertex, 0 where it is held, shape [n]."""


@inlined
def _difference(values, first, second):
    """Of two rows of values [n, 3]."""
    return (
        values[first, 0] - values[second, 0],
        values[first, 1] - values[second, 1],
        values[first, 2] - values[second, 2],
    )


@inlined
def _direction(displacement, graph, guard, spring):
    """Ends of one spring, its d, and α and β: g = α·d, ġ = α·δu̇ + β·(d·δu̇)·d."""
    near, far = graph.springs[spring, 0], graph.springs[spring, 1]
    stretch_x, stretch_y, stretch_z = _difference(displacement, far, near)
    rest_x, rest_y, rest_z = graph.rest[spring, 0], graph.rest[spring, 1], graph.rest[spring, 2]
    x, y, z = rest_x + stretch_x, rest_y + stretch_y, rest_z + stretch_z
    squared = x * x + y * y + z * z + guard
    now, length = np.sqrt(squared), graph.length[spring]
    stretched = (rest_x + x) * stretch_x + (rest_y + y) * stretch_y + (rest_z + z) * stretch_z
    return near, far, (x, y, z), stretched / (now * (now + length)), length / (squared * now)


@inlined
def _grip(displacement, load, step):
    """Put gripped vertices where they are in a step."""
    for index in range(load.gripped.shape[0]):
        for axis in range(3):
            displacement[load.gripped[index], axis] = load.positions[step, index, axis]


@inlined
def _forces(displacement, graph, stiffness, load, step, spring_count, guard, force):
    """Force of springs and load on each vertex in a step, written to `force` [n, 3]."""
    force[:] = 0
    for spring in range(spring_count):
        near, far, along, alpha, _ = _direction(displacement, graph, guard, spring)
        pull = stiffness[spring] * alpha
        for axis in range(3):
            force[near, axis] += pull * along[axis]
            force[far, axis] -= pull * along[axis]
    for index in range(load.pressed.shape[0]):
        for axis in range(3):
            force[load.pressed[index], axis] += load.factor[step] * load.push[index, axis]


@inlined
def _show(trajectory, displacement, velocity, watched, step, lag):
    """Note where the watched vertices are after a step."""
    for index in range(watched.shape[0]):
        for axis in range(3):
            trajectory[step, index, axis] = displacement[watched[index], axis] - lag * velocity[watched[index], axis]


@kernel
def edge_forward(graph, counts, spring_counts, tissue, load, watched, numbers, trajectory, speeds):
    """Roll out with a stiffness per spring and a damping per vertex.

    Args:
        graph: a `SpringGraph`.
        counts, spring_counts: vertices and springs that each step computes, [T].
        tissue: a `Tissue`.
        load: `Acting` on the graph's vertices, with F in its push; gripped ones have keep and kick 0.
        watched: vertices, [M].
        numbers: Δt, lag, tiny, guard.
        trajectory: out, displacement of the watched vertices, [T, M, 3].
        speeds: out, velocities after each step, [T, n, 3], or [0, n, 3].
    """
    time_step, lag, tiny, guard = numbers
    displacement = np.zeros((tissue.keep.shape[0], 3), tissue.keep.dtype)
    velocity, force = np.zeros_like(displacement), np.zeros_like(displacement)
    for step in range(counts.shape[0]):
        count = counts[step]
        _grip(displacement, load, step)
        _forces(displacement, graph, tissue.stiffness, load, step, spring_counts[step], guard, force)
        for vertex in range(count):
            for axis in range(3):
                total = force[vertex, axis] - tissue.anchor[vertex] * displacement[vertex, axis]
                value = tissue.keep[vertex] * velocity[vertex, axis] + tissue.kick[vertex] * total
                value = tiny - tiny if abs(value) < tiny else value
                velocity[vertex, axis] = value
                displacement[vertex, axis] += time_step * value
        _show(trajectory, displacement, velocity, watched, step, lag)
        if speeds.shape[0] > 0:
            speeds[step, :count] = velocity[:count]


@inlined
def _elastic_tangents(displacement, moved, graph, spring_count, guard, force, turned):
    """Add g to `force` [n, 3] and ġ of the three parameters to `turned` [n, 3 axes, 3 parameters]."""
    for spring in range(spring_count):
        near, far, along, alpha, beta = _direction(displacement, graph, guard, spring)
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
def edge_sensitivity(graph, counts, spring_counts, free, load, watched, force_size, numbers, out):
    """Roll out with uniform parameters and carry ∂/∂(k_s, k_d, F) along.

    Args:
        graph, counts, spring_counts, watched: as in `edge_forward`.
        free: 1 where a vertex may move, else 0, [n].
        load: as in `edge_forward`, but without F in its push.
        force_size: F.
        numbers: as in `physics.msd.grid_kernel`: k_s, keep, kick, their slopes by k_d, Δt, anchor, lag, tiny, guard.
        out: a `physics.msd.compiled.Watched` to fill.
    """
    stiffness, keep, kick, keep_slope, kick_slope, time_step, anchor, lag, tiny, guard = numbers
    displacement = np.zeros((free.shape[0], 3), free.dtype)
    velocity, elastic = np.zeros_like(displacement), np.zeros_like(displacement)
    moved = np.zeros((free.shape[0], 3, 3), free.dtype)
    speed, turned = np.zeros_like(moved), np.zeros_like(moved)
    push = np.zeros_like(displacement)
    for index in range(load.pressed.shape[0]):
        for axis in range(3):
            push[load.pressed[index], axis] += load.push[index, axis]
    for step in range(counts.shape[0]):
        elastic[:] = 0
        turned[:] = 0
        _grip(displacement, load, step)
        _elastic_tangents(displacement, moved, graph, spring_counts[step], guard, elastic, turned)
        for vertex in range(counts[step]):
            for axis in range(3):
                pull = elastic[vertex, axis] - anchor * displacement[vertex, axis]
                push_now = load.factor[step] * push[vertex, axis]
                total = stiffness * pull + force_size * push_now
                before = velocity[vertex, axis]
                own = kick * pull, keep_slope * before + kick_slope * total, kick * push_now
                for parameter in range(3):
                    bend = turned[vertex, axis, parameter] - anchor * moved[vertex, axis, parameter]
                    value = keep * speed[vertex, axis, parameter] + kick * stiffness * bend + own[parameter]
                    value *= free[vertex]
                    value = tiny - tiny if abs(value) < tiny else value
                    speed[vertex, axis, parameter] = value
                    moved[vertex, axis, parameter] += time_step * value
                value = free[vertex] * (keep * before + kick * total)
                value = tiny - tiny if abs(value) < tiny else value
                velocity[vertex, axis] = value
                displacement[vertex, axis] += time_step * value
        _show(out.path, displacement, velocity, watched, step, lag)
        for index in range(watched.shape[0]):
            for axis in range(3):
                for parameter in range(3):
                    value = moved[watched[index], axis, parameter] - lag * speed[watched[index], axis, parameter]
                    out.slopes[step, index, axis, parameter] = value
        for index in range(load.gripped.shape[0]):
            for axis in range(3):
                pull = elastic[load.gripped[index], axis] - anchor * load.positions[step, index, axis]
                out.elastic[step, index, axis] = stiffness * pull
                for parameter in range(3):
                    bend = turned[load.gripped[index], axis, parameter]
                    out.elastic_slopes[step, index, axis, parameter] = stiffness * bend
                out.elastic_slopes[step, index, axis, 0] += pull


@inlined
def _elastic_adjoint(displacement, pushed, graph, stiffness, spring_count, guard, pulled, slope):
    """Chain the adjoint of the force, `pushed` [n, 3], on to displacements (`pulled`) and stiffness (`slope` [s])."""
    for spring in range(spring_count):
        near, far, along, alpha, beta = _direction(displacement, graph, guard, spring)
        across = _difference(pushed, near, far)
        turn = along[0] * across[0] + along[1] * across[1] + along[2] * across[2]
        slope[spring] += alpha * turn
        pull, bend = stiffness[spring] * alpha, stiffness[spring] * beta * turn
        for axis in range(3):
            value = pull * across[axis] + bend * along[axis]
            pulled[far, axis] += value
            pulled[near, axis] -= value


@inlined
def _kick_adjoint(force, before, tissue, placed, carried, pushed, count, time_step, slopes):
    """Chain the adjoints of displacement and velocity, `placed` and `carried` [n, 3], through v⁺ = keep·v + kick·f.

    The adjoint of f goes to `pushed` [n, 3], that of v to `carried`; `before` is v, [n, 3].
    """
    for vertex in range(count):
        for axis in range(3):
            value = carried[vertex, axis] + time_step * placed[vertex, axis]
            slopes.keep[vertex] += value * before[vertex, axis]
            slopes.kick[vertex] += value * force[vertex, axis]
            pushed[vertex, axis] = tissue.kick[vertex] * value
            carried[vertex, axis] = tissue.keep[vertex] * value


@kernel
def edge_adjoint(graph, counts, spring_counts, tissue, load, watched, numbers, final, speeds, weights, slopes):
    """Go back through `edge_forward` and gather the slopes of Σ weights·trajectory.

    Args:
        graph … numbers: as given to `edge_forward`; displacements are run backwards from the velocities it stored.
        final: displacements after the last step, without the lag, [n, 3]; used up.
        speeds: velocities after each step, [T, n, 3].
        weights: derivative of the loss by the trajectory, [T, M, 3].
        slopes: out, a `Tissue` of the derivatives.

    Returns:
        Derivative by the load's push, [P, 3].
    """
    time_step, lag, _, guard = numbers
    displacement = final
    placed, carried = np.zeros_like(displacement), np.zeros_like(displacement)
    pushed, force = np.zeros_like(displacement), np.zeros_like(displacement)
    by_push = np.zeros_like(load.push)
    for step in range(counts.shape[0] - 1, -1, -1):
        count = counts[step]
        for index in range(watched.shape[0]):
            for axis in range(3):
                placed[watched[index], axis] += weights[step, index, axis]
                carried[watched[index], axis] -= lag * weights[step, index, axis]
        for vertex in range(count):
            for axis in range(3):
                displacement[vertex, axis] -= time_step * speeds[step, vertex, axis]
        pushed[:] = 0
        _grip(displacement, load, step)
        _forces(displacement, graph, tissue.stiffness, load, step, spring_counts[step], guard, force)
        before = speeds[step - 1] if step > 0 else np.zeros_like(displacement)
        force -= tissue.anchor.reshape(-1, 1) * displacement
        _kick_adjoint(force, before, tissue, placed, carried, pushed, count, time_step, slopes)
        for vertex in range(count):
            for axis in range(3):
                slopes.anchor[vertex] -= pushed[vertex, axis] * displacement[vertex, axis]
                placed[vertex, axis] -= tissue.anchor[vertex] * pushed[vertex, axis]
        for index in range(load.pressed.shape[0]):
            for axis in range(3):
                by_push[index, axis] += load.factor[step] * pushed[load.pressed[index], axis]
        _elastic_adjoint(
            displacement, pushed, graph, tissue.stiffness, spring_counts[step], guard, placed, slopes.stiffness
        )
        for index in range(load.gripped.shape[0]):  # where they are doesn't depend on anything
            for axis in range(3):
                placed[load.gripped[index], axis] = 0
    return by_push
