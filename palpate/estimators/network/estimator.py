"""Sessions of the contact posterior: θ, its uncertainty and a verdict for every frame, from the observation so far."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from palpate.data.contact.features import FEATURES
from palpate.data.contact.interaction import Interaction, InteractionBuilder
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES, network_noise
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.windows import FrameWindow
from palpate.estimators.contract import ClipInfo, Output, Preparation
from palpate.estimators.estimate import NoEstimate, PressCourse, PressResult
from palpate.estimators.model_settings import ModelEstimator, ModelSettings
from palpate.estimators.network.misfit import compared, largest_misfit
from palpate.estimators.oblique import effective_misfit, is_oblique, remark, view_angle, widened
from palpate.estimators.onset import PressSettings, onset_error
from palpate.estimators.records import FrameEstimate
from palpate.estimators.run_tracker import Run
from palpate.estimators.runs import WHOLE, RunSession, finite, force_arrow, frame_estimate
from palpate.models.onnx_session import CONTACT, ModelFileError, PosteriorModel
from palpate.observations.depth import DepthObservation
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics, theta_of
from palpate.physics.msd.simulation import simulate

TOO_EARLY = "The contact's tissue was not followed over two frames after its onset yet."
NO_NOISE = "The depth's noise isn't known; prepare with geometry.smoothing above 0."
UNEXPLAINED = "The model does not explain the motion, which lies {:.2g} times the noise off; intervals are inflated."
TIME_TOLERANCE = 1e-6
"""Times that differ by less are equal [s]."""


@dataclass(frozen=True)
class NetworkSettings(PressSettings, ModelSettings):
    """Posterior of a network for every frame."""

    observation: Literal["depth"] | None = None
    """depth: presses in RGB video without depth are not fitted by their shading (default: they are, when they have
    ended)"""
    rate: Literal["full", "fast"] = "full"
    """fast: automatic masks and guessed depth are found in one frame of three, and instruments move with the picture in
    between"""

    def build(self) -> "NetworkEstimator":
        """Open the estimator.

        Raises:
            ModelFileError: the model's file can't be used.
        """
        return NetworkEstimator(self.opened(PosteriorModel, "network"), self)


class NetworkEstimator(ModelEstimator):
    """Estimator that runs an exported contact posterior over prepared clips.

    Args:
        model: the exported network.
        settings: how it is asked.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    name = "network"
    live = True
    model: PosteriorModel

    def __init__(self, model: PosteriorModel, settings: NetworkSettings = NetworkSettings()) -> None:
        super().__init__(model)
        if model.inputs[CONTACT] != (FEATURES + SEQUENCE_FEATURES,):
            raise ModelFileError(f"{model.path} takes another contact's vector than this version has; train it anew.")
        self.settings = settings
        contact = model.metadata.get("contact", {})
        self.press_seconds: tuple[float, float] = tuple(contact.get("press_seconds", (0.0, math.inf)))
        """Shortest and longest press that the network was trained on [s]."""
        self.force_seconds = min(self.press_seconds[1], self.mechanics.seconds)

    @property
    def described(self) -> dict[str, Any]:
        """The settings that are not in the model's file."""
        names = ("onset", "observation", "horizon", "rate")
        return {"name": self.name, **{name: getattr(self.settings, name) for name in names}}

    def preparation(self, chosen: Preparation) -> PrepareSettings:
        """Return preparation as in the model's training, with the user's choices; in fewer frames by the rate fast."""
        found = super().preparation(chosen)
        return dataclasses.replace(found, every=3) if self.settings.rate == "fast" else found

    def start(self, clip: ClipInfo) -> "NetworkSession":
        """Open a session."""
        return NetworkSession(self, clip)

    def as_trained(self, contact: Interaction) -> Interaction:
        """Return the part of a contact's observation that resembles the training.

        The network was trained on presses of certain lengths, and on their beginnings. A longer press is cut to its
        beginning, a shorter one to its observation before the release.

        Raises:
            NoEstimate: the noise isn't known, or too few observations are left.
        """
        if not (math.isfinite(contact.noise) and contact.noise > 0):
            raise NoEstimate(NO_NOISE)
        load, (shortest, longest) = contact.load_seconds, self.press_seconds
        if not shortest - TIME_TOLERANCE <= load <= longest + TIME_TOLERANCE:
            contact = contact.observed(contact.observation.times <= min(load, longest) + TIME_TOLERANCE)
        # Fewest frames after the onset in which the tissue was followed; the network was trained on no fewer.
        if len(contact.observation) < 2:
            raise NoEstimate(TOO_EARLY)
        return contact

    def judged(self, contact: Interaction, mechanics: Mechanics, within: float, *outputs: np.ndarray) -> PressResult:
        """Return the estimate of a contact from the network's outputs, with how well it explains the motion.

        Args:
            contact: the observation.
            mechanics: the simulator.
            within: the press began, and ended, at most so long before or after the time stamps [s].
            outputs: the network's mean, covariance and expected bound, shapes [3], [3, 3] and [3, 3].
        """
        box, (mean, covariance, expected) = self.bounds.log_box, outputs
        misfit, information, blurred = compared(contact, mechanics, mean, covariance, within)
        noise = network_noise(contact)
        # A mean closer to a bound than this share of the box (in logarithms) counts as at the bound.
        at_bound = np.minimum(mean - box[0], box[1] - mean) < 0.02 * (box[1] - box[0])
        known: dict[str, Any] = {"noise": noise, "misfit": misfit, "at_bound": at_bound, "information": information}
        known |= {"largest_misfit": largest_misfit(len(contact.observation))}
        known |= {"course": PressCourse(view_angle=view_angle(contact))}
        sentence = "Depth shows the dent blurred, unlike in the network's training; use --estimator direct."
        known["refuted"] = sentence if blurred else ""
        return PressResult(theta_of(mean), covariance, expected_information=np.linalg.inv(expected), **known)


class NetworkSession(RunSession):
    """One clip: an estimate for every frame in contact, and one for every whole run of contact."""

    def __init__(self, estimator: NetworkEstimator, clip: ClipInfo) -> None:
        settings = estimator.settings
        super().__init__(clip, estimator.mechanics, settings.horizon)
        self.estimator, self.by_light = estimator, settings.observation is None
        self._onset_error = onset_error(settings.onset, clip.fps)
        self._window = FrameWindow(estimator.model.window)
        self._depths: list[tuple[float, np.ndarray]] = []
        """Depth windows of the current run with their times since its onset [s], where the model takes windows."""

    def push(self, frame: PreparedFrame) -> Iterator[Output]:
        """Take the next frame.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        depth = self._window.push(frame) if self.estimator.model.takes_depth else None
        ended = self._pushed(frame)
        run = self._runs.current
        yield from self._ended(ended)
        self._follow(frame)
        if ended is not None:
            self._depths.clear()
        if run is not None and depth is not None:
            since = frame.frame.time_s - run.time_s
            if since < self.mechanics.seconds:
                self._depths.append((since, depth))
        yield self._frame(frame, run, depth)

    def estimate(self, contact: Interaction, depth: np.ndarray | None) -> PressResult:
        """Return the posterior of a contact from its observation.

        Args:
            contact: as `NetworkEstimator.as_trained` gives it.
            depth: window [K, h, w], where the model takes one.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        estimator, within = self.estimator, self._onset_error * contact.intervals
        with self.seconds.timed("network"):
            features = DepthObservation.features(contact, within)[None]
            mean, covariance, bound = estimator.model(features, None if depth is None else depth[None])
        with self.seconds.timed("simulation"):
            whole = estimator.judged(contact, self.mechanics, within, mean[0], covariance[0], bound[0])
        error = effective_misfit(whole)
        unsure = is_oblique(whole) or error > whole.largest_misfit
        return widened(whole, error, estimator.bounds.log_box) if unsure else whole

    def _frame(self, frame: PreparedFrame, run: Run | None, depth: np.ndarray | None) -> FrameEstimate:
        if frame.geometry is None or run is None:
            return frame_estimate(frame, self.clip)
        if self.by_light and run.lit:
            return frame_estimate(frame, self.clip, doubts=WHOLE, whole=True)
        if run.builder is None:
            return frame_estimate(frame, self.clip, verdict="undetermined")
        contact = run.builder.build(self.mechanics, until=frame.frame.time_s - run.time_s)
        try:
            found = self.estimate(self.estimator.as_trained(contact), depth)
        except NoEstimate as reason:
            return frame_estimate(frame, self.clip, verdict="undetermined", doubts=str(reason), whole=True)
        arrow = force_arrow(found.theta, frame.geometry, self.clip, self.estimator.bounds, contact.direction)
        lengths = self._lengths(found, contact, frame, run.builder)
        return frame_estimate(frame, self.clip, found, lengths=lengths, doubts=_doubts(found), arrow=arrow)

    def _whole(self, contact: Interaction) -> tuple[PressResult, tuple[np.ndarray, np.ndarray], str]:
        known = self.estimator.as_trained(contact)
        last = known.observation.times[-1] + TIME_TOLERANCE
        depth = next((window for since, window in reversed(self._depths) if since <= last), None)
        found = self.estimate(known, depth)
        return found, self._simulated(found, contact), _doubts(found)

    def _simulated(self, found: PressResult, contact: Interaction) -> tuple[np.ndarray, np.ndarray]:
        path = simulate(found.theta, contact.mesh, contact.load.until(contact.steps), self.mechanics)
        times = self.mechanics.time_step * np.arange(1, len(path) + 1)
        return times, path @ np.asarray(contact.direction, np.float64)

    def _lengths(
        self, found: PressResult, contact: Interaction, frame: PreparedFrame, builder: InteractionBuilder
    ) -> tuple[float | None, float | None]:
        """Return lengths of the simulated and of the observed displacement of the contact's tissue in this frame."""
        steps = round((frame.frame.time_s - builder.start) / self.mechanics.time_step)
        observed = finite(float(np.linalg.norm(frame.track_position - builder.rest)))
        if steps == 0:
            return 0.0, observed
        if steps > self.mechanics.steps:
            return None, observed
        with self.seconds.timed("simulation"):
            press = Press.at(contact.vertex, contact.direction, held(steps, steps))
            path = simulate(found.theta, contact.mesh, press, self.mechanics)
        return float(np.linalg.norm(path[-1])), observed


def _doubts(found: PressResult) -> str:
    """Return sentences on why the estimate may be wrong."""
    doubt = "" if found.explained else found.refuted or UNEXPLAINED.format(found.misfit)
    return f"{doubt} {remark(found)}".strip()
