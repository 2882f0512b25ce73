"""Compiled elastic energy of position-based dynamics and its derivatives (Liang 2024, equation 2)."""

from __future__ import annotations

import numpy as np

from physics.jit import kernel
from physics.pbd.constraint_kernel import bent, evaluated


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
    slope = np.empty_like(layout.offsets)
    total = 0.0
    for index in range(layout.rest.shape[0]):
        if stiffness[index] == 0.0:
            continue
        value = evaluated(layout, points, turn, index, slope)
        total += 0.5 * stiffness[index] * value * value
        for m in range(layout.starts[index], layout.starts[index + 1]):
            for axis in range(3):
                out[layout.members[m], axis] += stiffness[index] * value * slope[m, axis]
    return total


@kernel
def energy_bend(layout, stiffness, points, turn, direction, out):
    """Second derivatives of U times a direction [N, 3], added to `out` [N, 3]; other arguments as in `energy_slope`."""
    slope, along = np.empty_like(layout.offsets), np.empty_like(layout.offsets)
    change = np.empty_like(layout.offsets)
    for index in range(layout.rest.shape[0]):
        if stiffness[index] == 0.0:
            continue
        first, last = layout.starts[index], layout.starts[index + 1]
        value = evaluated(layout, points, turn, index, slope)
        ahead = 0.0
        for m in range(first, last):
            for axis in range(3):
                along[m, axis] = direction[layout.members[m], axis]
                ahead += slope[m, axis] * along[m, axis]
        bent(layout, points, turn, index, slope, value, along, change)
        for m in range(first, last):
            for axis in range(3):
                curved = value * change[m, axis] + slope[m, axis] * ahead
                out[layout.members[m], axis] += stiffness[index] * curved
