"""Compiled rollout on a grid layout, with the exact derivatives by θ carried along (forward mode).

Source: Bini 2026, equation 9 and table 1; equations and names as in `physics.msd.reference`. With the spring force for
unit stiffness g(u) and the load p, a step is v⁺ = a·v + b·(k_s·g + F·p), u⁺ = u + Δt·v⁺. A derivative by one parameter,
written with a dot, follows v̇⁺ = a·v̇ + b·k_s·ġ + ȧ·v + ḃ·(k_s·g + F·p) + b·(k̇_s·g + Ḟ·p), u̇⁺ = u̇ + Δt·v̇⁺.
A spring d = d₀ + δu of length ℓ gives g = α·d with α = (ℓ − ℓ₀)/ℓ, and ġ = α·δu̇ + β·(d·δu̇)·d with β = ℓ₀/ℓ³.

A state holds, row by row, the planes u and v (x, y, z each) and with sensitivities nine planes of u̇ (by k_s, k_d, F;
x, y, z each) and nine of v̇. `pitch` and `sensitive` become constants where everything is copied into `specialised`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from physics.jit import inlined, kernel
from physics.msd.grid_layout import LENGTH, LINK, MOBILE, REST_PLANES

FORWARD_PLANES, SENSITIVITY_PLANES = 6, 24
"""Planes of a state without and with derivatives."""

# Unsigned: numba reads a signed index below 0 from the end, and that choice would keep the loops from being vectorised.
ONE, TWO, THREE, FOUR, FIVE, SIX, NINE = map(np.uint64, (1, 2, 3, 4, 5, 6, 9))
TWELVE, FIFTEEN, EIGHTEEN, TWENTYONE = map(np.uint64, (12, 15, 18, 21))


@functools.cache
def specialised(pitch: int, sensitive: bool) -> Callable:
    """The compiled rollout for one row length.

    Args:
        pitch: row length of the layout.
        sensitive: whether ∂/∂(k_s, k_d, F) is carried along.

    Returns:
        `_rollout` without its last two arguments.
    """

    @kernel
    def rollout(
        rest, first, last, centre, radii, load, loaded, push, gripped, positions, watched, force, numbers, runs,
        trajectory, jacobian, elastic, elastic_slopes, field, begin,
    ):  # fmt: skip
        layout, acts = (rest, first, last, centre), (load, loaded, push, gripped, positions)
        out = trajectory, jacobian, elastic, elastic_slopes, field, begin
        _rollout(*layout, radii, *acts, watched, force, numbers, runs, *out, pitch, sensitive)

    return rollout


@inlined
def _tangent_pull(near, far, out, state, force, x, y, z, alpha, beta, pitch):
    """ġ of one spring for one parameter; (x, y, z) is d."""
    along_x = far[state] - near[state]
    along_y = far[state + pitch] - near[state + pitch]
    along_z = far[state + TWO * pitch] - near[state + TWO * pitch]
    turn = beta * (x * along_x + y * along_y + z * along_z)
    out[force] = alpha * along_x + turn * x
    out[force + pitch] = alpha * along_y + turn * y
    out[force + TWO * pitch] = alpha * along_z + turn * z


@inlined
def _pull(near, far, rest_near, rest_far, length, link, out, count, guard, pitch, sensitive):
    """g, and ġ, of `count` springs side by side, all in one direction."""
    pitch = np.uint64(pitch)
    for i in range(np.uint64(count)):
        rest_x = rest_far[i] - rest_near[i]
        rest_y = rest_far[pitch + i] - rest_near[pitch + i]
        rest_z = rest_far[TWO * pitch + i] - rest_near[TWO * pitch + i]
        stretch_x = far[i] - near[i]
        stretch_y = far[pitch + i] - near[pitch + i]
        stretch_z = far[TWO * pitch + i] - near[TWO * pitch + i]
        x, y, z = rest_x + stretch_x, rest_y + stretch_y, rest_z + stretch_z
        squared = x * x + y * y + z * z + guard
        now = np.sqrt(squared)
        total = now + length[i]
        stretched = (rest_x + x) * stretch_x + (rest_y + y) * stretch_y + (rest_z + z) * stretch_z
        # One division serves both: α = stretched/(ℓ(ℓ+ℓ₀)), β = ℓ₀/ℓ³.
        shared = link[i] / (squared * now * total)
        alpha = stretched * squared * shared
        out[i] = alpha * x
        out[pitch + i] = alpha * y
        out[TWO * pitch + i] = alpha * z
        if sensitive:
            beta = length[i] * total * shared
            _tangent_pull(near, far, out, SIX * pitch + i, THREE * pitch + i, x, y, z, alpha, beta, pitch)
            _tangent_pull(near, far, out, NINE * pitch + i, SIX * pitch + i, x, y, z, alpha, beta, pitch)
            _tangent_pull(near, far, out, TWELVE * pitch + i, NINE * pitch + i, x, y, z, alpha, beta, pitch)


@inlined
def _net(right, left, down, up, diagonal, back, i):
    """Sum over the six springs of a vertex."""
    return right[i] - left[i] + down[i] - up[i] + diagonal[i] - back[i]


@inlined
def _drift(state, displacement, velocity, value, time_step, tiny):
    """Store a velocity and move by it; what is too small to mean anything becomes 0, because denormals are slow."""
    value = tiny - tiny if abs(value) < tiny else value
    state[velocity] = value
    state[displacement] += time_step * value


@inlined
def _kick_axis(state, right, left, down, up, diagonal, back, i, free, numbers, pitch, sensitive):
    """New velocities and displacements of a vertex along one axis; i = axis·pitch + column, free = 1 if it moves."""
    stiffness, keep, kick, keep_slope, kick_slope, time_step, anchor, _, tiny, _ = numbers
    keep, kick, keep_slope, kick_slope = keep * free, kick * free, keep_slope * free, kick_slope * free
    pull = kick * stiffness
    force = _net(right, left, down, up, diagonal, back, i) - anchor * state[i]
    before = state[i + THREE * pitch]
    _drift(state, i, i + THREE * pitch, keep * before + pull * force, time_step, tiny)
    if sensitive:
        turned = _net(right, left, down, up, diagonal, back, i + THREE * pitch) - anchor * state[i + SIX * pitch]
        value = keep * state[i + FIFTEEN * pitch] + pull * turned + kick * force
        _drift(state, i + SIX * pitch, i + FIFTEEN * pitch, value, time_step, tiny)
        turned = _net(right, left, down, up, diagonal, back, i + SIX * pitch) - anchor * state[i + NINE * pitch]
        value = (
            keep * state[i + EIGHTEEN * pitch] + pull * turned + keep_slope * before + kick_slope * stiffness * force
        )
        _drift(state, i + NINE * pitch, i + EIGHTEEN * pitch, value, time_step, tiny)
        turned = _net(right, left, down, up, diagonal, back, i + NINE * pitch) - anchor * state[i + TWELVE * pitch]
        value = keep * state[i + TWENTYONE * pitch] + pull * turned
        _drift(state, i + TWELVE * pitch, i + TWENTYONE * pitch, value, time_step, tiny)


@inlined
def _kick(state, mobile, right, left, down, up, diagonal, back, count, numbers, pitch, sensitive):
    """New velocities and displacements of `count` vertices side by side."""
    pitch = np.uint64(pitch)
    for i in range(np.uint64(count)):
        free = mobile[i]
        _kick_axis(state, right, left, down, up, diagonal, back, i, free, numbers, pitch, sensitive)
        _kick_axis(state, right, left, down, up, diagonal, back, pitch + i, free, numbers, pitch, sensitive)
        _kick_axis(state, right, left, down, up, diagonal, back, TWO * pitch + i, free, numbers, pitch, sensitive)


@inlined
def _span(row, radius, centre, first, last):
    """First and last column of a row that lie within `radius` springs of the centre and hold vertices.

    The diagonal spring makes the distance max(|rows|, |columns|) where both have one sign, else their sum.
    """
    below = row - centre[0]
    low = centre[1] - radius + max(below, 0)
    high = centre[1] + radius - max(-below, 0)
    return max(low, first[row]), min(high, last[row])


@inlined
def _pull_row(state, rest, forces, row, start, count, guard, pitch, sensitive):
    """All springs that begin in one row, from column `start` on.

    `forces` keeps the right springs of this row and the down and diagonal springs of this row and the one above.
    """
    planes, sums = (SENSITIVITY_PLANES, 12) if sensitive else (FORWARD_PLANES, 3)
    near, near_rest = row * planes * pitch + start, row * REST_PLANES * pitch + start
    for kind in range(3):
        below, beside = 1 if kind > 0 else 0, 1 if kind != 1 else 0
        far = near + below * planes * pitch + beside
        far_rest = near_rest + below * REST_PLANES * pitch + beside
        out = start if kind == 0 else (2 * kind - 1 + (row & 1)) * sums * pitch + start
        length = rest[near_rest + (LENGTH + kind) * pitch :]
        link = rest[near_rest + (LINK + kind) * pitch :]
        springs = (state[near:], state[far:], rest[near_rest:], rest[far_rest:], length, link, forces[out:])
        _pull(*springs, count, guard, pitch, sensitive)


@inlined
def _kick_row(state, rest, forces, row, start, count, numbers, pitch, sensitive):
    """Move one row, from column `start` on, once its springs and those of the row above are known."""
    planes, sums = (SENSITIVITY_PLANES, 12) if sensitive else (FORWARD_PLANES, 3)
    block, now, before = sums * pitch, row & 1, 1 - (row & 1)
    moved = state[row * planes * pitch + start :]
    mobile = rest[(row * REST_PLANES + MOBILE) * pitch + start :]
    right, left = forces[start:], forces[start - 1 :]
    down, up = forces[(1 + now) * block + start :], forces[(1 + before) * block + start :]
    diagonal, back = forces[(3 + now) * block + start :], forces[(3 + before) * block + start - 1 :]
    _kick(moved, mobile, right, left, down, up, diagonal, back, count, numbers, pitch, sensitive)


@inlined
def _step(state, rest, forces, first, last, centre, radius, numbers, pitch, sensitive):
    """One step of all vertices within `radius` of the centre, row by row and in place.

    A row's springs reach to the next row only, so it can move as soon as its own and the previous row's springs are
    known: nothing reads its old displacement afterwards.
    """
    top, bottom = max(1, centre[0] - radius), min(first.shape[0] - 3, centre[0] + radius)
    for row in range(top - 1, bottom + 1):
        low, high = _span(row, radius, centre, first, last) if row >= top else (pitch, -1)
        next_low, next_high = _span(row + 1, radius, centre, first, last) if row < bottom else (pitch, -1)
        start = min(low, next_low) - 1
        count = max(high, next_high) - start + 1
        if count > 0 and start >= 0:
            _pull_row(state, rest, forces, row, start, count, numbers[-1], pitch, sensitive)
            if high >= low:
                _kick_row(state, rest, forces, row, low, high - low + 1, numbers, pitch, sensitive)


@inlined
def _press(state, place, factor, push, force, numbers, pitch, sensitive):
    """Add the load's impulse at a vertex; `push` is its share of the direction, `factor` this step's share of F."""
    _, _, kick, _, kick_slope, time_step, _, _, _, _ = numbers
    for axis in range(3):
        load = factor * push[axis]
        velocity = place + axis * pitch
        state[velocity + 3 * pitch] += kick * force * load
        state[velocity] += time_step * kick * force * load
        if sensitive:
            state[velocity + 18 * pitch] += kick_slope * force * load
            state[velocity + 9 * pitch] += time_step * kick_slope * force * load
            state[velocity + 21 * pitch] += kick * load
            state[velocity + 12 * pitch] += time_step * kick * load


@inlined
def _grip(state, place, position, pitch, sensitive):
    """Put a gripped vertex where it is in this step, at rest: its velocity after the step is then the springs' pull."""
    for axis in range(3):
        moved = place + axis * pitch
        state[moved], state[moved + 3 * pitch] = position[axis], 0
        if sensitive:
            for parameter in range(3):
                moved = place + (6 + 3 * parameter + axis) * pitch
                state[moved], state[moved + 9 * pitch] = 0, 0


@inlined
def _feel(state, place, numbers, elastic, slopes, pitch):
    """Force of the springs on a gripped vertex [3], and its derivatives [3, 3], from the velocity that it gave."""
    _, _, kick, _, kick_slope, _, _, _, _, _ = numbers
    for axis in range(3):
        felt = state[place + (3 + axis) * pitch] / kick
        elastic[axis] = felt
        for parameter in range(3):
            speed = state[place + (15 + 3 * parameter + axis) * pitch]
            slopes[axis, parameter] = (speed - (kick_slope * felt if parameter == 1 else 0)) / kick


@inlined
def _record(state, runs, field, lag, pitch):
    """Copy the vertices' displacement out of the planes into a stretch of the field, [N·3].

    The field is flat, so that its step of 3 is known to the compiler, which then interleaves x, y and z in vectors.
    """
    pitch = np.uint64(pitch)
    for run in range(runs.shape[0]):
        vertex, place, count = runs[run, 0], runs[run, 1], runs[run, 2]
        moved, out = state[place:], field[3 * vertex :]
        for i in range(np.uint64(count)):
            out[THREE * i] = moved[i] - lag * moved[THREE * pitch + i]
            out[THREE * i + ONE] = moved[pitch + i] - lag * moved[FOUR * pitch + i]
            out[THREE * i + TWO] = moved[TWO * pitch + i] - lag * moved[FIVE * pitch + i]


@inlined
def _rollout(
    rest, first, last, centre, radii, load, loaded, push, gripped, positions, watched, force, numbers, runs,
    trajectory, jacobian, elastic, elastic_slopes, field, begin, pitch, sensitive,
):  # fmt: skip
    """All steps.

    Args:
        rest, first, last, centre: of the `GridLayout`.
        radii: how far from the centre each step is computed, [T].
        load: factor of F in each step, [T].
        loaded, push: places of the pressed vertices and weight·direction of each, [P] and [P, 3].
        gripped, positions: places of the gripped vertices, which the layout has as free, and where they are in each
            step, [G] and [T, G, 3].
        watched: places of vertices, [M].
        force: F.
        numbers: k_s, keep, kick and the latter two's slopes by k_d, Δt, anchor, lag, tiny, guard.
        runs: where to find the vertices for `field`, as `grid_layout.runs` gives them, [R, 3] or [0, 3].
        trajectory: out, displacement of the watched vertices, [T, M, 3].
        jacobian: out, its derivatives by θ, [T, M, 3, 3], or [0, M, 3, 3].
        elastic, elastic_slopes: out, force of the springs on the gripped vertices and its derivatives by θ,
            [T, G, 3] and [T, G, 3, 3], or [0, …].
        field: out, displacement of all vertices of a batch, [T, ΣN, 3], or [T, 0, 3].
        begin: first vertex of this mesh in `field`.
    """
    planes, sums = (SENSITIVITY_PLANES, 12) if sensitive else (FORWARD_PLANES, 3)
    state = np.zeros((first.shape[0] - 1) * planes * pitch, rest.dtype)
    forces = np.zeros(5 * sums * pitch, rest.dtype)
    lag, whole = numbers[7], field.reshape(-1)
    for step in range(radii.shape[0]):
        for index in range(gripped.shape[0]):
            _grip(state, gripped[index], positions[step, index], pitch, sensitive)
        _step(state, rest, forces, first, last, centre, radii[step], numbers, pitch, sensitive)
        for index in range(loaded.shape[0]):
            _press(state, loaded[index], load[step], push[index], force, numbers, pitch, sensitive)
        if sensitive:
            for index in range(gripped.shape[0]):
                _feel(state, gripped[index], numbers, elastic[step, index], elastic_slopes[step, index], pitch)
        for index in range(watched.shape[0]):
            place = watched[index]
            for axis in range(3):
                trajectory[step, index, axis] = state[place + axis * pitch] - lag * state[place + (3 + axis) * pitch]
                if sensitive:
                    for parameter in range(3):
                        moved = place + (6 + 3 * parameter + axis) * pitch
                        jacobian[step, index, axis, parameter] = state[moved] - lag * state[moved + 9 * pitch]
        _record(state, runs, whole[3 * (step * field.shape[1] + begin) :], lag, pitch)
