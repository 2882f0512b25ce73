"""From prepared clips to training samples: pairs of consecutive frames with their windows, contacts and observations.

No sample crosses a clip or a gap in the frame numbers (Bini 2026, section 3.1). Other frames are counted by reason.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np

from palpate.common.settings import LARGEST, Checked, NotNegative
from palpate.data.cache import PreparedClip
from palpate.data.contact.depth_sequence import SequenceRecorder
from palpate.data.contact.geometry import GeometrySettings, force_direction
from palpate.data.contact.interaction import Interaction, InteractionBuilder
from palpate.data.windows import future_indices, window_indices
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.observation import Observation


@dataclass(frozen=True)
class SampleSettings(Checked, group="samples."):
    """Choice of samples, and of the motion with which the simulation is compared."""

    # Largest window [frames]: ten seconds at 25 frames a second.
    window: Annotated[int, 1, 256] = 1
    """Frames in the network's input, K; 1 is the paper's."""
    observation: Literal["final", "trajectory"] = "final"
    """final (paper): the motion to the next frame is compared with the end of the rollout. trajectory: all motion since
    the onset, the contact's or the depth-change sequence's, is compared at the frames' own time stamps."""
    horizon: Annotated[int, 1, LARGEST] = 1
    """Frames from a sample's current frame to the predicted one. At the paper's 1, most of the change is noise. More
    need observation trajectory."""
    min_clip_deformation: NotNegative = 0.0
    """Least root mean square motion of a clip's contact from frame to frame, less the rigid motion [scene units]; 0
    keeps all clips. Below it the camera moves and nothing deforms. Bini 2026, section 3.1, leaves such clips out and
    states no rule."""
    onset_within: Annotated[int, 1, LARGEST] | None = None
    """A trajectory's frame is a sample if its onset is less than this many frames back; none = the window's length,
    the network's input. A network that gets the contact's motion as well can use more."""
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    """Geometry settings, which decide the force's direction."""
    mechanics: Mechanics = field(default_factory=Mechanics)
    """Mechanics with the rollout's time steps."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon > 1 and self.observation != "trajectory":
            raise ValueError(f"samples.horizon is {self.horizon}; more than 1 needs observation trajectory.")


@dataclass(frozen=True)
class Sample:
    """A pair of frames t, t + horizon for both generators."""

    window_a: np.ndarray
    """Depth of the frames up to t, oldest first, shape [K, h, w], float32."""
    window_b: np.ndarray
    """Depth of the frames from t + horizon on, the farthest first, shape [K, h, w], float32."""
    interaction_a: Interaction
    """Interaction forward in time."""
    interaction_b: Interaction
    """Interaction backward in time; for trajectories the forward one, since a damped system does not run backward."""
    clip: str
    """Name of the clip."""
    frame: int
    """Index of t."""
    course_a: tuple[int, int]
    """Steps of the rollout of `interaction_a` at frame t and at the predicted frame."""
    course_b: tuple[int, int]
    """Steps of the rollout of `interaction_b` at frame t + horizon and at the predicted frame t."""
    known: Interaction | None = None
    """`interaction_a` up to frame t, for trajectories of a clip whose noise is known, else None."""


def list_frames(clip: PreparedClip, settings: SampleSettings) -> tuple[list[int], Counter[str]]:
    """Frames t of a clip that give a sample, and counts of the others by reason."""
    judge = _judge_run if settings.observation == "trajectory" else _judge_pair
    reasons = [judge(clip, frame, settings) for frame in range(len(clip))]
    kept = [frame for frame, reason in enumerate(reasons) if not reason]
    left_out = Counter(filter(None, reasons))
    if kept and settings.min_clip_deformation > 0:
        # Observed motion of the contact to the next frame, less the rigid motion.
        rigid = np.nan_to_num(clip.rigid) if settings.geometry.rigid_motion == "keep" else 0.0
        squares = np.square((clip.displacement - rigid)[kept]).sum(axis=1)
        if not np.sqrt(np.nanmean(squares)) >= settings.min_clip_deformation:
            return [], left_out + Counter({"clip hardly deforms": len(kept)})
    return kept, left_out


def make_sample(clip: PreparedClip, frame: int, settings: SampleSettings) -> Sample:
    """The sample of a frame that `list_frames` gave.

    Raises:
        ValueError: no depth around the frame.
    """
    earlier = window_indices(frame, settings.window, clip.consecutive, clip.usable)
    later = future_indices(frame + settings.horizon, settings.window, clip.consecutive, clip.usable)
    if earlier is None or later is None:
        raise ValueError(f"{clip.path} has no depth around frame {frame}; take a frame that list_frames gave.")
    backward = known = None
    if settings.observation != "trajectory":
        forward = make_interaction(clip, frame, settings)
        backward = _pair(clip, frame + 1, clip.backward, settings)
        onward = course = 0, settings.mechanics.steps
    else:
        onset = int(clip.track_start[frame])
        run = builder_of(clip, onset, settings, sequence_until=frame)
        forward = run.build(settings.mechanics).having(depth=None)
        since = clip.times[[frame, frame + settings.horizon]] - clip.times[onset]
        first, last = np.rint(since / settings.mechanics.time_step).astype(int).tolist()
        onward, course = (first, last), (last, first)
        if forward.noise > 0:
            known = run.build(settings.mechanics, until=float(since[0]))
    window_a, window_b = (np.stack([clip.depth(index) for index in indices]) for indices in (earlier, later))
    return Sample(window_a, window_b, forward, backward or forward, clip.name, frame, onward, course, known)


def make_interaction(clip: PreparedClip, frame: int, settings: SampleSettings) -> Interaction:
    """The contact of a sample, forward in time."""
    if settings.observation == "trajectory":
        return builder_of(clip, int(clip.track_start[frame]), settings).build(settings.mechanics)
    return _pair(clip, frame, clip.displacement, settings)


def builder_of(
    clip: PreparedClip, onset: int, settings: SampleSettings, *, sequence_until: int | None = None
) -> InteractionBuilder:
    """Builder of the run of contact that began at an onset, with all its frames.

    Args:
        clip: prepared clip.
        onset: index of the run's first frame.
        settings: settings of the samples.
        sequence_until: index of the last frame of the depth-change sequence; None = keep no sequence.
    """

    def frame_of(index: int) -> Any:
        return clip.frame(index, sequence_until is not None and index <= sequence_until)

    found = clip.mesh(onset), int(clip.vertex[onset])
    noise, first = float(clip.noise[onset]), frame_of(onset)
    depth = None if sequence_until is None else SequenceRecorder.of(*found, noise, clip.size, first)
    recorders = {} if depth is None else {"depth": depth}
    kept = first, settings.geometry, settings.mechanics.seconds, recorders
    run = InteractionBuilder(*found, clip.normal[onset], noise, *kept)
    for index in range(onset + 1, len(clip)):
        if clip.track_start[index] != onset:
            break
        run.add(frame_of(index))
    return run


def _judge_pair(clip: PreparedClip, frame: int, _: SampleSettings) -> str:
    """Reason for no pair at a frame, or an empty string."""
    if not clip.contact[frame]:
        return clip.status[frame]
    if not clip.consecutive[frame]:
        return "no next frame"
    if not clip.contact[frame + 1]:
        return "next frame not in contact"
    followed = np.isfinite(clip.displacement[frame]).all() and np.isfinite(clip.backward[frame + 1]).all()
    return "" if followed else "contact not followed"


def _judge_run(clip: PreparedClip, frame: int, settings: SampleSettings) -> str:
    """Reason for no trajectory at a frame, or an empty string."""
    onset = int(clip.track_start[frame])
    if onset < 0:
        return "onset not observed" if clip.contact[frame] else clip.status[frame]
    if frame - onset >= (settings.onset_within or settings.window):
        return "onset outside the window" if settings.onset_within is None else "onset too far back"
    predicted = frame + settings.horizon
    if predicted >= len(clip) or not clip.consecutive[frame:predicted].all():
        return "no next frame"
    if not clip.usable[[frame, predicted]].all():
        return "bad_depth"
    if settings.geometry.smoothing > 0 and not clip.noise[onset] > 0:
        return "noise not known"
    contact = builder_of(clip, onset, settings).build(settings.mechanics)
    return "" if len(contact.observation) else "contact not followed"


def _pair(clip: PreparedClip, frame: int, motion: np.ndarray, settings: SampleSettings) -> Interaction:
    """One frame's contact and its motion to a neighbouring frame (`motion`, shape [F, 3])."""
    mechanics, vertex = settings.mechanics, int(clip.vertex[frame])
    direction = force_direction(clip.normal[frame], motion[frame], settings.geometry)
    press = Press.at(vertex, direction, held(mechanics.load_steps, mechanics.steps))
    moved = Observation.of_point(vertex, np.array([mechanics.seconds]), motion[frame : frame + 1], math.nan)
    return Interaction(clip.mesh(frame), press, {"point": moved}, mechanics.time_step)
