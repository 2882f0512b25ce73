"""Elastic energy that a body's constraints hold, U = ½ Cᵀ diag(k) C (Liang 2024, equation 2), and its derivatives."""

from dataclasses import dataclass, field

import numpy as np

from palpate.physics.jit import kernel
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.constraint_kernel import add, bent, dot, less, met, put, row, stretched, stretched_bent


@dataclass
class Potential:
    """The energy of a body for one stiffness; remembers the rotations of shapes, at which the next call begins."""

    body: Body
    stiffness: np.ndarray
    """k of every constraint, shape [K]; 0 leaves one out."""
    _turn: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Begin at rotations of rest."""
        expected = self.body.layout.rest.shape
        if self.stiffness.shape != expected:
            raise ValueError(f"stiffness has shape {self.stiffness.shape}; give one number a constraint, {expected}.")
        self._turn = unturned(self.body, 1)[0]

    def slope(self, points: np.ndarray) -> tuple[float, np.ndarray]:
        """U [J], and its gradient by the particles' positions [N, 3], shape [N, 3] [N]."""
        out = np.zeros_like(points)
        return _energy_slope(self.body.layout, self.stiffness, points, self._turn, out), out

    def bend(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Change of the gradient at positions [N, 3] along a direction [N, 3], shape [N, 3] [N]."""
        out = np.zeros_like(points)
        _energy_bend(self.body.layout, self.stiffness, points, self._turn, direction, out)
        return out


def unturned(body: Body, batch: int) -> np.ndarray:
    """Quaternions of no rotation for every shape, shape [batch, P, 4]."""
    turn = np.zeros((batch, len(body.layout.rest) - int(body.layout.firsts[1]), 4))
    turn[..., 0] = 1.0
    return turn


@kernel
def _energy_slope(layout, stiffness, points, turn, out):
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
    for index in range(firsts[0], rest.shape[0]):
        if stiffness[index] == 0.0:
            continue
        value, _ = met(layout, points, turn, index, slope)
        force = stiffness[index] * value
        total += 0.5 * force * value
        for m in range(starts[index], starts[index + 1]):
            add(out, members[m], force, row(slope, m))
    return total


@kernel
def _energy_bend(layout, stiffness, points, turn, direction, out):
    """Second derivatives of U times a direction [N, 3], added to `out` [N, 3]; others as in `_energy_slope`."""
    starts, members, rest, offsets, firsts = layout
    slope, along, change = np.empty_like(offsets), np.empty_like(offsets), np.empty_like(offsets)
    for index in range(firsts[0]):
        one, other = members[2 * index], members[2 * index + 1]
        value, normal = stretched(points, one, other, rest[index])
        apart = less(direction, one, other)
        bend = stretched_bent(normal, value + rest[index], apart)
        ahead = stiffness[index] * dot(normal, apart)
        for particle, sign in ((one, 1.0), (other, -1.0)):
            add(out, particle, sign * ahead, normal)
            add(out, particle, sign * stiffness[index] * value, bend)
    for index in range(firsts[0], rest.shape[0]):
        if stiffness[index] == 0.0:
            continue
        value, left = met(layout, points, turn, index, slope)
        ahead, shape = 0.0, max(index - firsts[1], 0)
        for m in range(starts[index], starts[index + 1]):
            put(along, m, row(direction, members[m]))
            ahead += dot(row(slope, m), row(along, m))
        own = turn[shape]
        bent(layout, index, (own[0], own[1], own[2], own[3]), left, slope, value, along, change)
        for m in range(starts[index], starts[index + 1]):
            add(out, members[m], stiffness[index] * ahead, row(slope, m))
            add(out, members[m], stiffness[index] * value, row(change, m))
