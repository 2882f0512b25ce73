"""The whole dent as a least-squares problem: the depth of all visible tissue around a contact against the simulator."""

from typing import Self

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.motion import Kind, PressMotion
from palpate.observations.base import JointLikelihood
from palpate.observations.depth import DepthObservation
from palpate.physics.mechanics import Mechanics


class SequenceProblem(JointLikelihood):
    """A depth-change sequence under all parameters of a press.

    What the pixels show must be decided first (`look`).

    Args:
        contact: with a depth-change sequence of one frame or more.
        mechanics: of the fits.
        within: as of `PressMotion`.
        noise: σ of every pixel in every frame [scene units]; None = as the depth-change sequence says.
        kind: of motion: what is fitted of the press.
    """

    def __init__(
        self,
        contact: Interaction,
        mechanics: Mechanics,
        within: float = 0.0,
        noise: float | None = None,
        kind: Kind = PressMotion,
    ) -> None:
        self.contact = contact
        depth = DepthObservation(contact, noise, parts=kind.parts, astray=kind.astray, uneven=kind.uneven)
        super().__init__([depth], lambda vertices, times: kind(contact, mechanics, vertices, times, within))

    @property
    def depth(self) -> DepthObservation:
        """What is observed."""
        return self.observations[0]

    def coarser(self) -> Self:
        """The same with coarse time steps, to search with; it has not looked at anything of its own yet."""
        return self.copy(self.motion.coarser())
