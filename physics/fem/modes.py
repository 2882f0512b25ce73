"""Small motions of a body by its eigenmodes: once these are known, another E or damping costs a few sums."""

from __future__ import annotations

import numpy as np

from physics.fem.equilibrium import Energy
from physics.fem.laws import Material
from physics.fem.solid import Solid


class Modes:
    """Of a body of law `linear` with damping proportional to mass, from rest; N nodes, M modes.

    Args:
        solid: the body; all of it is solved for at once, so a thousand nodes at most.
        poisson: ν.
        held: components that don't move, shape [N, 3], bool.
        density: [kg/m³].
        pattern: forces on the nodes, in proportion to which all loads are, shape [N, 3] [N].
    """

    def __init__(self, solid: Solid, poisson: float, held: np.ndarray, density: float, pattern: np.ndarray) -> None:
        from scipy.linalg import eigh  # takes a second to load

        free, none = ~held.ravel(), np.zeros_like(solid.rest)
        energy = Energy(solid, Material("linear", 1.0, poisson), none)
        stiffness = energy.matrix(energy.response(none, tangent=True))[free][:, free]
        mass = density * solid.mass[free][:, free]
        self._rates, vectors = eigh(stiffness.toarray(), mass.toarray())
        self._driven = vectors.T @ pattern.ravel()[free]
        self.shapes = np.zeros((len(free), len(self._rates)))
        """Displacement of the nodes in each mode, shape [3N, M]."""
        self.shapes[free] = vectors

    def follow(self, young: float, damping: float, course: np.ndarray, step: float) -> np.ndarray:
        """Amplitudes after every step, shape [T, M], by the trapezoidal rule as `physics.fem.dynamics.simulate`.

        Args:
            young: E [Pa].
            damping: force per momentum [1/s].
            course: factor of the load in every step, shape [T].
            step: [s].
        """
        rates = young * self._rates
        moved, speed, balance = (np.zeros_like(rates) for _ in range(3))
        scale = 4 / step**2 + 2 * damping / step
        found = np.empty((len(course), len(rates)))
        for index, factor in enumerate(course):
            past = scale * moved + (4 / step + damping) * speed
            after = (factor * self._driven + balance + past) / (scale + rates)
            speed = 2 / step * (after - moved) - speed
            moved = after
            balance = factor * self._driven - rates * moved - damping * speed
            found[index] = moved
        return found
