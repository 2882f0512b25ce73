"""Time steps of position-based dynamics under a grip, with their exact derivatives by the fields of stiffness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.physics.jit import COMPILED, say_slow
from palpate.physics.load import Grip
from palpate.physics.pbd.adjoint_kernel import sweep_adjoint
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.potential import unturned
from palpate.physics.pbd.stiffness import Stiffness, gather, spread
from palpate.physics.pbd.sweep_kernel import sweep_forward


@dataclass(frozen=True)
class Stepping:
    """How time steps are taken.

    Raises:
        ValueError: a value out of range.
    """

    time_step: float = 1.0
    """Δt [s]. The paper doesn't give it, nor the mass: k counts in units of m/Δt², which is 1 here."""
    iterations: int = 20
    """Sweeps over all constraints a step; the paper doesn't give them."""
    keep: float = 0.0
    """Share of the velocity that a step begins with: 1 is XPBD, 0 the paper's, whose state is positions alone."""
    acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of all free particles: gravity [m/s²]."""
    foundation: float = 0.0
    """Stiffness that holds every particle to its rest [N/m]: tissue lies on other tissue. The paper has none."""

    def __post_init__(self) -> None:
        """Check ranges."""
        if not (self.time_step > 0 and math.isfinite(self.time_step)):
            raise ValueError(f"time_step is {self.time_step}; give a positive number of seconds.")
        if self.iterations < 1:
            raise ValueError(f"iterations is {self.iterations}; give 1 at least.")
        if not 0 <= self.keep <= 1:
            raise ValueError(f"keep is {self.keep}; give a share from 0 to 1.")
        if not (self.foundation >= 0 and math.isfinite(self.foundation)):
            raise ValueError(f"foundation is {self.foundation}; give 0 or more.")
        if len(self.acceleration) != 3 or not all(map(math.isfinite, self.acceleration)):
            raise ValueError(f"acceleration is {self.acceleration}; give three finite numbers.")


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
    body: Body,
    fields: Stiffness,
    grips: Grip | Sequence[Grip] | int,
    stepping: Stepping,
    *,
    start: np.ndarray | None = None,
    speed: np.ndarray | None = None,
) -> Motion:
    """Step bodies on, one step for each of the grip's (Liang 2024, equation 3, by sweeps of Gauss–Seidel).

    B is the number of grips, of fields or of starts, whichever is more than one; one of any serves all.

    Args:
        body: particles and constraints.
        fields: stiffness over the particles.
        grips: which particles are moved, and whereto from *rest*; several grip the same ones over as many steps. A
            number: of steps that nothing grips in.
        stepping: how.
        start: positions to begin at, shape [B, N, 3] or [N, 3] [m]; None = rest.
        speed: velocities there, likewise [m/s]; None = none.

    Raises:
        ValueError: shapes that don't fit, gripped particles that don't exist, numbers that are not finite.
    """
    gripped, path = _paths(grips, body)
    weight = spread(body, fields) * stepping.time_step**2
    begun = _states("start", body.rest if start is None else start, body)
    moving = _states("speed", np.zeros_like(body.rest) if speed is None else speed, body)
    sizes = {len(weight), len(path), len(begun), len(moving)} - {1}
    if len(sizes) > 1:
        raise ValueError(f"fields, grips, starts and speeds are of {sorted(sizes)}; give as many of each, or one.")
    batch = max(sizes, default=1)
    weight, path, begun, moving = (
        np.array(np.broadcast_to(values, (batch, *values.shape[1:])), order="C")
        for values in (weight, path, begun, moving)
    )
    positions = np.empty((batch, path.shape[1] + 1, body.count, 3))
    positions[:, 0] = begun
    foundation = float(stepping.foundation * stepping.time_step**2)
    numbers = (float(stepping.time_step), float(stepping.keep), foundation)
    acceleration = np.asarray(stepping.acceleration, np.float64)
    inverse_mass = body.inverse_mass(gripped)
    inverse_mass /= 1 + inverse_mass * foundation
    arguments = (weight, inverse_mass, body.rest, moving, gripped, path, numbers, acceleration, stepping.iterations)
    if not COMPILED:
        say_slow()
    sweep_forward(body.layout, *arguments, unturned(body, batch), positions)
    return Motion(body, positions, arguments, stepping.time_step)


def _paths(grips: Grip | Sequence[Grip] | int, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Gripped particles [G], and where they are after each step, shape [B, T, G, 3] [m]."""
    if isinstance(grips, int):
        return np.empty(0, np.int64), np.empty((1, grips, 0, 3))
    rows = [grips] if isinstance(grips, Grip) else list(grips)
    gripped = rows[0].vertices.astype(np.int64)
    if any(not np.array_equal(row.vertices, gripped) or row.steps != rows[0].steps for row in rows):
        raise ValueError("the grips hold other particles or last for other steps; give grips alike but for their path.")
    if gripped.min(initial=0) < 0 or gripped.max(initial=-1) >= body.count:
        raise ValueError(f"the grip holds a particle that doesn't exist; there are {body.count}.")
    return gripped, body.rest[gripped] + np.stack([row.displacement.astype(np.float64) for row in rows])


def _states(name: str, values: np.ndarray, body: Body) -> np.ndarray:
    """Positions or velocities of all particles, shape [B, N, 3]."""
    found = np.asarray(values, np.float64)
    if found.ndim == 2:
        found = found[None]
    if found.ndim != 3 or found.shape[1:] != body.rest.shape:
        raise ValueError(f"{name} has shape {np.shape(values)}; give {body.rest.shape}, or a batch of it.")
    if not np.isfinite(found).all():
        raise ValueError(f"{name} holds a number that is not finite.")
    return found
