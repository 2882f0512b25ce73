"""Motion of the followed contact."""

from dataclasses import replace

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.observations.base import Observation
from palpate.physics.observation import Linearised


class PointObservation(Observation):
    """Displacement of the contact vertex; every run has it, recorded by `InteractionBuilder`.

    Args:
        contact: as in `Observation`.
        noise: σ of every coordinate [scene units]; None = as recorded.
    """

    def __init__(self, contact: Interaction, noise: float | None = None) -> None:
        super().__init__(contact)
        points = contact.observation
        self._points = points if noise is None else replace(points, noise=np.full(3, noise))
        self.vertices, self.times = points.vertices, points.times

    def linearise(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray) -> Linearised:
        return self._points.linearise(moved, slopes)
