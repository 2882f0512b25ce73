"""What every estimator is: opened once, it starts a session a clip, which holds all that belongs to the clip."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from palpate.data.clip import ClipStream
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import DepthSettings
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera
from palpate.data.source.layout import ClipLayout
from palpate.estimators.known_force import KnownForce
from palpate.estimators.records import FrameEstimate, InteractionEstimate

SMOOTHING = 4.0
"""Default width over which the resting shape is smoothed, where no model tells [grid px]."""


@dataclass(frozen=True)
class Chosen:
    """What a user chooses of a clip's preparation; the estimator decides the rest."""

    layout: ClipLayout = field(default_factory=ClipLayout)
    """How the clips' files are named."""
    masks: str | None = None
    """Source of the masks; None = the estimator's."""
    depth: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `DepthSettings`."""
    smoothing: float | None = None
    """Width over which the resting shape is smoothed [grid px]; None = the estimator's."""

    def without_model(self) -> PrepareSettings:
        """Of estimators that no model's file tells how: smoothed tissue, the camera's motion taken off."""
        smoothing = SMOOTHING if self.smoothing is None else self.smoothing
        geometry = GeometrySettings(smoothing=smoothing, rigid_motion="subtract")
        chosen: dict[str, Any] = {"masks": self.masks or "auto", "layout": self.layout}
        return PrepareSettings(depth=DepthSettings(**self.depth), geometry=geometry, **chosen)


@dataclass(frozen=True)
class ClipInfo:
    """What a session must know of its clip before the first frame."""

    fps: float
    """Frames a second."""
    size: tuple[int, int]
    """Width and height of the pictures [px]."""
    camera: Camera
    """Intrinsics of the full picture, free of distortion."""
    geometry: GeometrySettings
    """How contacts are found."""
    bridge_frames: int
    """Contact that is missing on up to this many frames is still the same run."""
    force: KnownForce | None = None
    """Forces that are known, of whoever tells stiffness by them frame by frame."""
    metres: Callable[[], tuple[float, float] | None] | None = None
    """Gives the length of a scene unit as it is known by now [m], and the standard deviation of its logarithm."""

    @classmethod
    def of(cls, clip: ClipStream) -> Self:
        """Of an opened clip."""
        settings, source = clip.settings, clip.source
        return cls(source.fps, source.size, clip.picture_camera, settings.geometry, settings.bridge_frames)


Output = FrameEstimate | InteractionEstimate


class Session(Protocol):
    """One clip's estimates; two sessions of one estimator may be open at once."""

    @property
    def seconds(self) -> Mapping[str, float]:
        """Time spent so far by stage [s]."""

    def push(self, frame: PreparedFrame) -> Iterable[Output]:
        """The next frame; gives one `FrameEstimate` for each frame, in order and maybe late, and what has ended.

        The frame counts once all that is given has been taken.
        """

    def finish(self) -> Iterable[Output]:
        """What is left at the clip's end."""


class Estimator(Protocol):
    """Something that estimates; it holds nothing of any clip."""

    name: str
    """`network`, `gan`, `direct`, …"""

    @property
    def described(self) -> dict[str, Any]:
        """Its settings, JSON-able: with its model's file all that its numbers depend on."""

    def preparation(self, chosen: Chosen) -> PrepareSettings:
        """How frames must be prepared for it."""

    def start(self, clip: ClipInfo) -> Session:
        """Open a session."""
