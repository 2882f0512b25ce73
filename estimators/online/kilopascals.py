"""Kilopascals for a field of relative stiffness: by the force that holds its grip, or by E where it was palpated.

A sheet of the mesh's springs of stiffness k, and of shapes of stiffness s, is as stiff as tissue of E where E times
thickness is (k + SHAPES·s) / SHEET_FACTOR. Only what the field determines is told.
"""

import dataclasses
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from palpate.estimators.calibration_file import SHEET_FACTOR
from palpate.estimators.estimate import NINETY, NoEstimate
from palpate.estimators.known_force import LEAST_KNOWN, fit_factor
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.particle_field import ParticleField
from palpate.physics.identifiability import LIMIT
from palpate.physics.pbd.potential import Potential
from palpate.physics.pbd.stiffness import spread

PULLS = 10
"""Last frames whose forces tell kilopascals."""
PULL_LOG_SD = 0.1
"""Of the pull of a sheet whose field is true, by how a coarse mesh strains at a grip: 0.09 on twelve drawn pulls."""
SHAPES = 3.0, 5.0
"""By how much more shapes resist a pull along one axis than distances do, in a sheet and in a volume: stretched alike
in all directions they resist twice as much, but not across that axis (their ν is 0, that of springs 1/3 and 1/4)."""
NOWHERE = "No kilopascals: stiffness is determined nowhere."
LARGEST_GAP = 2.0
"""A place lies on tissue if a particle is so near, in mean edges."""


class Palpated(NamedTuple):
    """E of the tissue at one particle."""

    young: float
    """[Pa]."""
    log_sd: float
    """Standard deviation of its logarithm."""
    particle: int | None
    """None = beside the tissue."""


class Kilopascals:
    """What anchors the field of one run of contact.

    Args:
        driven: its tissue.
        known: E where it was palpated; or the thickness of the sheet that the tissue is [m], whose forces `add` gets;
            None = nothing.
    """

    def __init__(self, driven: DrivenTissue, known: Palpated | float | None) -> None:
        self._driven, self._known = driven, known
        self._past: deque[tuple[np.ndarray, float]] = deque(maxlen=PULLS)
        self.said = "" if known is None else NOWHERE
        """What comes of it by now, a sentence; empty without anything known."""

    def add(self, force: np.ndarray | float) -> None:
        """Keep the state that a frame was mapped to.

        Args:
            force: that holds the grip then [N], along its way, or in the particles' frame, shape [3]; NaN = not known.
        """
        state = self._driven.session.positions
        along = float(force @ self._grip(state)[0]) if isinstance(force, np.ndarray) else force
        if math.isfinite(along):
            self._past.append((state, along))

    def anchored(self, field: ParticleField, metres: tuple[float, float] | None = (1.0, 0.0)) -> ParticleField:
        """The field with E where it is determined and something tells it.

        Args:
            field: as it is now.
            metres: of a unit of the particles' places, and the standard deviation of its logarithm; None = not known.
        """
        if self._known is None:
            return field
        self.said = NOWHERE
        if not field.known.any():
            return field
        bending = SHAPES[len(field.tetrahedra) > 0] * field.shape
        stiffness = field.distance + bending
        log_sd = np.hypot(field.distance * field.distance_log_sd, bending * field.shape_log_sd) / stiffness
        try:
            if isinstance(self._known, Palpated):
                unit, own = _by_palpation(self._known, field.known, stiffness, log_sd)
            else:
                unit, own = self._by_force(self._known, metres, log_sd)
        except NoEstimate as reason:
            self.said = f"No kilopascals: {reason}"
            return field
        young, factor = np.where(field.known, unit * stiffness, np.nan), np.exp(NINETY * np.hypot(log_sd, own))
        ends = np.stack([young, young / factor, young * factor])
        middle, low, high = np.median(ends[:, field.known], axis=1)
        self.said = f"Where that is determined E is {middle:.3g} kPa ({low:.3g} to {high:.3g}) in the median."
        return dataclasses.replace(field, young=ends)

    def _by_force(
        self, thickness: float, metres: tuple[float, float] | None, log_sd: np.ndarray
    ) -> tuple[float, float]:
        """E of a unit of stiffness [kPa], and the standard deviation of its logarithm.

        Raises:
            NoEstimate: why there is none.
        """
        if metres is None:
            raise NoEstimate("nothing tells how long a scene unit is (docs/inputs.md, Millimetres).")
        if len(self._past) < LEAST_KNOWN:
            raise NoEstimate(f"the force is known in {len(self._past)} frames by now; {LEAST_KNOWN} are needed.")
        factor, variance, _ = fit_factor(*np.array([(self._pull(state), force) for state, force in self._past]).T)
        if factor <= 0 or variance > (LIMIT * factor) ** 2:
            raise NoEstimate("the known forces don't go with the tissue's pull.")
        at_grip = float(np.median(log_sd[self._driven.surface.gripped]))
        errors = math.sqrt(variance) / factor, PULL_LOG_SD, at_grip, metres[1]
        return factor / (SHEET_FACTOR * metres[0] * thickness) / 1000, math.hypot(*errors)

    def _grip(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which way the grip has gone, a unit vector, and how far the foundation is stretched there, shape [3] each."""
        away = (state - self._driven.surface.body.rest)[self._driven.surface.gripped]
        return away.sum(axis=0) / max(float(np.linalg.norm(away.sum(axis=0))), 1e-12), away.sum(axis=0)

    def _pull(self, state: np.ndarray) -> float:
        """What holds the grip in a state along its way, by the field as it is now."""
        session, surface = self._driven.session, self._driven.surface
        energy, (way, away) = Potential(surface.body, spread(surface.body, session.fields)[0]), self._grip(state)
        inner = energy.slope(state)[1][surface.gripped].sum(axis=0)
        return float((inner + session.objective.stepping.foundation * away) @ way)


def _by_palpation(
    palpated: Palpated, known: np.ndarray, stiffness: np.ndarray, log_sd: np.ndarray
) -> tuple[float, float]:
    at = palpated.particle
    if at is None:
        raise NoEstimate("palpated_at lies beside the tissue of the frame in which contact begins.")
    if not known[at]:
        raise NoEstimate("stiffness is not determined where the tissue was palpated.")
    return palpated.young / 1000 / float(stiffness[at]), math.hypot(palpated.log_sd, float(log_sd[at]))


def particle_at(places: np.ndarray, at: np.ndarray, edge: float) -> int | None:
    """The particle at a place; None where that lies beside the tissue.

    Args:
        places: of the particles, shape [N, D].
        at: the place, shape [D].
        edge: mean length of edges there, in the same unit.
    """
    away = np.linalg.norm(places - at, axis=1)
    return int(away.argmin()) if away.min() <= LARGEST_GAP * edge else None
