"""One clip's state and field, frame by frame (Liang 2024, algorithm 1): step, map, optimise.

Stiffness is optimised by Adam, as in the paper, or set from outside: by the Gauss–Newton steps of
`palpate.estimators.online.determined`, which see followed points.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.common.settings import Checked, Positive
from palpate.estimators.online.objective import Match, Objective, Terms
from palpate.physics.pbd.stiffness import Stiffness


class Adam:
    """Adam (Kingma 2015, algorithm 1) in numpy, where torch is not installed.

    Args:
        rate: learning rate (Liang 2024, section III-B).
        guard: added to the slopes' size.
    """

    def __init__(self, rate: float = 0.1, guard: float = 1e-8) -> None:
        self.rate, self.guard = rate, guard
        self._mean: np.ndarray | float = 0.0
        self._square: np.ndarray | float = 0.0
        self._count = 0

    def step(self, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Take a step against slopes of the same shape as the values; return the new values."""
        first, second = 0.9, 0.999  # Adam's usual decays of the slopes' and squares' means, as the paper gives none
        self._count += 1
        self._mean = first * self._mean + (1 - first) * slopes
        self._square = second * self._square + (1 - second) * slopes * slopes
        size = np.sqrt(self._square / (1 - second**self._count)) + self.guard
        return values - self.rate * self._mean / (1 - first**self._count) / size


@dataclass(frozen=True)
class Method(Checked):
    """Parts of the step that run.

    Raises:
        ValueError: another name.
    """

    name: Literal["PBD", "PBD-RM", "PBD-RM-ON"] = "PBD-RM-ON"
    """Simulation alone; with states that are mapped to what is observed; with stiffness that is optimised, too."""
    optimizer: Literal["adam", "gauss-newton"] = "gauss-newton"
    """Optimiser of stiffness: Adam, the paper's, or Gauss–Newton steps of the fields at a few knots
    (`palpate.estimators.online.determined`), which need followed points."""
    rate: Positive = 0.1
    """Learning rate of Adam, by the logits of the fields (Liang 2024, section III-B)."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Result of a frame; N particles."""

    positions: np.ndarray
    """The state, mapped where the method maps, shape [N, 3] [m]."""
    fields: Stiffness
    """Fields after this frame's step, shape [N]."""
    gap: float | None
    """‖Δ‖ [m]; None = nothing was mapped."""
    terms: Terms | None
    """Terms of what was optimised, before the step; None = nothing was."""


class Session:
    """A body that is followed; begins at rest with the fields given."""

    def __init__(self, objective: Objective, fields: Stiffness, method: Method) -> None:
        """Begin a clip.

        Args:
            objective: body, grip and settings.
            fields: stiffness to begin with, shape [N], inside the bounds where they are optimised.
            method: which parts run.
        """
        self.objective, self.method, self.fields = objective, method, fields
        self.positions = objective.body.rest.copy()
        # Earlier states, of which four should stay at rest (Liang 2024, section II-C).
        self._past: deque[np.ndarray] = deque(maxlen=20)
        self._adam = None
        if (method.name, method.optimizer) == ("PBD-RM-ON", "adam"):
            self._adam, self._logits = Adam(method.rate), objective.bounds.logits(fields)

    def step(self, places: np.ndarray, matches: Sequence[Match]) -> Frame:
        """Take a frame in; one that shows nothing is simulated alone.

        Args:
            places: where gripped particles are, shape [G, 3] [m].
            matches: its cloud, its followed points, both or none.
        """
        terms = None
        if self._adam is not None and matches:
            bounds, volume = self.objective.bounds, float(self.fields.volume)
            own = bounds.fields(self._logits, volume)
            what = own, self.positions, places, matches, self._snapshots()
            simulated, residual, terms, slopes = self.objective.evaluate(*what)
            self._logits = self._adam.step(self._logits, bounds.by_logits(own, slopes))
            self.fields = bounds.fields(self._logits, volume)
        else:
            simulated = self.ahead(places[None])[0]
            looks = bool(matches) and self.method.name != "PBD"
            residual = self.objective.mapped(simulated, matches) if looks else None
        self.positions, gap = simulated, None
        if residual is not None:
            self.positions = simulated + residual.deformation
            gap = float(np.linalg.norm(residual.deformation))
            self._past.append(self.positions)
        return Frame(self.positions, self.fields, gap, terms)

    def ahead(self, places: np.ndarray) -> np.ndarray:
        """Return states [T, N, 3] [m] along a path of the grip [T, G, 3] [m], by the field as it is."""
        return self.objective.stepped(self.fields, self.positions, places).positions[0, 1:]

    def _snapshots(self) -> list[np.ndarray]:
        """Return states evenly out of the window, its ends included, where the paper draws uniformly: runs can be
        repeated."""
        chosen = np.linspace(0, len(self._past) - 1, min(4, len(self._past)))
        return [self._past[index] for index in chosen.round().astype(int)]
