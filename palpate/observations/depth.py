"""Depth of all visible tissue around a contact."""

from typing import Any

import numpy as np

from palpate.data.contact.depth_sequence import SequenceRecorder
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import dent_features
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.sequence import RestingLight
from palpate.observations.base import Observation
from palpate.physics.depth import DepthLikelihood


class DepthObservation(DepthLikelihood, Observation):
    """Depth-change sequence of a run; `physics.depth` whitens and linearises it, as for the training's loss.

    Args:
        contact: with a sequence of one frame or more.
        noise, others: as in `DepthLikelihood`.
    """

    def __init__(self, contact: Interaction, noise: float | None = None, **others: Any) -> None:
        Observation.__init__(self, contact)
        super().__init__(contact.mesh, contact.vertex, contact.observations["depth"], noise, **others)

    @classmethod
    def recorder(
        cls, onset: PreparedFrame, size: tuple[int, int], rest: RestingLight | None
    ) -> SequenceRecorder | None:
        found = onset.contact
        return SequenceRecorder.of(found.mesh, found.vertex, found.noise, size, onset)

    @staticmethod
    def features(contact: Interaction, within: float) -> np.ndarray:
        return dent_features(contact, within)
