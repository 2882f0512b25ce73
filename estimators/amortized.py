"""The amortised estimator: a trained network gives every frame its parameters, and the simulator the expected motion.

Source: Bini 2026, section 3.4.4: per frame depth, mesh and contact; one forward pass; one forward simulation. The
generator and the discriminators stay at home.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from data.camera import Camera
from data.clip import ClipStream, PreparedFrame
from data.geometry import force_direction
from data.prepared import SEEN_OUT
from data.tissue_points import grid_to_picture
from data.windows import FrameWindow
from estimators.estimate import ContactEstimate, FrameEstimate, Verdict, uncertainty
from estimators.model_settings import section
from models.onnx_session import ModelFileError, ParameterModel
from physics.mechanics import Bounds, Mechanics
from physics.msd_kernel import simulate

OBSERVATIONS = ("final", "release", "trajectory")
FULL_ARROW = 0.3
"""Length of the drawn arrow of the largest admissible force, as a share of the contact point's depth."""


@dataclass(frozen=True)
class FrameResult:
    """Everything about one frame that is written or drawn."""

    prepared: PreparedFrame
    """The frame, its labels and its contact."""
    estimate: FrameEstimate
    """Its parameters, or why there are none."""
    arrow: tuple[tuple[float, float], tuple[float, float]] | None
    """Tail and tip (u, v) of the force that acts on the contact point [px of the source frame]; None without force."""


class AmortizedEstimator:
    """Runs a trained parameter network over prepared clips.

    Args:
        model: the exported network.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    def __init__(self, model: ParameterModel) -> None:
        self.model = model
        self.mechanics: Mechanics = section(model, "mechanics", Mechanics)
        self.bounds: Bounds = section(model, "bounds", Bounds)
        self.observation: str = model.metadata.get("observation", "final")
        if self.observation not in OBSERVATIONS:
            raise ModelFileError(
                f"{model.path} was trained with the unknown observation '{self.observation}'; export it again."
            )
        self.seconds: dict[str, float] = defaultdict(float)
        """Time spent on the current clip in `network` and `simulation` [s]."""

    def run(self, clip: ClipStream) -> Iterator[FrameResult]:
        """Results of a clip's frames, one for each, in order; memory does not grow with the clip.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        self.seconds.clear()
        window, statuses = FrameWindow(self.model.window), deque[str](maxlen=self.model.window)
        onset: PreparedFrame | None = None
        previous: PreparedFrame | None = None
        for current, following in pairwise(chain(clip, [None])):
            depth = window.push(current)
            if previous is not None and not previous.consecutive:
                statuses.clear()
            statuses.append(current.status)
            if current.track_start == current.frame.index:
                onset = current
            known = onset if onset is not None and current.track_start == onset.frame.index else None
            if current.in_contact:
                theta = self._theta(depth, current)
                lengths = self._displacements(theta, current, following, known, clip)
                estimate = frame_estimate(current, clip, theta, lengths, _verdict(statuses))
                yield FrameResult(current, estimate, force_arrow(theta, current, clip, self.bounds))
            else:
                yield FrameResult(current, frame_estimate(current, clip), None)
            previous = current

    def _theta(self, window: np.ndarray, prepared: PreparedFrame) -> np.ndarray:
        """θ = [k_s, k_d, F] of a depth window, shape [3]."""
        start = time.perf_counter()
        theta = self.model(window[None])[0]
        self.seconds["network"] += time.perf_counter() - start
        if not np.isfinite(theta).all():
            raise ModelFileError(
                f"{self.model.path} gives a number that is not finite for frame {prepared.frame.number}; "
                "its training did not succeed, export another checkpoint."
            )
        return theta

    def _displacements(
        self,
        theta: np.ndarray,
        current: PreparedFrame,
        following: PreparedFrame | None,
        onset: PreparedFrame | None,
        clip: ClipStream,
    ) -> tuple[float | None, float | None]:
        """Lengths of the simulated and of the observed displacement at the instant that the model was trained on.

        `final`: the contact after T steps, and its motion to the next frame. `release`: the same after the load's last
        step. `trajectory`: the contact of the frame of onset, under load since then, at the time of the next frame, and
        where its tissue point is then; None where the onset was not seen or lies further back than the horizon.
        """
        steps, load_steps = self.mechanics.steps, self.mechanics.load_steps
        start, observed = current, current.displacement
        if self.observation == "release":
            steps = max(load_steps, 1)
        if self.observation == "trajectory":
            moment = current.frame.time_s + 1 / clip.source.fps if following is None else following.frame.time_s
            steps = 0 if onset is None else round((moment - onset.frame.time_s) / self.mechanics.time_step)
            if not 1 <= steps <= self.mechanics.steps:
                return None, None
            start, load_steps = onset, steps
            goes_on = following is not None and following.track_start == onset.frame.index
            observed = following.track_position - onset.track_position if goes_on else None
        mechanics = dataclasses.replace(self.mechanics, steps=steps, load_steps=min(load_steps, steps))
        started = time.perf_counter()
        contact = start.geometry
        direction = force_direction(contact.normal, observed, clip.settings.geometry)
        path = simulate(theta, contact.mesh, contact.vertex, direction, mechanics)
        self.seconds["simulation"] += time.perf_counter() - started
        return _length(path[-1]), None if observed is None else _length(observed)


def force_arrow(
    theta: np.ndarray, prepared: PreparedFrame, clip: ClipStream, bounds: Bounds
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """The force as it acts: an arrow that ends at the contact point, as long in the scene as |F| is large."""
    contact, largest = prepared.geometry, max(abs(value) for value in bounds.force)
    tip = contact.tissue_point.astype(np.float64)
    direction = force_direction(contact.normal, prepared.displacement, clip.settings.geometry)
    tail = tip - direction * (FULL_ARROW * tip[2] * float(theta[2]) / largest)
    if theta[2] == 0 or tail[2] <= 0:
        return None
    return _project(tail, clip.picture_camera), _project(tip, clip.picture_camera)


def frame_estimate(
    prepared: PreparedFrame,
    clip: ClipStream,
    theta: np.ndarray | None = None,
    lengths: tuple[float | None, float | None] = (None, None),
    verdict: Verdict = "",
    found: ContactEstimate | None = None,
) -> FrameEstimate:
    """The record of a frame; without θ it holds the status and what is known of the contact.

    Args:
        theta: k_s, k_d and signed F, shape [3].
        lengths: of the simulated and the observed displacement [scene units].
        verdict: what the data determine.
        found: the estimate with its uncertainty, where the model gives one.
    """
    frame, contact, detail = prepared.frame, prepared.geometry, prepared.detail
    if contact is not None and lengths[0] is None:
        detail = detail or "No displacement: the onset of contact was not seen, or lies beyond the model's horizon."
    touching = True if contact is not None else False if prepared.status in SEEN_OUT else None
    distance = float(prepared.distance) if math.isfinite(prepared.distance) else None
    u, v = None, None
    if contact is not None:
        place = grid_to_picture(np.array(contact.pixel), prepared.depth.shape, clip.source.size)
        u, v = float(place[0]), float(place[1])
    stiffness, damping, force = (None, None, None) if theta is None else (float(value) for value in theta)
    return FrameEstimate(
        frame.number,
        frame.time_s,
        prepared.status,
        detail=detail,
        verdict=verdict,
        stiffness=stiffness,
        damping=damping,
        force=None if force is None else abs(force),
        contact=touching,
        contact_distance=distance,
        contact_u=u,
        contact_v=v,
        simulated_displacement=lengths[0],
        observed_displacement=lengths[1],
        **({} if found is None else uncertainty(found)),
    )


def _verdict(statuses: deque[str]) -> Verdict:
    """Whether a window of consecutive frames shows contact begin, without which θ is undetermined."""
    begins = any(before in SEEN_OUT and after == "ok" for before, after in pairwise(statuses))
    return "onset_in_view" if begins else "undetermined"


def _length(vector: np.ndarray) -> float | None:
    """Euclidean length; None where the vector has a number that is not finite."""
    length = float(np.linalg.norm(vector))
    return length if math.isfinite(length) else None


def _project(point: np.ndarray, camera: Camera) -> tuple[float, float]:
    """Pixel (u, v) of a point in front of the camera, shape [3] (the inverse of Bini 2026, equation 3)."""
    return (
        float(camera.fx * point[0] / point[2] + camera.cx),
        float(camera.fy * point[1] / point[2] + camera.cy),
    )
