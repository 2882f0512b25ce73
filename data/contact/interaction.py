"""A run of contact as the simulator replays it: tissue at rest, what acts on it, what was observed of it.

Frames are gathered one by one (`InteractionBuilder`), live or from a prepared clip, and the same code makes an
`Interaction` of them at any moment (Bini 2026, sections 3.2.2 and 3.3).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.data.contact.depth_sequence import DepthSequence, SequenceRecorder
from palpate.data.contact.geometry import GeometrySettings, force_direction
from palpate.data.shading.registration import View
from palpate.data.shading.sequence import RestingLight, ShadingRecorder, ShadingSequence
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.observation import Observation

PRESS = "press"
Horizon = int | Literal["press"] | None
"""How much of a contact's motion counts: so many frames after its onset, those under the tool, or all."""
SHADING = "shading"
"""Observation of how the tissue's light changes around a contact."""
SAME_INSTANT = 1e-6
"""Times nearer to each other than this are one [s]."""


@dataclass(frozen=True, eq=False)
class Interaction:
    """What the simulator needs to replay a run of contact, and what was observed of it."""

    mesh: Mesh
    """Tissue at rest."""
    load: Press
    """What acts on it; ``held`` to its last step where the release was not observed."""
    observation: Observation
    """The followed points."""
    time_step: float
    """Time step of the load [s]."""
    sequence: DepthSequence | None = None
    """Depth of all tissue around the contact; None where it wasn't kept or its noise isn't known."""
    shading: ShadingSequence | None = None
    """Light around the contact; None where it wasn't kept, or nothing was observed of it at rest."""
    intervals: int = 1
    """Frame intervals within which the press began, and ended; more than 1 where frames before those are gaps."""

    @property
    def vertex(self) -> int:
        """The contact vertex."""
        return self.load.vertex

    @property
    def direction(self) -> np.ndarray:
        """Unit vector of the force, shape [3]."""
        return self.load.direction

    @property
    def load_seconds(self) -> float:
        """Time under load, as far as the load's steps reach [s]."""
        return float(self.load.factor.sum()) * self.time_step

    @property
    def released(self) -> bool:
        """Whether the load ends within its steps."""
        return bool(self.load.factor[-1] < 1)

    @property
    def steps(self) -> int:
        """Steps until the last observation."""
        return int(self.observation.steps(self.time_step)[-1]) + 1

    @property
    def shows_light(self) -> bool:
        """Whether any frame shows the light around the contact."""
        return self.shading is not None and len(self.shading.times) > 0

    @property
    def noise(self) -> float:
        """Standard deviation of the contact's observed displacement along the camera's axis [scene units]."""
        return self.observation.depth_noise

    @property
    def moved(self) -> np.ndarray:
        """Observed displacement of the contact vertex, shape [N, 3] [scene units]."""
        return self.observation.displacement[0]

    @property
    def along(self) -> np.ndarray:
        """Observed motion along the force's direction, shape [N], float64 [scene units]."""
        return self.moved.astype(np.float64) @ np.asarray(self.direction, np.float64)

    def observed(self, instants: np.ndarray) -> Interaction:
        """Return the interaction, observed at some of its instants only, a mask or indices; its sequence as far as the
        last."""
        observation, sequence, shading = self.observation.chosen(instants), self.sequence, self.shading
        last = observation.times[-1] + SAME_INSTANT if len(observation) else -math.inf
        if sequence is not None:
            sequence = sequence.chosen(sequence.times <= last)
        if shading is not None:
            shading = shading.chosen(shading.times <= last)
        return dataclasses.replace(self, observation=observation, sequence=sequence, shading=shading)


@dataclass(frozen=True)
class ContactFrame:
    """What is known of a run of contact by one frame."""

    time_s: float
    """Time stamp [s]."""
    contact: bool
    """Whether the tool touches the tissue."""
    out_of_contact: bool
    """Whether the frame was observed out of contact; without depth or mask nobody knows."""
    consecutive: bool
    """Whether the next frame bears the next number."""
    position: np.ndarray
    """Where the followed tissue is, shape [3] [scene units]; not a number where it is lost."""
    depth: np.ndarray | None = None
    """z on the grid, shape [h, w] [scene units], 0 = invalid; None where no depth-change sequence is kept."""
    labels: np.ndarray | None = None
    """Label map on the grid, shape [h, w]."""
    light: np.ndarray | None = None
    """Logarithm of the tissue's light, as in `data.shading.light.log_light`; None where it isn't looked at."""
    light_view: View | None = None
    """The view in which that light lies on its lattice; None = the frame's own, of a camera that stands still."""
    skipped: int = 0
    """Number of frames right before it that measure nothing."""


class InteractionBuilder:
    """Gathers the frames of one run of contact whose onset was observed; what counts no more is not kept.

    Args:
        mesh, vertex, normal: tissue at rest, the contact vertex and its normal [3].
        noise: standard deviation of the depth [scene units]; not a number where it isn't known.
        onset: the first frame in contact.
        settings: the force's direction is taken from here.
        seconds: how long the motion counts [s].
        size: width and height of the pictures [px]; None = keep no depth-change sequence.
        rest_light: light of the tissue at rest; None = keep no shading sequence.
    """

    def __init__(
        self,
        mesh: Mesh,
        vertex: int,
        normal: np.ndarray,
        noise: float,
        onset: ContactFrame,
        settings: GeometrySettings,
        seconds: float,
        size: tuple[int, int] | None = None,
        rest_light: RestingLight | None = None,
    ) -> None:
        self.mesh, self.vertex, self.normal, self.settings = mesh, vertex, normal, settings
        # In single precision, and positions below: what networks are trained on, whatever a frame comes from.
        self.noise = float(np.float32(noise))
        self.start, self.seconds = onset.time_s, seconds
        # Where the noise is known, so is the rest surface: the mean of many frames, without the onset's own error.
        rest = mesh.vertices[vertex] if math.isfinite(noise) else onset.position
        self.rest = np.asarray(rest, np.float32)
        """Where the contact vertex is at rest, shape [3], float32 [scene units]."""
        self.pressed = 0
        """The last frame in contact, counted from the onset; contact may flicker before it."""
        self.load_seconds: float | None = None
        """Time from the onset to the first frame observed out of contact [s]; None where that was not observed.

        A frame without depth or mask says nothing about contact: after it the load isn't known any more.
        """
        self._count, self._followed_on, self._intervals = 1, onset.consecutive, 1 + onset.skipped
        self._followed: list[tuple[int, float, np.ndarray]] = []
        known = math.isfinite(self.noise)
        self._recorder = SequenceRecorder(mesh, vertex, self.noise, size) if size is not None and known else None
        self._sequence: list[tuple[int, float, np.ndarray]] = []
        self._sequence_of(onset)
        pixel, view = mesh.pixels[vertex], onset.light_view
        pixel = pixel if view is None else np.rint(view.moved(pixel)).astype(np.int64)
        self._light = None if rest_light is None else ShadingRecorder(rest_light.median(), pixel)
        self._reference = None if view is None else view.reference
        self._brightness: list[tuple[int, float, np.ndarray]] = []

    def add(self, frame: ContactFrame) -> None:
        """The next frame."""
        index, since = self._count, frame.time_s - self.start
        self._count += 1
        if frame.contact:
            self.pressed, self._followed_on, self.load_seconds = index, frame.consecutive, None
        elif index == self.pressed + 1 and self._followed_on and frame.out_of_contact:
            self.load_seconds, self._intervals = since, max(self._intervals, 1 + frame.skipped)
        position = np.asarray(frame.position, np.float32)
        if since >= self.seconds:
            return
        if np.isfinite(position).all():
            self._followed.append((index, since, position))
        change = self._sequence_of(frame)
        if change is not None:
            self._sequence.append((index, since, change))
        reference = None if frame.light_view is None else frame.light_view.reference
        if self._light is None or frame.light is None or reference != self._reference:
            return
        light = self._light.frame(frame.light)
        if light is not None:
            self._brightness.append((index, since, light))

    def _sequence_of(self, frame: ContactFrame) -> np.ndarray | None:
        """What a frame adds to the depth-change sequence."""
        if self._recorder is None or frame.depth is None or frame.labels is None:
            return None
        return self._recorder.frame(frame.depth, frame.labels)

    def build(self, mechanics: Mechanics, horizon: Horizon = None, until: float | None = None) -> Interaction:
        """The run as far as it was observed; maybe without any observation.

        Args:
            mechanics: its time step is the load's, its steps the longest observation.
            horizon: how much of the motion counts.
            until: as it was known so long after the onset [s]: later frames count for nothing but the two things that
                are decided some frames late, where the contact is and whether contact only flickers.
        """
        step, steps = mechanics.time_step, mechanics.steps
        last = self.pressed if self.load_seconds is None or horizon == PRESS else math.inf
        last = min(last, horizon) if isinstance(horizon, int) else last

        def counts(index: int, since: float) -> bool:
            return index <= last and step / 2 <= since < mechanics.seconds and (until is None or since <= until)

        followed = [(since, position) for index, since, position in self._followed if counts(index, since)]
        moved = np.array([position - self.rest for _, position in followed], np.float32).reshape(-1, 3)
        farthest = max(moved, key=np.linalg.norm, default=np.zeros(3, np.float32))
        loaded = steps if self.load_seconds is None else int(np.clip(round(self.load_seconds / step), 1, steps))
        if until is not None:
            loaded = min(loaded, round(until / step))
        direction = force_direction(self.normal, farthest, self.settings)
        press = Press.at(self.vertex, direction, held(loaded, steps))
        observation = Observation.of_point(self.vertex, np.array([since for since, _ in followed]), moved, self.noise)
        sequence = None
        if self._recorder is not None:
            kept = [(since, change) for index, since, change in self._sequence if counts(index, since)]
            known = sum(until is None or since <= until for _, since, _ in self._sequence)
            times = np.array([since for since, _ in kept])
            sequence = self._recorder.sequence(times, [change for _, change in kept], known)
        shading = None
        if self._light is not None:
            lit = [(since, light) for index, since, light in self._brightness if counts(index, since)]
            shading = self._light.sequence(np.array([since for since, _ in lit]), [light for _, light in lit])
        return Interaction(self.mesh, press, observation, step, sequence, shading, self._intervals)
