"""From prepared clips to training samples: pairs of consecutive frames with their windows, contacts and observations.

No sample crosses a clip or a gap in the frame numbers (Bini 2026, section 3.1). What is left out is counted by reason.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from data.clip_cache import PreparedClip
from data.geometry import GeometrySettings, force_direction
from data.prepared import SEEN_OUT
from data.windows import future_indices, window_indices
from physics.mechanics import Mechanics
from physics.mesh import Mesh

OBSERVATIONS = ("final", "release", "trajectory")
PRESS = "press"
Horizon = int | Literal["press"] | None
"""How much of a contact's trajectory counts: so many frames after its onset, those under the tool, or all."""


@dataclass(frozen=True)
class SampleSettings:
    """Which frames become samples, and what of their motion the simulation is compared with."""

    window: int = 1
    """Frames in the network's input, K; 1 is the paper's."""
    observation: Literal["final", "release", "trajectory"] = "final"
    """final (paper): the motion of one frame against the end of the rollout. release: against the rollout at the end of
    its load. trajectory: the contact's whole motion since its onset, at the frames' own time stamps."""
    horizon_frames: Horizon = None
    """Frames after the onset that a trajectory covers; "press" = those in contact, none = as many as the rollout
    lasts."""
    min_deformation: float = 0.0
    """Samples whose observed motion, less the rigid motion, is shorter are left out [scene units]; 0 keeps all."""
    onset_within: int | None = None
    """A trajectory's frame is a sample where its onset is less than this many frames back; none = the window, farther
    back than which no network can see. One that is told the contact's motion beside the window can have more."""
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    """The force's direction is taken from here."""
    mechanics: Mechanics = field(default_factory=Mechanics)
    """The rollout's time base."""

    def __post_init__(self) -> None:
        if self.window < 1:
            raise ValueError(f"window is {self.window}; give at least 1 frame.")
        if self.observation not in OBSERVATIONS:
            raise ValueError(f"observation is '{self.observation}'; choose {', '.join(OBSERVATIONS)}.")
        if self.horizon_frames not in (None, PRESS) and not (
            isinstance(self.horizon_frames, int) and self.horizon_frames >= 1
        ):
            raise ValueError(f"horizon_frames is {self.horizon_frames}; give at least 1, press, or leave it out.")
        if self.onset_within is not None and self.onset_within < 1:
            raise ValueError(f"onset_within is {self.onset_within}; give at least 1, or leave it out.")
        if not (math.isfinite(self.min_deformation) and self.min_deformation >= 0):
            raise ValueError(f"min_deformation is {self.min_deformation}; give a length of at least 0.")


@dataclass(frozen=True)
class ContactCase:
    """What the simulator needs to replay an observed contact, and what was observed."""

    mesh: Mesh
    """Tissue at rest."""
    vertex: int
    """Contact vertex."""
    direction: np.ndarray
    """Unit vector of the force, shape [3], float32."""
    load_steps: int
    """Steps under load."""
    steps: np.ndarray
    """Index into the trajectory of each observation, shape [M], int64."""
    displacement: np.ndarray
    """Observed displacement, shape [M, 3], float32 [scene units]."""
    weight: np.ndarray
    """Weight of each observation, shape [M], float32."""
    noise: float = math.nan
    """Standard deviation of every observed coordinate [scene units]; not a number where it isn't known."""


@dataclass(frozen=True)
class Sample:
    """A pair of consecutive frames t, t + 1 for both generators."""

    window_a: np.ndarray
    """Depth of the frames up to t, oldest first, shape [K, h, w], float32."""
    window_b: np.ndarray
    """Depth of the frames from t + 1 on, the farthest first and t + 1 last, shape [K, h, w], float32."""
    case_a: ContactCase
    """Contact forward in time."""
    case_b: ContactCase
    """Contact backward in time; for trajectories the same as `case_a`, since a damped system does not run backward."""
    clip: str
    """Name of the clip."""
    frame: int
    """Index of t."""
    seen: ContactCase | None = None
    """`case_a` as it was known at frame t; none but for trajectories of a clip whose noise is known."""


def consecutive_pairs(clip: PreparedClip) -> list[int]:
    """Frames t of which t and t + 1 are in contact and bear consecutive numbers."""
    return np.flatnonzero(clip.contact[:-1] & clip.contact[1:] & clip.consecutive[:-1]).tolist()


def list_frames(clip: PreparedClip, settings: SampleSettings) -> tuple[list[int], Counter[str]]:
    """Frames t of a clip that give a sample, and how many others there are by reason."""
    judge = _judge_run if settings.observation == "trajectory" else _judge_pair
    kept, left_out = [], Counter()
    for frame in range(len(clip)):
        reason = judge(clip, frame, settings)
        if reason:
            left_out[reason] += 1
        else:
            kept.append(frame)
    return kept, left_out


def onset_of(clip: PreparedClip, frame: int) -> int:
    """Index of the frame in which the run of contact that `frame` belongs to began, -1 where that was not seen."""
    return int(clip.track_start[frame])


def make_sample(clip: PreparedClip, frame: int, settings: SampleSettings) -> Sample:
    """The sample of a frame that `list_frames` gave."""
    earlier = window_indices(frame, settings.window, clip.consecutive, clip.usable)
    later = future_indices(frame + 1, settings.window, clip.consecutive, clip.usable)
    case_a = make_case(clip, frame, settings)
    case_b = case_a if settings.observation == "trajectory" else _pair_case(clip, frame + 1, clip.backward, settings)
    window_a, window_b = (np.stack([clip.depth(index) for index in indices]) for indices in (earlier, later))
    seen = seen_case(clip, frame, settings) if settings.observation == "trajectory" and case_a.noise > 0 else None
    return Sample(window_a, window_b, case_a, case_b, clip.name, frame, seen)


def make_case(clip: PreparedClip, frame: int, settings: SampleSettings) -> ContactCase:
    """The contact of a sample, forward in time."""
    if settings.observation == "trajectory":
        return _run_case(clip, onset_of(clip, frame), settings)
    return _pair_case(clip, frame, clip.displacement, settings)


def seen_case(clip: PreparedClip, frame: int, settings: SampleSettings) -> ContactCase:
    """The run of contact that a frame belongs to as it was known at that frame: nothing of it comes from later ones.

    But for two things of a few frames: where the contact is was decided in the first five frames after its onset
    (`contact_refinement`), and contact that is bridged counts as contact. `load_steps` are those until the frame, or
    until the contact's end where that was seen before.
    """
    onset = onset_of(clip, frame)
    case = _run_case(clip, onset, settings, last=frame)
    elapsed = round((clip.times[frame] - clip.times[onset]) / settings.mechanics.time_step)
    return replace(case, load_steps=min(case.load_steps, elapsed))


def _judge_pair(clip: PreparedClip, frame: int, settings: SampleSettings) -> str:
    """Why a frame gives no pair, or an empty string."""
    if not clip.contact[frame]:
        return clip.status[frame]
    if not clip.consecutive[frame]:
        return "no next frame"
    if not clip.contact[frame + 1]:
        return "next frame not in contact"
    if not (np.isfinite(clip.displacement[frame]).all() and np.isfinite(clip.backward[frame + 1]).all()):
        return "contact not followed"
    motion = clip.displacement[frame]
    if settings.geometry.rigid_motion == "keep":
        motion = motion - np.nan_to_num(clip.rigid[frame])
    return "rigid motion" if np.linalg.norm(motion) < settings.min_deformation else ""


def _judge_run(clip: PreparedClip, frame: int, settings: SampleSettings) -> str:
    """Why a frame gives no trajectory, or an empty string."""
    onset = onset_of(clip, frame)
    if onset < 0:
        return "onset not seen" if clip.contact[frame] else clip.status[frame]
    if frame - onset >= (settings.onset_within or settings.window):
        return "onset outside the window" if settings.onset_within is None else "onset too far back"
    if not clip.consecutive[frame]:
        return "no next frame"
    if not clip.usable[frame : frame + 2].all():
        return "bad_depth"
    if settings.geometry.smoothing > 0 and not clip.noise[onset] > 0:
        return "noise not known"
    observed, steps = _observed_frames(clip, onset, settings)
    if len(steps) == 0:
        return "contact not followed"
    deformation = clip.track_position[observed] - clip.track_position[onset]
    if settings.geometry.rigid_motion == "keep":
        drift = np.cumsum(np.nan_to_num(clip.rigid[onset : observed[-1]]), axis=0)
        deformation = deformation - drift[observed - onset - 1]
    return "rigid motion" if np.linalg.norm(deformation, axis=1).max() < settings.min_deformation else ""


def _observed_frames(clip: PreparedClip, onset: int, settings: SampleSettings) -> tuple[np.ndarray, np.ndarray]:
    """Frames after an onset in which its tissue point was followed, and the trajectory index of each.

    They end with the last frame in contact where the next one doesn't show whether the tool still presses.
    """
    frames = np.arange(onset + 1, len(clip))
    followed = (clip.track_start[frames] == onset) & np.isfinite(clip.track_position[frames]).all(axis=1)
    pressed = _last_pressed(clip, onset)
    if release_after(clip, pressed) is None:
        followed &= frames <= pressed
    if settings.horizon_frames == PRESS:
        followed &= frames <= pressed
    elif settings.horizon_frames is not None:
        followed &= frames - onset <= settings.horizon_frames
    elapsed = clip.times[frames] - clip.times[onset]
    steps = np.rint(elapsed / settings.mechanics.time_step).astype(np.int64) - 1
    followed &= (steps >= 0) & (steps < settings.mechanics.steps)
    return frames[followed], steps[followed]


def _last_pressed(clip: PreparedClip, onset: int) -> int:
    """The last frame in contact of the run that began at an onset; what flickers in between is pressed as well."""
    return int(np.flatnonzero((clip.track_start == onset) & clip.contact)[-1])


def release_after(clip: PreparedClip, pressed: int) -> int | None:
    """The frame after a run's last one in contact where it was seen out of contact, None where that isn't known.

    A frame without depth or mask says nothing about contact: after it the load isn't known any more.
    """
    after = pressed + 1
    seen = after < len(clip) and clip.consecutive[pressed] and clip.status[after] in SEEN_OUT
    return after if seen else None


def _load_steps(clip: PreparedClip, onset: int, mechanics: Mechanics) -> int:
    """Steps under load: from the first frame in contact to the first frame out of it, or all where none is seen."""
    release = release_after(clip, _last_pressed(clip, onset))
    if release is None:
        return mechanics.steps
    return int(np.clip(round((clip.times[release] - clip.times[onset]) / mechanics.time_step), 1, mechanics.steps))


def _pair_case(clip: PreparedClip, frame: int, motion: np.ndarray, settings: SampleSettings) -> ContactCase:
    """Case of one frame's contact and its motion to a neighbouring frame (`motion`, shape [F, 3])."""
    mechanics = settings.mechanics
    step = mechanics.steps - 1 if settings.observation == "final" else max(mechanics.load_steps - 1, 0)
    return ContactCase(
        mesh=clip.mesh(frame),
        vertex=int(clip.vertex[frame]),
        direction=force_direction(clip.normal[frame], motion[frame], settings.geometry),
        load_steps=mechanics.load_steps,
        steps=np.array([step], np.int64),
        displacement=np.array(motion[frame : frame + 1], np.float32),
        weight=np.ones(1, np.float32),
    )


def _run_case(clip: PreparedClip, onset: int, settings: SampleSettings, last: int | None = None) -> ContactCase:
    """Case of a run of contact, observed at the frames' own time stamps since its onset, up to frame `last`."""
    frames, steps = _observed_frames(clip, onset, settings)
    if last is not None:
        frames, steps = frames[frames <= last], steps[frames <= last]
    mesh, vertex = clip.mesh(onset), int(clip.vertex[onset])
    rest = mesh.vertices[vertex] if math.isfinite(clip.noise[onset]) else clip.track_position[onset]
    displacement = (clip.track_position[frames] - rest).astype(np.float32)
    farthest = max(displacement, key=np.linalg.norm, default=np.zeros(3, np.float32))
    return ContactCase(
        mesh=mesh,
        vertex=vertex,
        direction=force_direction(clip.normal[onset], farthest, settings.geometry),
        load_steps=_load_steps(clip, onset, settings.mechanics),
        steps=steps,
        displacement=displacement,
        weight=np.ones(len(steps), np.float32),
        noise=float(clip.noise[onset]),
    )


def contact_cases(clip: PreparedClip, settings: SampleSettings) -> dict[int, ContactCase]:
    """Every run of contact of a clip whose onset was seen and whose tissue was followed, by the frame of its onset."""
    onsets = np.flatnonzero(clip.track_start == np.arange(len(clip))).tolist()
    return {
        onset: _run_case(clip, onset, settings) for onset in onsets if len(_observed_frames(clip, onset, settings)[1])
    }
