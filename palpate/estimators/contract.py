"""Contract of estimators: opened once, an estimator starts one session a clip, which holds everything of that clip."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Protocol, Self

from palpate.common.onnx_devices import AUTO, DEVICES
from palpate.common.options import option
from palpate.data.clip import ClipStream
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import MOST_THREADS, DepthSettings
from palpate.data.depth.preset import preset_names
from palpate.data.masks.sources import mask_names
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera, load_camera
from palpate.data.source.layout import ClipLayout, load_layout
from palpate.estimators.known_force import KnownForce
from palpate.estimators.records import FrameEstimate, InteractionEstimate

SMOOTHING = 4.0
"""Default width over which the resting shape is smoothed, where no model tells [grid px]."""


@dataclass(frozen=True)
class Preparation:
    """Depth, masks and camera.

    Choices of a user, who is asked for nothing; the estimator decides the rest.
    """

    depth: str | None = option(None, metavar="SOURCE", names=preset_names, setting="depth.source")
    """auto, stored, stereo (docs/inputs.md), a depth model's .onnx file (default: as the model was trained, else auto),
    or a preset"""
    depth_model: str | None = option(None, metavar="FILE", setting="depth.model")
    """the .onnx file of a preset that ships none"""
    depth_preset: str | None = option(None, metavar="PRESET", setting="depth.preset")
    """preset or .yaml file with the settings to read --depth MODEL.onnx"""
    masks: str | None = option(None, metavar="SOURCE", names=mask_names)
    """a segmentation model's .onnx file, a folder of masks, outlines of instruments in a frame, which are followed from
    there (a .yaml file, docs/masks.md), auto (annotation where there is one, else automatic; default), or a source"""
    layout: Path | ClipLayout | None = option(None, metavar="FILE")
    """YAML file that names a folder's files (default: CholecSeg8k)"""
    topic: str | None = option(None, metavar="NAME", setting="layout.topic")
    """topic of the pictures in bags (default: the only one; palpate[robot])"""
    camera: Path | None = option(None, metavar="FILE")
    """camera (YAML or JSON) for clips that bring none of their own"""
    threads: Annotated[int, 0, MOST_THREADS] = option(0, metavar="N")
    """CPU threads; 0 = all"""
    device: str = option(AUTO, choices=lambda: DEVICES)
    """where ONNX networks run: auto is the best that the installed onnxruntime offers"""

    @property
    def clip_layout(self) -> ClipLayout:
        """Layout of the clips' files, with the chosen camera and topic.

        Raises:
            InputError: a file can't be used.
        """
        found = self.layout or ClipLayout()
        found = found if isinstance(found, ClipLayout) else load_layout(Path(found))
        if self.camera is not None:
            load_camera(Path(self.camera))
            found = replace(found, camera=str(Path(self.camera).resolve()))
        return replace(found, topic=self.topic or found.topic)

    @property
    def depth_fields(self) -> dict[str, Any]:
        """Fields of `DepthSettings` that are chosen."""
        named: dict[str, Any] = {"source": self.depth, "model": self.depth_model, "preset": self.depth_preset}
        named |= {"threads": self.threads, "device": self.device}
        return {name: value for name, value in named.items() if value is not None}

    def without_model(self, smoothing: float) -> PrepareSettings:
        """Return preparation for estimators without a trained model: smoothed depth, camera motion subtracted.

        Args:
            smoothing: width over which the resting shape is smoothed [grid px].
        """
        geometry = GeometrySettings(smoothing=smoothing, rigid_motion="subtract")
        chosen: dict[str, Any] = {"masks": self.masks or "auto", "layout": self.clip_layout}
        return PrepareSettings(depth=DepthSettings(**self.depth_fields), geometry=geometry, **chosen)


@dataclass(frozen=True)
class ClipInfo:
    """Facts about a clip that a session needs before the first frame."""

    fps: float
    """Frames a second."""
    size: tuple[int, int]
    """Width and height of the pictures [px]."""
    camera: Camera
    """Intrinsics of the full picture, free of distortion."""
    geometry: GeometrySettings
    """Settings by which contacts are found."""
    bridge_frames: int
    """Contact that is missing on up to this many frames is still the same run."""
    force: KnownForce | None = None
    """Forces that are known, of whoever tells stiffness by them frame by frame."""
    metres: Callable[[], tuple[float, float] | None] | None = None
    """Function that returns the length of a scene unit as known so far [m], and the standard deviation of its
    logarithm."""

    @classmethod
    def of(cls, clip: ClipStream) -> Self:
        """Describe an opened clip."""
        settings, source = clip.settings, clip.source
        return cls(source.fps, source.size, clip.picture_camera, settings.geometry, settings.bridge_frames)


Output = FrameEstimate | InteractionEstimate


class Session(Protocol):
    """One clip's estimates; two sessions of one estimator may be open at once."""

    @property
    def seconds(self) -> Mapping[str, float]:
        """Time spent so far by stage [s]."""

    def push(self, frame: PreparedFrame) -> Iterable[Output]:
        """Take the next frame; yield one `FrameEstimate` a frame, in order and maybe late, and runs that have ended.

        The frame counts once all that is given has been taken.
        """

    def finish(self) -> Iterable[Output]:
        """Yield what is left at the clip's end."""


class Estimator(Protocol):
    """Something that estimates; it holds nothing of any clip. Subclasses state here what they can."""

    name: str
    """Name in the registry."""
    settings: Any = None
    """Settings that a user chooses; None = there are none."""
    smoothing: float = SMOOTHING
    """Width over which the resting shape is smoothed, where no model tells [grid px]."""
    live: bool = False
    """True if it estimates while frames come."""
    tells_theta: bool = True
    """True if it estimates stiffness, damping and force of a press."""
    tells_intervals: bool = True
    """True if its numbers have intervals."""
    tells_field: bool = False
    """True if it estimates stiffness place by place, also in sequences beside a robot."""
    force_seconds: float | None = None
    """Time after the onset of contact up to which a frame's estimate constrains the force [s]; None = none does."""

    @property
    def described(self) -> dict[str, Any]:
        """Settings of the estimator as JSON: with its model's file, everything that its numbers depend on."""
        settings: Any = self.settings or self
        return {"name": self.name} | (asdict(settings) if is_dataclass(settings) else {})

    def preparation(self, chosen: Preparation) -> PrepareSettings:
        """Return the preparation of frames for this estimator."""
        return chosen.without_model(self.smoothing)

    def start(self, clip: ClipInfo) -> Session:
        """Open a session."""
        raise NotImplementedError
