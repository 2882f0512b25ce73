"""A run of contact as the simulator replays it: tissue at rest, what acts on it, what was observed of it.

Frames are gathered one by one (`InteractionBuilder`), live or from a prepared clip, and the same code makes an
`Interaction` of them at any moment (Bini 2026, sections 3.2.2 and 3.3).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from palpate.data.contact.geometry import GeometrySettings, force_direction
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.sequence import ShadingSequence
from palpate.physics.depth import DepthSequence
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.observation import Observation

PRESS = "press"
Horizon = int | Literal["press"] | None
"""Share of a contact's motion that counts: so many frames after its onset, those under the tool, or all."""
SHADING = "shading"
"""Observation of how the tissue's light changes around a contact."""
SAME_INSTANT = 1e-6
"""Times nearer to each other than this are one [s]."""


class Recorder(Protocol):
    """Gathers one kind of observation of a run of contact."""

    def frame(self, frame: Any, /) -> Any | None:
        """Return what the next frame after the onset adds; None = nothing."""

    def record(self, times: np.ndarray, values: list[Any], known: int, /) -> Any:
        """Return what was observed, a record: its `times` [N], and `chosen`, the same at a mask [N] or indices.

        Args:
            times: of the frames that count, since the onset [s].
            values: what they added.
            known: number of frames that had added something by then.
        """


@dataclass(frozen=True, eq=False)
class Interaction:
    """A run of contact as the simulator replays it, and what was observed of it."""

    mesh: Mesh
    """Tissue at rest."""
    load: Press
    """Load on it; ``held`` to its last step where the release was not observed."""
    observations: Mapping[str, Any]
    """Records by the names of observations (`observations.kinds`), and that of the followed point."""
    time_step: float
    """Time step of the load [s]."""
    intervals: int = 1
    """Frame intervals within which the press began, and ended; more than 1 where frames before those are gaps."""

    @property
    def observation(self) -> Observation:
        """The followed points."""
        return self.observations["point"]

    @property
    def sequence(self) -> DepthSequence | None:
        """Depth of all tissue around the contact; None where it wasn't kept or its noise isn't known."""
        return self.observations.get("depth")

    @property
    def shading(self) -> ShadingSequence | None:
        """Light around the contact; None where it wasn't kept, or nothing was observed of it at rest."""
        return self.observations.get(SHADING)

    def having(self, **records: Any) -> Interaction:
        """Return the contact with other records; None = without one of that name."""
        both = {**self.observations, **records}
        kept = {name: record for name, record in both.items() if record is not None}
        return dataclasses.replace(self, observations=kept)

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

    def unhidden(self) -> Interaction:
        """Return the contact, with unknown displacements at its depth's times where its point was always hidden."""
        if len(self.observation) or self.sequence is None:
            return self
        times = self.sequence.times
        unknown = np.full((len(times), 3), np.nan, np.float32)
        return self.having(point=Observation.of_point(self.vertex, times, unknown, self.noise))

    def observed(self, instants: np.ndarray) -> Interaction:
        """Return the interaction, observed at some of its instants only, a mask or indices; other records as far as the
        last."""
        point = self.observation.chosen(instants)
        last = point.times[-1] + SAME_INSTANT if len(point) else -math.inf
        others = {name: record.chosen(record.times <= last) for name, record in self.observations.items()}
        return self.having(**others | {"point": point})


class PointRecorder:
    """Gathers the positions of the contact vertex.

    Args:
        vertex, rest: the contact vertex, and where it is at rest, shape [3] [scene units].
        noise: standard deviation of the depth [scene units].
    """

    def __init__(self, vertex: int, rest: np.ndarray, noise: float) -> None:
        self._vertex, self._rest, self._noise = vertex, rest, noise

    def frame(self, frame: PreparedFrame) -> np.ndarray | None:
        """Displacement, shape [3]; None where the tissue is lost."""
        position = np.asarray(frame.track_position, np.float32)
        return position - self._rest if np.isfinite(position).all() else None

    def record(self, times: np.ndarray, values: list[np.ndarray], _: int) -> Observation:
        """See `Recorder`."""
        return Observation.of_point(self._vertex, times, np.array(values, np.float32).reshape(-1, 3), self._noise)


class InteractionBuilder:
    """Gathers the frames of one run of contact whose onset was observed; what counts no more is not kept.

    Args:
        mesh, vertex, normal: tissue at rest, the contact vertex and its normal [3].
        noise: standard deviation of the depth [scene units]; not a number where it isn't known.
        onset: the first frame in contact.
        settings: the force's direction is taken from here.
        seconds: how long the motion counts [s].
        recorders: by the names of observations, that of the followed point apart.
    """

    def __init__(
        self,
        mesh: Mesh,
        vertex: int,
        normal: np.ndarray,
        noise: float,
        onset: PreparedFrame,
        settings: GeometrySettings,
        seconds: float,
        recorders: Mapping[str, Recorder] = {},
    ) -> None:
        self.mesh, self.vertex, self.normal, self.settings = mesh, vertex, normal, settings
        self.start, self.seconds = onset.time_s, seconds
        # Where the noise is known, so is the rest surface: the mean of many frames, without the onset's own error.
        rest = mesh.vertices[vertex] if math.isfinite(noise) else onset.track_position
        self.rest = np.asarray(rest, np.float32)
        """Where the contact vertex is at rest, shape [3], float32 [scene units]."""
        self.pressed = 0
        """The last frame in contact, counted from the onset; contact may flicker before it."""
        self.load_seconds: float | None = None
        """Time from the onset to the first frame observed out of contact [s]; None where that was not observed.

        A frame without depth or mask says nothing about contact: after it the load isn't known any more.
        """
        self._count, self._followed_on, self._intervals = 1, onset.consecutive, 1 + len(onset.skipped)
        # In single precision, and positions, too: what networks are trained on, whatever a frame comes from.
        point = PointRecorder(vertex, self.rest, float(np.float32(noise)))
        self._recorders: dict[str, Recorder] = {"point": point, **recorders}
        self._added: dict[str, list[tuple[int, float, Any]]] = {name: [] for name in self._recorders}
        """Observations of frames, with their numbers and times since the onset [s]."""

    def add(self, frame: PreparedFrame) -> None:
        """The next frame."""
        index, since = self._count, frame.time_s - self.start
        self._count += 1
        if frame.in_contact:
            self.pressed, self._followed_on, self.load_seconds = index, frame.consecutive, None
        elif index == self.pressed + 1 and self._followed_on and frame.out_of_contact:
            self.load_seconds, self._intervals = since, max(self._intervals, 1 + len(frame.skipped))
        for name, recorder in self._recorders.items() if since < self.seconds else ():
            value = recorder.frame(frame)
            if value is not None:
                self._added[name].append((index, since, value))

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
        latest, records = math.inf if until is None else until, {}
        for name, recorder in self._recorders.items():
            known = [item for item in self._added[name] if item[1] <= latest]
            kept = [item for item in known if item[0] <= last and step / 2 <= item[1] < mechanics.seconds]
            times = np.array([since for _, since, _ in kept])
            records[name] = recorder.record(times, [value for *_, value in kept], len(known))
        moved: np.ndarray = records["point"].displacement[0]
        farthest = moved[np.linalg.norm(moved, axis=1).argmax()] if len(moved) else np.zeros(3, np.float32)
        loaded = steps if self.load_seconds is None else int(np.clip(round(self.load_seconds / step), 1, steps))
        if until is not None:
            loaded = min(loaded, round(until / step))
        direction = force_direction(self.normal, farthest, self.settings)
        press = Press.at(self.vertex, direction, held(loaded, steps))
        return Interaction(self.mesh, press, records, step, self._intervals)
