"""Small motions of a body under one pattern of load, by few modes: another E or damping then costs a few sums.

The modes span what the pattern excites: its Krylov space of (K + sM)⁻¹M, K being the stiffness and M the mass (load-
dependent Ritz vectors: Wilson, Yuan & Dickens 1982, whose shift s is 0). With as many modes as unknowns they are the
body's eigenmodes.
"""

import numpy as np

from palpate.physics.fem.dynamics import Relaxation
from palpate.physics.fem.equilibrium import Energy
from palpate.physics.fem.laws import Material
from palpate.physics.fem.linear_system import LinearSystem
from palpate.physics.fem.solid import Solid

MOST = 120
"""Modes. On a slab of 2,280 unknowns motions are off by 1e-10 of the largest."""
NOTHING_NEW = 1e-10
"""A vector of which less than this share is new ends the space."""


class Modes:
    """Of a linear body with damping proportional to mass or a standard linear solid, from rest; M modes.

    Args:
        solid: the body, N nodes.
        material: of law `linear`; its E is a factor of what `follow` takes.
        held: components that don't move, shape [N, 3], bool.
        density: [kg/m³].
        pattern: forces on the nodes, in proportion to which all loads are, shape [N, 3] [N].
        shift: s; they are best where the time steps' rule has its pole, 4/(E·step²) [1/(Pa s²)].
    """

    def __init__(
        self, solid: Solid, material: Material, held: np.ndarray, density: float, pattern: np.ndarray, shift: float
    ) -> None:
        free, none = ~held.ravel(), np.zeros_like(solid.rest)
        energy = Energy(solid, material, none)
        stiffness = energy.matrix(energy.response(none, tangent=True))[free][:, free].tocsr()
        mass = (density * solid.mass[free][:, free]).tocsr()
        shifted = LinearSystem((stiffness + shift * mass).tocsr())
        right = pattern.ravel()[free]
        basis = np.zeros((min(MOST, len(right)), len(right)))
        found = 0
        while found < len(basis):
            new = shifted.solve(np.ascontiguousarray(right[:, None]))[:, 0]
            before = new @ (mass @ new)
            for _ in range(2):  # once leaves rounding
                new = new - basis[:found].T @ (basis[:found] @ (mass @ new))
            size = new @ (mass @ new)
            if not size > NOTHING_NEW**2 * before:
                break
            basis[found] = new / np.sqrt(size)
            right = mass @ basis[found]
            found += 1
        basis = basis[:found]
        self._rates, turned = np.linalg.eigh(basis @ (stiffness @ basis.T))
        vectors = basis.T @ turned
        self._driven = vectors.T @ pattern.ravel()[free]
        self.shapes = np.zeros((len(free), found))
        """Displacement of the nodes in each mode, shape [3N, M]."""
        self.shapes[free] = vectors

    def follow(
        self, young: float, damping: float, course: np.ndarray, step: float, relaxation: Relaxation | None = None
    ) -> np.ndarray:
        """Amplitudes after every step, shape [T, M], by the trapezoidal rule as `physics.fem.dynamics.simulate`.

        Args:
            young: E [Pa].
            damping: force per momentum [1/s].
            course: factor of the load in every step, shape [T].
            step: [s].
            relaxation: of a standard linear solid, whose slow modulus E is.
        """
        rates, left, gain = young * self._rates, 0.0, 0.0
        if relaxation is not None:
            left = np.exp(-step / relaxation.time)
            gain = relaxation.ratio * relaxation.time / step * (1 - left)
        moved, speed, balance, extra = (np.zeros_like(rates) for _ in range(4))
        scale = 4 / step**2 + 2 * damping / step
        found = np.empty((len(course), len(rates)))
        for index, factor in enumerate(course):
            past = scale * moved + (4 / step + damping) * speed + gain * rates * moved - left * extra
            after = (factor * self._driven + balance + past) / (scale + (1 + gain) * rates)
            speed = 2 / step * (after - moved) - speed
            extra = left * extra + gain * rates * (after - moved)
            moved = after
            balance = factor * self._driven - rates * moved - extra - damping * speed
            found[index] = moved
        return found
