"""Compiled rollout on the pixel grid, with the exact derivatives by θ carried along (forward mode).

Source: Bini 2026, equation 9 and table 1; equations and names as in `physics.msd.reference`. With the spring force for
unit stiffness g(u) and the load p, a step is v⁺ = a·v + b·(k_s·g + F·p), u⁺ = u + Δt·v⁺. A derivative by one parameter,
written with a dot, follows v̇⁺ = a·v̇ + b·k_s·ġ + ȧ·v + ḃ·(k_s·g + F·p) + b·(k̇_s·g + Ḟ·p), u̇⁺ = u̇ + Δt·v̇⁺.
A spring d = d₀ + δu of length ℓ gives g = α·d with α = (ℓ − ℓ₀)/ℓ, and ġ = α·δu̇ + β·(d·δu̇)·d with β = ℓ₀/ℓ³.

Springs of a grid mesh are a stencil on the pixel grid. A row of the grid is a block of planes, each `pitch` numbers
long, one number a column. The pitch is a constant of the compiled code: every plane then lies at a known distance from
the others, which is what lets the compiler vectorise. A state holds, row by row, the planes u and v (x, y, z each) and
with sensitivities nine planes of u̇ (by k_s, k_d, F; x, y, z each) and nine of v̇. `pitch` and `sensitive` become
constants where everything is copied into `specialised`.
"""

import functools
from collections.abc import Callable

import numpy as np

from palpate.physics.jit import inlined, kernel
from palpate.physics.msd.grid_layout import LENGTH, LINK, MOBILE, REST_PLANES

FORWARD_PLANES, SENSITIVITY_PLANES = 6, 24
"""Planes of a state without and with derivatives."""

# Unsigned: numba reads a signed index below 0 from the end, and that choice would keep the loops from being vectorised.
TWO, THREE, SIX, NINE = map(np.uint64, (2, 3, 6, 9))


@inlined
def _pull_tangent(near, far, out, turned, x, y, z, alpha, beta, pitch):
    """ġ of one spring for one parameter, whose first plane is at `turned`; (x, y, z) is d."""
    moved = turned + THREE * pitch
    along_x = far[moved] - near[moved]
    along_y = far[moved + pitch] - near[moved + pitch]
    along_z = far[moved + TWO * pitch] - near[moved + TWO * pitch]
    turn = beta * (x * along_x + y * along_y + z * along_z)
    out[turned] = alpha * along_x + turn * x
    out[turned + pitch] = alpha * along_y + turn * y
    out[turned + TWO * pitch] = alpha * along_z + turn * z


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
            _pull_tangent(near, far, out, THREE * pitch + i, x, y, z, alpha, beta, pitch)
            _pull_tangent(near, far, out, SIX * pitch + i, x, y, z, alpha, beta, pitch)
            _pull_tangent(near, far, out, NINE * pitch + i, x, y, z, alpha, beta, pitch)


@inlined
def _net(springs, i):
    """Sum over the six springs of a vertex."""
    right, left, down, up, diagonal, back = springs
    return right[i] - left[i] + down[i] - up[i] + diagonal[i] - back[i]


@inlined
def _drift(state, displacement, velocity, value, time_step, tiny):
    """Store a velocity and move by it; values below `tiny` become 0, because denormals are slow."""
    value = tiny - tiny if abs(value) < tiny else value
    state[velocity] = value
    state[displacement] += time_step * value


@inlined
def _kick_tangent(state, springs, i, turned, keep, pull, own_keep, own_pull, before, force, numbers, pitch):
    """New v̇ and u̇ of a vertex along one axis for one parameter, by which keep and pull have slopes of their own."""
    _, _, _, _, _, time_step, _, tiny, _ = numbers
    moved = i + turned + THREE * pitch
    bend = _net(springs, i + turned)
    value = keep * state[moved + NINE * pitch] + pull * bend + own_keep * before + own_pull * force
    _drift(state, moved, moved + NINE * pitch, value, time_step, tiny)


@inlined
def _kick_axis(state, springs, i, free, numbers, pitch, sensitive):
    """New velocities and displacements of a vertex along one axis; i = axis·pitch + column, free = 1 if it moves."""
    stiffness, keep, kick, keep_slope, kick_slope, time_step, _, tiny, _ = numbers
    keep, kick, none = keep * free, kick * free, keep - keep
    keep_slope, kick_slope = keep_slope * free, kick_slope * free
    pull = kick * stiffness
    force = _net(springs, i)
    before = state[i + THREE * pitch]
    _drift(state, i, i + THREE * pitch, keep * before + pull * force, time_step, tiny)
    if sensitive:
        _kick_tangent(state, springs, i, THREE * pitch, keep, pull, none, kick, before, force, numbers, pitch)
        own = keep_slope, kick_slope * stiffness
        _kick_tangent(state, springs, i, SIX * pitch, keep, pull, *own, before, force, numbers, pitch)
        _kick_tangent(state, springs, i, NINE * pitch, keep, pull, none, none, before, force, numbers, pitch)


@inlined
def _span(row, radius, layout):
    """First and last column of a row that lie within `radius` springs of the centre and hold vertices.

    The diagonal spring makes the distance max(|rows|, |columns|) where both have one sign, else their sum.
    """
    below = row - layout.centre[0]
    low = layout.centre[1] - radius + max(below, 0)
    high = layout.centre[1] + radius - max(-below, 0)
    return max(low, layout.first[row]), min(high, layout.last[row])


@inlined
def _pull_row(state, rest, forces, row, start, count, guard, pitch, sensitive):
    """All springs that begin in one row, from column `start` on.

    `forces` keeps the right springs of this row and the down and diagonal springs of this row and the one above.
    """
    planes, sums = (SENSITIVITY_PLANES, 12) if sensitive else (FORWARD_PLANES, 3)
    near, near_rest = row * planes * pitch + start, row * REST_PLANES * pitch + start
    for kind in range(3):
        below, right = 1 if kind > 0 else 0, 1 if kind != 1 else 0
        far = near + below * planes * pitch + right
        far_rest = near_rest + below * REST_PLANES * pitch + right
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
    springs, pitch = (right, left, down, up, diagonal, back), np.uint64(pitch)
    for i in range(np.uint64(count)):
        for axis in range(THREE):
            _kick_axis(moved, springs, axis * pitch + i, mobile[i], numbers, pitch, sensitive)


@inlined
def _step(state, forces, layout, radius, numbers, pitch, sensitive):
    """One step of all vertices within `radius` of the centre, row by row and in place.

    A row's springs reach to the next row only, so it can move as soon as its own and the previous row's springs are
    known: nothing reads its old displacement afterwards.
    """
    top, bottom = max(1, layout.centre[0] - radius), min(layout.first.shape[0] - 3, layout.centre[0] + radius)
    for row in range(top - 1, bottom + 1):
        low, high = _span(row, radius, layout) if row >= top else (pitch, -1)
        next_low, next_high = _span(row + 1, radius, layout) if row < bottom else (pitch, -1)
        start = min(low, next_low) - 1
        count = max(high, next_high) - start + 1
        if count > 0 and start >= 0:
            _pull_row(state, layout.rest, forces, row, start, count, numbers[-1], pitch, sensitive)
            if high >= low:
                _kick_row(state, layout.rest, forces, row, low, high - low + 1, numbers, pitch, sensitive)


@inlined
def _press(state, load, step, force, numbers, pitch, sensitive):
    """Add the load's impulse at the pressed vertices; `force` is F."""
    factor, pressed, push = load
    _, _, kick, _, kick_slope, time_step, _, _, _ = numbers
    for index in range(pressed.shape[0]):
        for axis in range(3):
            share = factor[step] * push[index, axis]
            place = pressed[index] + axis * pitch
            state[place + 3 * pitch] += kick * force * share
            state[place] += time_step * kick * force * share
            if sensitive:
                state[place + 18 * pitch] += kick_slope * force * share
                state[place + 9 * pitch] += time_step * kick_slope * force * share
                state[place + 21 * pitch] += kick * share
                state[place + 12 * pitch] += time_step * kick * share


@inlined
def _show(state, watched, step, lag, path, slopes, pitch, sensitive):
    """Note where the watched vertices are after a step, and the derivatives of that."""
    for index in range(watched.shape[0]):
        for axis in range(3):
            place = watched[index] + axis * pitch
            path[step, index, axis] = state[place] - lag * state[place + 3 * pitch]
            if sensitive:
                for parameter in range(3):
                    moved = place + (6 + 3 * parameter) * pitch
                    slopes[step, index, axis, parameter] = state[moved] - lag * state[moved + 9 * pitch]


@functools.cache
def specialised(pitch: int, sensitive: bool) -> Callable:
    """The compiled rollout for one row length.

    Args:
        pitch: row length of the layout.
        sensitive: True = ∂/∂(k_s, k_d, F) is carried along.
    """
    planes, sums = (SENSITIVITY_PLANES, 12) if sensitive else (FORWARD_PLANES, 3)
    # From a tuple they are plain values to numba, which would compile the parts anew for each; LLVM sees constants.
    fixed = pitch, sensitive

    @kernel
    def rollout(layout, radii, load, watched, force, numbers, path, slopes):
        """All steps.

        Args:
            layout: a `GridLayout`.
            radii: distance from the centre up to which each step is computed, [T].
            load: share of F in each step, [T]; places of pressed vertices, [P]; weight·direction of each, [P, 3].
            watched: places of vertices, [M].
            force: F.
            numbers: k_s, keep, kick and the latter two's slopes by k_d, Δt, lag, tiny, guard.
            path: out, displacement of the watched vertices, [T, M, 3].
            slopes: out, its derivatives by θ where they are carried along, [T, M, 3, 3].
        """
        state = np.zeros((layout.first.shape[0] - 1) * planes * pitch, layout.rest.dtype)
        forces = np.zeros(5 * sums * pitch, layout.rest.dtype)
        for step in range(radii.shape[0]):
            _step(state, forces, layout, radii[step], numbers, *fixed)
            _press(state, load, step, force, numbers, *fixed)
            _show(state, watched, step, numbers[6], path, slopes, *fixed)

    return rollout
