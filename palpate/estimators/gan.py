"""The parameter network of a trained generator: θ of every frame in contact, and the motion that the simulator expects.

Source: Bini 2026, section 3.4.4: per frame depth, mesh and contact; one forward pass; one forward simulation. Decoder
and discriminators are not needed.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.data.contact.geometry import force_direction
from palpate.data.prepared import PreparedFrame
from palpate.data.windows import FrameWindow
from palpate.estimators.contract import ClipInfo, Output
from palpate.estimators.estimate import PressResult
from palpate.estimators.model_settings import ModelEstimator, ModelSettings
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.run_tracker import Run
from palpate.estimators.runs import RunSession, finite, force_arrow, frame_estimate
from palpate.models.onnx_session import ModelFileError, ParameterModel
from palpate.physics.load import Press, held
from palpate.physics.mechanics import SIGNS
from palpate.physics.msd.simulation import simulate


@dataclass(frozen=True)
class GanSettings(ModelSettings):
    """Parameter network of a trained generator, for every frame by itself."""

    def build(self) -> "GanEstimator":
        """Open the estimator.

        Raises:
            ModelFileError: the model's file can't be used.
            ValueError: there is none.
        """
        if self.model is None:
            raise ValueError("--estimator gan needs a trained generator; give the file of train.py export as --model.")
        return GanEstimator(self.opened(ParameterModel, "gan"))


class GanEstimator(ModelEstimator):
    """Estimator that runs a trained parameter network over prepared clips.

    Args:
        model: the exported network.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    name = "gan"
    tells_intervals = False
    model: ParameterModel

    def __init__(self, model: ParameterModel) -> None:
        super().__init__(model)
        if (observation := model.metadata.get("observation", "final")) != "final":
            problem = f"was trained with observation {observation} and head parameters; train it with observation final"
            raise ModelFileError(f"{model.path} {problem}, or with head posterior.")

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
        """Flags of each frame of the window: observed out of contact, and in contact."""
        self._held: tuple[PreparedFrame, np.ndarray | None] | None = None
        self._log_sum, self._count = np.zeros(3), 0
        """Sum of log |θ| over the frames in contact of the current run, and their number."""

    def push(self, frame: PreparedFrame) -> Iterator[Output]:
        """Pass the next frame; yields the records of the frame before it and of runs that have ended.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        if self._held is not None:
            yield from self._pass(*self._held)
        self._held = frame, self._window.push(frame)

    def finish(self) -> Iterator[Output]:
        """Yield the records of the last frame and of the run that the clip's end has cut off."""
        if self._held is not None:
            yield from self._pass(*self._held)
            self._held = None
        yield from super().finish()

    def _pass(self, current: PreparedFrame, depth: np.ndarray | None) -> Iterator[Output]:
        yield from self._ended(self._runs.push(current))
        self._contacts.append((current.out_of_contact, current.in_contact))
        contact, run = current.geometry, self._runs.current
        if contact is not None and run is not None and depth is not None:
            with self.seconds.timed("network"):
                theta = self.estimator.model(depth[None])[0]
            if run.builder is not None and current.track_start == run.index:
                # Smaller magnitudes of parameters count as this before their logarithm is taken.
                self._log_sum += np.log(np.maximum(np.abs(theta.astype(np.float64)), 1e-12))
                self._count += 1
            direction = force_direction(contact.normal, current.displacement, self.clip.geometry)
            with self.seconds.timed("simulation"):
                mechanics = self.estimator.mechanics
                press = Press.at(contact.vertex, direction, held(mechanics.load_steps, mechanics.steps))
                path = simulate(theta, contact.mesh, press, mechanics)
            lengths = finite(float(np.linalg.norm(path[-1]))), finite(float(np.linalg.norm(current.displacement)))
            arrow = force_arrow(theta, contact, self.clip, self.estimator.bounds, direction)
            found = PressResult(theta, given_verdict=_verdict(self._contacts))
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
        found = PressResult(np.exp(logs) * SIGNS, given_verdict="undetermined")
        yield run.estimate(interaction=run.builder.build(self.mechanics), estimate=found, detail=run.detail)


def _verdict(contacts: deque[tuple[bool, bool]]) -> str:
    """Return the verdict on a window of consecutive frames: without the beginning of contact in it θ is
    undetermined."""
    begins = any(out and touching for (out, _), (_, touching) in pairwise(contacts))
    return "onset_in_view" if begins else "undetermined"
