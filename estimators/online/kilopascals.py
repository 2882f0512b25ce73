"""Kilopascals for a field of relative stiffness: by the force that holds its grip, or by E where it was palpated.

A sheet of the mesh's springs of stiffness k, and of shapes of stiffness s, is as stiff as tissue of E where E times
thickness is (k + SHAPES·s) / SHEET_FACTOR. Only what the field determines is told.
"""

import dataclasses
import math
from collections import deque

import numpy as np

from palpate.estimators.estimate import NINETY
from palpate.estimators.force_scale import SHEET_FACTOR
from palpate.estimators.known_force import LEAST_KNOWN, fit_factor
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.particle_field import ParticleField
from palpate.physics.pbd.potential import Potential
from palpate.physics.pbd.stiffness import spread

Metres = tuple[float, float] | None
PULLS = 10
"""Last frames whose forces tell kilopascals."""
PULL_LOG_SD = 0.1
"""Of the pull of a sheet whose field is true, by how a coarse mesh strains at a grip: 0.09 on twelve drawn pulls."""
SHAPES = 3.0, 5.0
"""By how much more shapes resist a pull along one axis than distances do, in a sheet and in a volume: stretched alike
in all directions they resist twice as much, but not across that axis (their ν is 0, that of springs 1/3 and 1/4)."""
Palpated = tuple[float, float, int | None]
"""E [Pa] with the standard deviation of its logarithm, and the particle where that is; None = beside the tissue."""


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
        self.said = ""
        """What comes of it by now, a sentence; empty without anything known or a determined field."""

    def add(self, force: float) -> None:
        """Keep the state that a frame was mapped to, and how large the force that holds the grip is then [N]."""
        if math.isfinite(force):
            self._past.append((self._driven.session.positions, force))

    def anchored(self, field: ParticleField, metres: Metres = (1.0, 0.0)) -> ParticleField:
        """The field with E where it is determined and something tells it.

        Args:
            field: as it is now.
            metres: of a unit of the particles' places, and the standard deviation of its logarithm; None = not known.
        """
        self.said, known = "", self._known
        if known is None or not field.known.any():
            return field
        bending = SHAPES[len(field.tetrahedra) > 0] * field.shape
        stiffness = field.distance + bending
        log_sd = np.hypot(field.distance * field.distance_log_sd, bending * field.shape_log_sd) / stiffness
        told = self._anchor(known, field.known, stiffness, log_sd, metres)
        if isinstance(told, str):
            self.said = f"No kilopascals: {told}."
            return field
        factor = np.exp(NINETY * np.hypot(log_sd, told[1]))
        young = np.where(field.known, told[0] / 1000 * stiffness * np.stack([factor**0, 1 / factor, factor]), np.nan)
        middle, low, high = np.median(young[:, field.known], axis=1)
        self.said = f"Where that is determined E is {middle:.3g} kPa ({low:.3g} to {high:.3g}) in the median."
        return dataclasses.replace(field, young=young)

    def _anchor(
        self, known: Palpated | float, determined: np.ndarray, stiffness: np.ndarray, log_sd: np.ndarray, metres: Metres
    ) -> tuple[float, float] | str:
        """E of a unit of stiffness [Pa] and the standard deviation of its logarithm, or why it isn't known."""
        if isinstance(known, tuple):
            young, own, at = known
            if at is None or not determined[at]:
                return "stiffness is not determined where the tissue was palpated"
            return young / float(stiffness[at]), math.hypot(own, float(log_sd[at]))
        if metres is None:
            return "nothing tells how long a scene unit is (docs/inputs.md, Millimetres)"
        if len(self._past) < LEAST_KNOWN:
            return f"the force is known in {len(self._past)} frames by now, and {LEAST_KNOWN} are needed"
        session, body, gripped = self._driven.session, self._driven.surface.body, self._driven.surface.gripped
        energy, foundation = Potential(body, spread(body, session.fields)[0]), session.objective.stepping.foundation
        held = [(energy.slope(state)[1] + foundation * (state - body.rest))[gripped].sum(0) for state, _ in self._past]
        factor, variance, _ = fit_factor(np.linalg.norm(held, axis=1), np.array([force for _, force in self._past]))
        errors = math.sqrt(variance) / factor, PULL_LOG_SD, float(np.median(log_sd[gripped])), metres[1]
        return factor / (SHEET_FACTOR * known * metres[0]), math.hypot(*errors)
