"""Sessions of estimators over prepared clips."""

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np

from palpate.data.contact.geometry import FrameGeometry, GeometrySettings
from palpate.data.contact.motion import ContactMotion
from palpate.data.contact.refinement import ContactRun
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame
from palpate.estimators.contract import ClipInfo, Output, Session
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.physics.mesh import Mesh

SIZE = (214, 120)
"""Width and height of the pictures [px]."""
DEPTH, LABELS = np.full(SIZE[::-1], 0.5, np.float32), np.zeros(SIZE[::-1], np.uint8)
"""Depth and labels of frames that are not a synthetic clip's."""


def clip_info(fps: float = 25.0, bridge_frames: int = 2) -> ClipInfo:
    """A small clip, prepared as usual."""
    camera = Camera.from_field_of_view(60.0, *SIZE)
    return ClipInfo(fps, SIZE, camera, GeometrySettings(smoothing=4, rigid_motion="subtract"), bridge_frames)


def touched(mesh: Mesh, vertex: int, normal: np.ndarray, noise: float) -> FrameGeometry:
    """A contact at a vertex of a mesh."""
    point, pixel = mesh.vertices[vertex], tuple(mesh.pixels[vertex, ::-1].tolist())
    found = FrameGeometry(lambda: mesh, point, point, 0.0, pixel, True, noise)
    vars(found).update(vertex=vertex, normal=normal)
    return found


def prepared_frame(index: int, status: str, geometry: FrameGeometry | None = None, **changes) -> PreparedFrame:
    """A frame at 25 frames a second; `changes` are further fields, `number` and `image` the frame's own."""
    frame = Frame(index, changes.pop("number", index), index / 25, changes.pop("image", None))
    return PreparedFrame(frame, status, "", DEPTH, LABELS, geometry=geometry, **changes)


@dataclasses.dataclass(frozen=True)
class State:
    """What a frame of a clip is like."""

    status: str
    """Its status."""
    missing: int = 0
    """Frame numbers that are missing before it."""
    rested: bool = True
    """Whether tissue would be at rest if contact began here."""
    moved: tuple[float, float, float] | None = None
    """How far from rest the followed tissue is [scene units]; None where it is lost."""
    probability: float = math.nan
    """Probability of contact, by whether tissue moves with the tool."""
    undecided: bool = False
    """Whether the tool hovered before, and nothing tells whether it touches since."""


class _Linked(ContactMotion):
    """What links frames to runs of contact, without pictures."""

    rested = True

    def _observe(self, before: PreparedFrame, after: PreparedFrame) -> None:
        pass

    def _dented(self, onset: PreparedFrame) -> bool:
        return not self.rested

    def _begin(self, onset: PreparedFrame) -> ContactRun:
        return ContactRun(onset, np.full(2, np.nan), None, np.zeros(3), None)


def linked(states: Sequence[State], geometry: FrameGeometry, bridge_frames: int = 2) -> list[PreparedFrame]:
    """A clip of such frames, its runs of contact found as in any clip."""
    info = clip_info(bridge_frames=bridge_frames)
    motion = _Linked(info.camera, SIZE, PrepareSettings(bridge_frames=bridge_frames, track_seconds=0.3))
    picture, frames, number = np.zeros((*SIZE[::-1], 3), np.uint8), [], -1
    for index, state in enumerate(states):
        number += 1 + state.missing
        detail, found = ("", geometry) if state.status == "ok" else ("Told.", None)
        depth = 0 * DEPTH if state.status in ("unreadable", "bad_depth") else DEPTH
        shown = LABELS, None if state.status in ("unreadable", "no_mask") else LABELS
        seen = PreparedFrame(Frame(index, number, number / 25, picture), state.status, detail, depth, *shown, found)
        frames.append(dataclasses.replace(seen, contact_probability=state.probability, undecided=state.undecided))
        if index:
            motion.rested = state.rested
            motion.link(*frames[-2:])
        if frames[-1].track_start >= 0 and state.moved is not None:
            frames[-1].track_position = geometry.mesh.vertices[geometry.vertex] + np.array(state.moved)
    return frames


def follow(session: Session, frames: Iterable[PreparedFrame]) -> tuple[list[FrameEstimate], list[InteractionEstimate]]:
    """All that a session says of a clip: its frames and its runs of contact."""
    said = [item for frame in frames for item in session.push(frame)] + list(session.finish())
    return sorted_out(said)


def sorted_out(said: Iterable[Output]) -> tuple[list[FrameEstimate], list[InteractionEstimate]]:
    """Frames and runs of contact, each in the order in which they were said."""
    said = list(said)
    frames = [item for item in said if isinstance(item, FrameEstimate)]
    return frames, [item for item in said if isinstance(item, InteractionEstimate)]
