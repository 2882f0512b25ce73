"""Time steps of position-based dynamics under a grip, with their exact derivatives by the fields of stiffness."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential import unturned
from palpate.physics.pbd.stiffness import Stiffness, gather, spread
from palpate.physics.pbd.sweep_kernel import sweep_adjoint, sweep_forward

MOST_ITERATIONS = 1000
"""Most sweeps or gradient steps a frame."""


@dataclass(frozen=True)
class Stepping(Checked):
    """How time steps are taken.

    Raises:
        ValueError: a value out of range.
    """

    time_step: Positive = 1.0
    """Δt [s]. The paper doesn't give it, nor the mass: k counts in units of m/Δt², which is 1 here."""
    iterations: Annotated[int, 1, MOST_ITERATIONS] = 20
    """Sweeps over all constraints a step; the paper doesn't give them."""
    foundation: NotNegative = 0.0
    """Stiffness that holds every particle to its rest [N/m]: tissue lies on other tissue. The paper has none."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What B bodies did over T steps."""

    body: Body
    positions: np.ndarray
    """At the start and after each step, shape [B, T + 1, N, 3] [m]."""
    _arguments: tuple[Any, ...]
    _time_step: float

    def gradient(self, by_positions: np.ndarray) -> Stiffness:
        """Derivatives of a scalar by the fields of each of the B, by the adjoint of every sweep: exact to rounding.

        Where one field served all, their sum is the derivative by it.

        Args:
            by_positions: its derivatives by `positions`, shape [B, T + 1, N, 3].
        """
        pulls = np.array(by_positions, np.float64)
        weight = self._arguments[0]
        slopes = np.zeros_like(weight)
        turn = unturned(self.body, len(weight))
        sweep_adjoint(self.body.layout, *self._arguments, turn, self.positions, pulls, slopes)
        return gather(self.body, slopes * self._time_step**2)


def simulate(
    body: Body, fields: Stiffness, gripped: np.ndarray, path: np.ndarray, stepping: Stepping, start: np.ndarray
) -> Motion:
    """Step bodies on, one step for each of the path's (Liang 2024, equation 3, by sweeps of Gauss–Seidel).

    A state is positions alone, as in the paper: no velocity is kept from one step to the next.

    B is the number of paths, of fields or of starts, whichever is more than one; one of any serves all.

    Args:
        body: particles and constraints.
        fields: stiffness over the particles.
        gripped: particles that are moved, shape [G].
        path: where they are after each step, shape [B, T, G, 3] [m].
        stepping: how.
        start: positions to begin at, shape [B, N, 3] or [N, 3] [m].
    """
    weight = spread(body, fields) * stepping.time_step**2
    begun = np.reshape(start, (-1, *body.rest.shape))
    batch = max(len(weight), len(path), len(begun))
    weight, path, begun = (
        np.array(np.broadcast_to(values, (batch, *values.shape[1:])), order="C") for values in (weight, path, begun)
    )
    positions = np.empty((batch, path.shape[1] + 1, body.count, 3))
    positions[:, 0] = begun
    foundation = float(stepping.foundation * stepping.time_step**2)
    inverse_mass = body.inverse_mass(gripped)
    inverse_mass /= 1 + inverse_mass * foundation
    arguments = (weight, inverse_mass, body.rest, gripped, path, foundation, stepping.iterations)
    sweep_forward(body.layout, *arguments, unturned(body, batch), positions)
    return Motion(body, positions, arguments, stepping.time_step)
