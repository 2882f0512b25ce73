"""Time steps of position-based dynamics under a grip, with their exact derivatives by the fields of stiffness."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.physics.load import Grip
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential import unturned
from palpate.physics.pbd.stiffness import Stiffness, gather, spread
from palpate.physics.pbd.sweep_kernel import sweep_adjoint, sweep_forward

Grips = Grip | Sequence[Grip] | int
"""One for all bodies, one for each, or how many steps nothing is gripped."""
MOST_ITERATIONS = 1000
"""Most sweeps or gradient steps a frame."""


@dataclass(frozen=True)
class Stepping(Checked):
    """Settings of the time steps.

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
    """Motion of B bodies over T steps."""

    body: Body
    positions: np.ndarray
    """Places at the start and after each step, shape [B, T + 1, N, 3] [m]."""
    _arguments: tuple[Any, ...]
    _time_step: float

    def gradient(self, by_positions: np.ndarray) -> Stiffness:
        """Derivatives of a scalar by the fields of each of the B, by the adjoint of every sweep: exact to rounding.

        Where one field served all, their sum is the derivative by it.

        Args:
            by_positions: its derivatives by `positions`, shape [B, T + 1, N, 3].

        Raises:
            ValueError: a shape that doesn't fit.
        """
        if np.shape(by_positions) != self.positions.shape:
            raise ValueError(f"by_positions has shape {np.shape(by_positions)}; give {self.positions.shape}.")
        pulls = np.array(by_positions, np.float64)
        weight = self._arguments[0]
        slopes = np.zeros_like(weight)
        turn = unturned(self.body, len(weight))
        sweep_adjoint(self.body.layout, *self._arguments, turn, self.positions, pulls, slopes)
        return gather(self.body, slopes * self._time_step**2)


def simulate(
    body: Body, fields: Stiffness, grips: Grips, stepping: Stepping, *, start: np.ndarray | None = None
) -> Motion:
    """Step bodies on, one step for each of the grip's (Liang 2024, equation 3, by sweeps of Gauss–Seidel).

    A state is positions alone, as in the paper: no velocity is kept from one step to the next.

    B is the number of grips, of fields or of starts, whichever is more than one; one of any serves all.

    Args:
        body: particles and constraints.
        fields: stiffness over the particles.
        grips: moved particles and their displacement from *rest*; several grip the same ones over as many steps. A
            number: number of steps without a grip.
        stepping: settings of the steps.
        start: positions to begin at, shape [B, N, 3] or [N, 3] [m]; None = rest.

    Raises:
        ValueError: shapes that don't fit, gripped particles that don't exist, numbers that are not finite.
    """
    gripped, path = _paths(grips, body)
    weight = spread(body, fields) * stepping.time_step**2
    begun = _states(body.rest if start is None else start, body)
    sizes = {len(weight), len(path), len(begun)} - {1}
    if len(sizes) > 1:
        raise ValueError(f"fields, grips and starts are of {sorted(sizes)}; give as many of each, or one.")
    batch = max(sizes, default=1)
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


def _paths(grips: Grips, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Gripped particles [G], and where they are after each step, shape [B, T, G, 3] [m]."""
    if isinstance(grips, int):
        return np.empty(0, np.int64), np.empty((1, grips, 0, 3))
    rows = [grips] if isinstance(grips, Grip) else list(grips)
    gripped = rows[0].vertices.astype(np.int64)
    if any(not np.array_equal(row.vertices, gripped) or row.steps != rows[0].steps for row in rows):
        problem = "the grips hold other particles or last for other steps;"
        raise ValueError(f"{problem} give grips that differ in their path only.")
    if gripped.min(initial=0) < 0 or gripped.max(initial=-1) >= body.count:
        raise ValueError(f"the grip holds a particle that doesn't exist; there are {body.count}.")
    return gripped, body.rest[gripped] + np.stack([row.displacement.astype(np.float64) for row in rows])


def _states(values: np.ndarray, body: Body) -> np.ndarray:
    """Positions of all particles, shape [B, N, 3]."""
    found = np.asarray(values, np.float64)
    found = found[None] if found.ndim == 2 else found
    if found.ndim != 3 or found.shape[1:] != body.rest.shape:
        raise ValueError(f"start has shape {np.shape(values)}; give {body.rest.shape}, or a batch of it.")
    if not np.isfinite(found).all():
        raise ValueError("start holds a number that is not finite.")
    return found
