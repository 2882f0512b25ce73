"""Fields of stiffness within bounds: what an optimiser moves, which has none, and what the simulator reads."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.physics.pbd.stiffness import Stiffness


@dataclass(frozen=True)
class Bounds:
    """Largest stiffness of distances and shapes; the smallest is 0 (Liang 2024, section III-B, whose own are `PAPER`).

    Raises:
        ValueError: a bound that is not positive.
    """

    distance: float = 10.0
    """[N/m], where m/Δt² is 1."""
    shape: float = 10.0
    """Likewise."""

    def __post_init__(self) -> None:
        """Check ranges."""
        for name, bound in (("distance", self.distance), ("shape", self.shape)):
            if not (bound > 0 and math.isfinite(bound)):
                raise ValueError(f"the bound of {name} is {bound}; give a positive number.")

    def logits(self, fields: Stiffness) -> np.ndarray:
        """What `fields` makes those fields of, shape [2, N]: distances, then shapes.

        Raises:
            ValueError: a stiffness on a bound or outside; two of the paper's three starts are.
        """
        found = []
        for name, field, bound in (("distance", fields.distance, self.distance), ("shape", fields.shape, self.shape)):
            share = np.asarray(field, np.float64) / bound
            if not ((share > 0) & (share < 1)).all():
                raise ValueError(
                    f"a stiffness of {name} begins on its bounds, 0 and {bound:g}, or outside; begin inside."
                )
            found.append(np.log(share / (1 - share)))
        return np.stack(found)

    def fields(self, logits: np.ndarray, volume: float) -> Stiffness:
        """Bounds times the sigmoid of each; volumes keep theirs."""
        share = 0.5 * (1 + np.tanh(0.5 * logits))  # the sigmoid, which overflows nowhere
        return Stiffness(self.distance * share[0], self.shape * share[1], volume)

    def by_logits(self, fields: Stiffness, slopes: Stiffness) -> np.ndarray:
        """Derivatives by the logits [2, N] from those by the fields [N]."""
        return np.stack(
            [
                slopes.distance * fields.distance * (1 - fields.distance / self.distance),
                slopes.shape * fields.shape * (1 - fields.shape / self.shape),
            ]
        )


PAPER = Bounds(distance=10.0, shape=0.02)
"""Liang 2024, section III-B."""
