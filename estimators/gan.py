"""The parameter network of a trained generator: θ of every frame in contact, and the motion that the simulator expects.

Source: Bini 2026, section 3.4.4: per frame depth, mesh and contact; one forward pass; one forward simulation. Decoder
and discriminators are not needed.
"""

from collections import deque
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from palpate.data.contact.geometry import force_direction
from palpate.data.prepared import PreparedFrame
from palpate.data.windows import FrameWindow
from palpate.estimators.contract import ClipInfo, Output
from palpate.estimators.estimate import Estimate
from palpate.estimators.model_settings import ModelEstimator
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.runs import Run, RunSession, finite, force_arrow, frame_estimate
from palpate.models.onnx_session import ModelFileError, ParameterModel
from palpate.physics.load import Press, held
from palpate.physics.mechanics import SIGNS
from palpate.physics.msd.simulation import simulate

OBSERVATIONS = ("final", "trajectory")
MIN_MAGNITUDE = 1e-12
"""Smaller magnitudes of parameters count as this before their logarithm is taken."""


class GanEstimator(ModelEstimator):
    """Runs a trained parameter network over prepared clips.

    Args:
        model: the exported network.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    name = "gan"
    model: ParameterModel

    def __init__(self, model: ParameterModel) -> None:
        super().__init__(model)
        self.described = {"name": self.name}
        """All other settings are in the model's file."""
        self.observation: str = model.metadata.get("observation", "final")
        if self.observation not in OBSERVATIONS:
            raise ModelFileError(
                f"{model.path} was trained with the unknown observation '{self.observation}'; export it again."
            )

    def start(self, clip: ClipInfo) -> "GanSession":
        """Open a session."""
        return GanSession(self, clip)


class GanSession(RunSession):
    """One clip; estimates come one frame late, because each includes the motion to the next frame."""

    def __init__(self, estimator: GanEstimator, clip: ClipInfo) -> None:
        # Runs are followed at the clip's own frame rate; a frame's motion is simulated with the steps of the training.
        super().__init__(clip, estimator.mechanics)
        self.estimator = estimator
        self._window = FrameWindow(estimator.model.window)
        self._contacts = deque[tuple[bool, bool]](maxlen=estimator.model.window)
        """For each frame of the window whether it was observed out of contact, and whether in contact."""
        self._onset: PreparedFrame | None = None
        self._held: tuple[PreparedFrame, np.ndarray | None] | None = None
        self._log_sum, self._count = np.zeros(3), 0
        """Sum of log |θ| over the frames in contact of the current run, and their number."""

    def push(self, frame: PreparedFrame) -> Iterator[Output]:
        """Pass the next frame; yields the records of the frame before it and of runs that have ended.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        if self._held is not None:
            yield from self._pass(*self._held, frame)
        self._held = frame, self._window.push(frame)

    def finish(self) -> Iterator[Output]:
        """Yield the records of the last frame and of the run that the clip's end has cut off."""
        if self._held is not None:
            yield from self._pass(*self._held, None)
            self._held = None
        yield from super().finish()

    def _pass(
        self, current: PreparedFrame, depth: np.ndarray | None, following: PreparedFrame | None
    ) -> Iterator[Output]:
        yield from self._ended(self._runs.push(current))
        self._contacts.append((current.out_of_contact, current.in_contact))
        if current.track_start == current.frame.index:
            self._onset = current
        onset = self._onset if self._onset and current.track_start == self._onset.frame.index else None
        contact, run = current.geometry, self._runs.current
        if contact is not None and run is not None and depth is not None:
            with self.timed("network"):
                theta = self.estimator.model(depth[None])[0]
            if run.builder is not None and current.track_start == run.index:
                self._log_sum += np.log(np.maximum(np.abs(theta.astype(np.float64)), MIN_MAGNITUDE))
                self._count += 1
            lengths = self._displacements(theta, current, following, onset)
            direction = force_direction(contact.normal, current.displacement, self.clip.geometry)
            arrow = force_arrow(theta, contact, self.clip, self.estimator.bounds, direction)
            found = Estimate(theta, given_verdict=_verdict(self._contacts))
            yield frame_estimate(current, self.clip, found, lengths=lengths, arrow=arrow)
        else:
            yield frame_estimate(current, self.clip)
        if not current.consecutive:
            self._contacts.clear()

    def _ended(self, run: Run | None) -> Iterator[InteractionEstimate]:
        """Yield a run's record, whose log |θ| is the mean over its frames in contact."""
        if run is None:
            return
        logs, self._log_sum, self._count = self._log_sum / max(self._count, 1), np.zeros(3), 0
        if run.builder is None or run.passed:
            yield run.estimate(detail=run.unobserved)
            return
        found = Estimate(np.exp(logs) * SIGNS, given_verdict="undetermined")
        yield run.estimate(interaction=run.builder.build(self.mechanics), estimate=found, detail=run.detail)

    def _displacements(
        self, theta: np.ndarray, current: PreparedFrame, following: PreparedFrame | None, onset: PreparedFrame | None
    ) -> tuple[float | None, float | None]:
        """Lengths of the simulated and of the observed displacement at the instant that the model was trained on.

        `final`: the contact after T steps, and its motion to the next frame. `trajectory`: the contact of the frame of
        onset, under load since then, at the time of the next frame, and where its tissue point is then; None where the
        onset was not observed or lies further back than the horizon.
        """
        mechanics, observation = self.estimator.mechanics, self.estimator.observation
        steps, load_steps = mechanics.steps, mechanics.load_steps
        start, observed = current, current.displacement
        if observation == "trajectory":
            if onset is None:
                return None, None
            moment = current.frame.time_s + 1 / self.clip.fps if following is None else following.frame.time_s
            steps = round((moment - onset.frame.time_s) / mechanics.time_step)
            if not 1 <= steps <= mechanics.steps:
                return None, None
            start, load_steps = onset, steps
            observed = None
            if following is not None and following.track_start == onset.frame.index:
                observed = following.track_position - onset.track_position
        with self.timed("simulation"):
            contact = start.contact
            direction = force_direction(contact.normal, observed, self.clip.geometry)
            press = Press.at(contact.vertex, direction, held(load_steps, steps))
            path = simulate(theta, contact.mesh, press, mechanics)
        simulated = finite(float(np.linalg.norm(path[-1])))
        return simulated, None if observed is None else finite(float(np.linalg.norm(observed)))


def _verdict(contacts: deque[tuple[bool, bool]]) -> str:
    """The verdict on a window of consecutive frames: without the beginning of contact in it θ is undetermined."""
    begins = any(out and touching for (out, _), (_, touching) in pairwise(contacts))
    return "onset_in_view" if begins else "undetermined"
