"""The contact posterior at work: θ, its uncertainty and a verdict for every frame, from what was seen so far."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator

import numpy as np

from data.contact.features import FEATURES, contact_features
from data.contact.film_features import FILM_FEATURES, dent_features, told_noise
from data.contact.interaction import FIELD, Horizon, Interaction, InteractionBuilder
from data.prepared import PreparedFrame
from data.windows import FrameWindow
from estimators.contract import ClipInfo, Said
from estimators.estimate import Estimate, FrameEstimate, NoEstimate, mixture
from estimators.model_settings import ModelEstimator
from estimators.network.misfit import compared, largest_misfit
from estimators.oblique import effective_misfit, is_oblique, remark, view_angle, widened
from estimators.onset import onset_error, onset_perturbations
from estimators.runs import Run, RunSession, force_arrow, frame_estimate
from models.onnx_session import CONTACT, ModelFileError, PosteriorModel
from physics.load import Press, held
from physics.mechanics import Mechanics, theta_of
from physics.msd.simulation import simulate

LEAST_OBSERVATIONS = 2
"""Frames after the onset in which the tissue was followed; the network never saw fewer."""
TOO_EARLY = "The contact's tissue was not followed over two frames after its onset yet."
NO_NOISE = "The depth's noise isn't known; prepare with geometry.smoothing above 0."
UNEXPLAINED = "The model does not explain the motion, which lies {:.2g} times the noise from it; intervals are widened."
ROUNDING = 1e-6
"""Of times [s]."""
EDGE = 0.02
"""A mean within this share of the box's end (in logarithms) lies at it."""


class NetworkEstimator(ModelEstimator):
    """Runs an exported contact posterior over prepared clips.

    Args:
        model: the exported network.
        onset: when a press begins, one of `estimators.onset.ONSETS`.
        horizon: how much of a whole contact is looked at.
        observation: what of it, one of `data.contact.interaction.OBSERVATIONS`. By the contact's point alone the
            network is told of no dent, and depth windows are blank.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    name = "network"
    model: PosteriorModel

    def __init__(self, model: PosteriorModel, onset: str, horizon: Horizon = None, observation: str = FIELD) -> None:
        super().__init__(model)
        self.onset, self.horizon, self.observation = onset, horizon, observation
        self.described = {"name": self.name, "onset": onset, "observation": observation, "horizon": horizon}
        """What is not in the model's file."""
        self.sees_film = model.inputs[CONTACT] == (FEATURES + FILM_FEATURES,)
        """Whether it is told of the whole dent, and of how well the instants of the press are known."""
        self.press_seconds: tuple[float, float] = tuple(
            model.metadata.get("contact", {}).get("press_seconds", (0.0, math.inf))
        )
        """Shortest and longest press that the network was trained on [s]."""

    def start(self, clip: ClipInfo) -> NetworkSession:
        """Open a session."""
        return NetworkSession(self, clip)

    def told(self, contact: Interaction) -> Interaction:
        """A contact as far as it resembles what the network was trained on.

        It knows presses of certain lengths, or their beginning. Of a longer press it is told the beginning, of a
        shorter one what was seen before the release.

        Raises:
            NoEstimate: the noise isn't known, or too little is left.
        """
        if not (math.isfinite(contact.noise) and contact.noise > 0):
            raise NoEstimate(NO_NOISE)
        if self.observation != FIELD:
            contact = dataclasses.replace(contact, film=None)
        load, (shortest, longest) = contact.load_seconds, self.press_seconds
        if not shortest - ROUNDING <= load <= longest + ROUNDING:
            contact = contact.observed(contact.observation.times <= min(load, longest) + ROUNDING)
        if len(contact.observation) < LEAST_OBSERVATIONS:
            raise NoEstimate(TOO_EARLY)
        return contact

    def features(self, contact: Interaction, within: float) -> np.ndarray:
        """What the network is told of a contact whose instants are known so well [s], shape [features]."""
        return dent_features(contact, within) if self.sees_film else contact_features(contact)

    def judged(
        self,
        contact: Interaction,
        mechanics: Mechanics,
        within: float,
        mean: np.ndarray,
        covariance: np.ndarray,
        expected: np.ndarray,
    ) -> Estimate:
        """What the network says of a contact, mean [3] and covariances [3, 3], with how well it explains the motion.

        Args:
            within: the press began, and ended, at most so long before or after the time stamps [s].
        """
        box = self.bounds.log_box
        misfit, information = compared(contact, mechanics, mean, covariance, within)
        return Estimate(
            theta=theta_of(mean),
            covariance=covariance,
            information=information,
            noise=told_noise(contact) if self.sees_film else contact.noise,
            misfit=misfit,
            largest_misfit=largest_misfit(len(contact.observation)),
            at_bound=np.minimum(mean - box[0], box[1] - mean) < EDGE * (box[1] - box[0]),
            expected_information=np.linalg.inv(expected),
            view_angle=view_angle(contact),
        )


class NetworkSession(RunSession):
    """One clip: an estimate for every frame in contact, and one for every whole run of contact."""

    def __init__(self, estimator: NetworkEstimator, clip: ClipInfo) -> None:
        super().__init__(clip, estimator.mechanics, estimator.horizon)
        self.estimator = estimator
        self._onset_error = onset_error(estimator.onset, clip.fps)
        self._window = FrameWindow(estimator.model.window)
        self._depths: list[tuple[float, np.ndarray]] = []
        """Depth windows of the run under way by the time since its onset [s], where the model looks at them."""

    def push(self, frame: PreparedFrame) -> Iterator[Said]:
        """The next frame.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        depth = self._window.push(frame) if self.estimator.model.takes_depth else None
        if depth is not None and self.estimator.observation != FIELD:
            depth = np.zeros_like(depth)  # as where no pixel has a depth
        ended = self._runs.push(frame)
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

    def estimate(self, contact: Interaction, depth: np.ndarray | None) -> Estimate:
        """Posterior of a contact from what was seen of it.

        Args:
            contact: as `NetworkEstimator.told` leaves it.
            depth: window [K, h, w], where the model looks at it.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        estimator, start = self.estimator, time.perf_counter()
        contacts, within = [contact], self._onset_error
        if not estimator.sees_film:
            contacts, within = onset_perturbations(contact, self._onset_error, LEAST_OBSERVATIONS), 0.0
        features = [estimator.features(each, within) for each in contacts]
        window = None if depth is None else np.repeat(depth[None], len(contacts), axis=0)
        found = estimator.model(np.stack(features), window)
        self.seconds["network"] += time.perf_counter() - start
        if not all(np.isfinite(values).all() for values in found):
            path = estimator.model.path
            raise ModelFileError(f"{path} gives a number that is not finite; export another checkpoint.")
        start = time.perf_counter()
        judged = [
            estimator.judged(each, self.mechanics, within, *told) for each, *told in zip(contacts, *found, strict=True)
        ]
        self.seconds["simulation"] += time.perf_counter() - start
        whole = mixture(judged)
        error = effective_misfit(whole)
        unsure = is_oblique(whole) or error > whole.largest_misfit
        return widened(whole, error, estimator.bounds.log_box) if unsure else whole

    def _frame(self, frame: PreparedFrame, run: Run | None, depth: np.ndarray | None) -> FrameEstimate:
        if frame.geometry is None or run is None:
            return frame_estimate(frame, self.clip)
        if run.builder is None:
            return frame_estimate(frame, self.clip, verdict="undetermined")
        contact = run.builder.build(self.mechanics, until=frame.frame.time_s - run.time_s)
        try:
            found = self.estimate(self.estimator.told(contact), depth)
        except NoEstimate as reason:
            return frame_estimate(frame, self.clip, verdict="undetermined", doubts=str(reason), whole=True)
        arrow = force_arrow(found.theta, frame.geometry, self.clip, self.estimator.bounds, contact.direction)
        lengths = self._lengths(found, contact, frame, run.builder)
        return frame_estimate(frame, self.clip, found, lengths=lengths, doubts=_doubts(found), arrow=arrow)

    def _whole(self, contact: Interaction) -> tuple[Estimate, tuple[np.ndarray, np.ndarray], str]:
        told = self.estimator.told(contact)
        last = told.observation.times[-1] + ROUNDING
        depth = next((window for since, window in reversed(self._depths) if since <= last), None)
        found = self.estimate(told, depth)
        path = simulate(found.theta, contact.mesh, contact.load.until(contact.steps), self.mechanics)
        times = self.mechanics.time_step * np.arange(1, len(path) + 1)
        return found, (times, path @ np.asarray(contact.direction, np.float64)), _doubts(found)

    def _lengths(
        self, found: Estimate, contact: Interaction, frame: PreparedFrame, seen: InteractionBuilder
    ) -> tuple[float | None, float | None]:
        """Lengths of the simulated and of the observed displacement of the contact's tissue in this frame."""
        steps = round((frame.frame.time_s - seen.start) / self.mechanics.time_step)
        moved = frame.track_position - seen.rest
        observed = float(np.linalg.norm(moved)) if np.isfinite(moved).all() else None
        if steps == 0:
            return 0.0, observed
        if steps > self.mechanics.steps:
            return None, observed
        start = time.perf_counter()
        press = Press.at(contact.vertex, contact.direction, held(steps, steps))
        path = simulate(found.theta, contact.mesh, press, self.mechanics)
        self.seconds["simulation"] += time.perf_counter() - start
        return float(np.linalg.norm(path[-1])), observed


def _doubts(found: Estimate) -> str:
    """Sentences on what can't be trusted."""
    return f"{'' if found.explained else UNEXPLAINED.format(found.misfit)} {remark(found)}".strip()
