"""Elastic energy that a body's constraints hold, U = ½ Cᵀ diag(k) C (Liang 2024, equation 2), and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential_kernel import energy_bend, energy_slope


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
        return energy_slope(self.body.layout, self.stiffness, points, self._turn, out), out

    def bend(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Change of the gradient at positions [N, 3] along a direction [N, 3], shape [N, 3] [N]."""
        out = np.zeros_like(points)
        energy_bend(self.body.layout, self.stiffness, points, self._turn, direction, out)
        return out


def unturned(body: Body, batch: int) -> np.ndarray:
    """Quaternions of no rotation for every shape, shape [batch, P, 4]."""
    turn = np.zeros((batch, len(body.layout.rest) - int(body.layout.firsts[1]), 4))
    turn[..., 0] = 1.0
    return turn
