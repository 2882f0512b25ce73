"""The contact posterior at work: θ, its uncertainty and a verdict for every frame, from what was seen so far."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from data.clip import ClipStream, PreparedFrame
from data.clip_cache import PreparedClip
from data.collected import CollectedClip
from data.contact_features import Surroundings, contact_features, contact_surroundings
from data.geometry import force_direction
from data.samples import ContactCase, Horizon, SampleSettings, contact_cases
from data.windows import FrameWindow, window_indices
from estimators.amortized import FrameResult, force_arrow, frame_estimate
from estimators.estimate import ContactEstimate, FrameEstimate, NoEstimate, combined
from estimators.model_settings import section
from estimators.oblique import effective_misfit, is_oblique, remark, view_angle, widened
from estimators.onset import STAMP, begun_otherwise, onset_error
from models.onnx_session import ModelFileError
from models.posterior_session import PosteriorModel
from physics.identifiability import fisher_information, log_jacobian
from physics.mechanics import Bounds, Mechanics
from physics.msd_kernel import simulate, simulate_sensitivities

PRESSING = np.array([1.0, 1.0, -1.0])
"""Signs of k_s, k_d and F."""
LEAST_OBSERVATIONS = 2
"""Frames after the onset in which the tissue was followed; the network never saw fewer."""
TOO_EARLY = "The contact's tissue was not followed over two frames after its onset yet."
NO_NOISE = "The depth's noise isn't known; prepare with geometry.smoothing above 0."
LARGEST_MISFIT = 2.0
"""A motion farther from the simulated one than this many σ is unlike what the network was trained on, and its own
covariance means nothing: that of a noise as large as the misfit, within the box, is added. Of 300 validation
clips (`clean`, `8bit` and `noisy`; `warned` in details.csv of `make model`) none is so far off."""
UNEXPLAINED = "The model does not explain the motion, which lies {:.2g} times the noise from it; intervals are widened."
ROUNDING = 1e-6
"""Of times [s]."""
EDGE = 0.02
"""A mean within this share of the box's end (in logarithms) lies at it."""


class ContactNetwork:
    """Runs an exported contact posterior over prepared clips.

    Args:
        model: the exported network.
        onset: when a press begins, one of `estimators.onset.ONSETS`.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    def __init__(self, model: PosteriorModel, onset: str = STAMP) -> None:
        self.model, self.onset = model, onset
        self._onset_error = 0.0
        """How far from the first frame in contact the current clip's presses may begin [s]."""
        self.trained: Mechanics = section(model, "mechanics", Mechanics)
        self.mechanics = self.trained
        """The trained simulator, its steps matched to the current clip's frame rate."""
        self.bounds: Bounds = section(model, "bounds", Bounds)
        self.press_seconds: tuple[float, float] = tuple(
            model.metadata.get("contact", {}).get("press_seconds", (0.0, math.inf))
        )
        """Shortest and longest press that the network was trained on [s]."""
        self.seconds: dict[str, float] = defaultdict(float)
        """Time spent on the current clip in `network` and `simulation` [s]."""

    def run(self, clip: ClipStream) -> Iterator[FrameResult]:
        """Results of a clip's frames, one for each, in order; memory does not grow with the clip.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        self.seconds.clear()
        self._match(clip.source.fps)
        window, run = FrameWindow(self.model.window), None
        for current in clip:
            depth = window.push(current)
            if current.track_start == current.frame.index:
                run = _Run(current, clip, self.mechanics)
            known = run if run is not None and current.track_start == run.onset.frame.index else None
            if known is not None:
                known.add(current)
            if not current.in_contact:
                yield FrameResult(current, frame_estimate(current, clip), None)
            elif known is None:
                yield FrameResult(current, frame_estimate(current, clip, verdict="undetermined"), None)
            else:
                yield self._frame(current, clip, known, depth)

    def _frame(self, current: PreparedFrame, clip: ClipStream, run: _Run, depth: np.ndarray | None) -> FrameResult:
        """Result of a frame in contact of a run whose onset was seen."""
        case = run.case(current)
        try:
            found = self.estimate(self._told(case), run.surroundings, depth)
        except NoEstimate as reason:
            early = frame_estimate(current, clip, verdict="undetermined")
            return FrameResult(current, _remark(early, current.detail, str(reason)), None)
        lengths = self._lengths(found, case, current, run)
        result = frame_estimate(current, clip, found.theta, lengths, found.verdict, found)
        unexplained = UNEXPLAINED.format(found.misfit) if found.misfit > LARGEST_MISFIT else ""
        result = _remark(result, result.detail, unexplained, remark(found))
        return FrameResult(current, result, force_arrow(found.theta, current, clip, self.bounds))

    def estimate_clip(
        self, clip: PreparedClip | CollectedClip, horizon_frames: Horizon = None
    ) -> dict[int, ContactEstimate | NoEstimate]:
        """Every run of contact of a prepared clip whose onset was seen, or why it has no estimate, by its onset.

        Args:
            clip: the clip.
            horizon_frames: only these frames after an onset are used; None = one second.
        """
        self._match(clip.fps)
        samples = SampleSettings(observation="trajectory", horizon_frames=horizon_frames, mechanics=self.mechanics)
        found: dict[int, ContactEstimate | NoEstimate] = {}
        for onset, case in contact_cases(clip, samples).items():
            try:
                told = self._told(case)
            except NoEstimate as reason:
                found[onset] = reason
                continue
            depth = self._window(clip, onset, told) if self.model.takes_depth else None
            found[onset] = self.estimate(told, contact_surroundings(case), depth)
        return found

    def _match(self, fps: float) -> None:
        """Prepare for a clip of so many frames a second."""
        self.mechanics = self.trained.matched(1 / fps)
        self._onset_error = onset_error(self.onset, fps)

    def _told(self, case: ContactCase) -> ContactCase:
        """A contact as far as it resembles what the network was trained on.

        It knows presses of certain lengths, or their beginning. Of a longer press it is told the beginning, of a
        shorter one what was seen before the release.

        Raises:
            NoEstimate: the noise isn't known, or too little is left.
        """
        if not (math.isfinite(case.noise) and case.noise > 0):
            raise NoEstimate(NO_NOISE)
        load, (shortest, longest) = case.load_steps * self.mechanics.time_step, self.press_seconds
        if not shortest - ROUNDING <= load <= longest + ROUNDING:
            kept = (case.steps + 1) * self.mechanics.time_step <= min(load, longest) + ROUNDING
            parts = {name: getattr(case, name)[kept] for name in ("steps", "displacement", "weight")}
            case = dataclasses.replace(case, **parts)
        if len(case.steps) < LEAST_OBSERVATIONS:
            raise NoEstimate(TOO_EARLY)
        return case

    def _window(self, clip: PreparedClip | CollectedClip, onset: int, case: ContactCase) -> np.ndarray:
        """Depth of the last frames in which a contact was followed, shape [K, h, w]."""
        seconds = (int(case.steps[-1]) + 1) * self.mechanics.time_step
        last = int(np.argmin(np.abs(clip.times - clip.times[onset] - seconds)))
        indices = window_indices(last, self.model.window, clip.consecutive, clip.usable)
        return np.stack([clip.depth(index) for index in ([onset] * self.model.window if indices is None else indices)])

    def estimate(
        self, case: ContactCase, surroundings: Surroundings | None, depth: np.ndarray | None
    ) -> ContactEstimate:
        """Posterior of a contact from what was seen of it.

        Args:
            case: the contact, observed once at least; its steps count in the model's time step.
            surroundings: of the contact, where they are known already.
            depth: window [K, h, w], where the model looks at it.

        Raises:
            ModelFileError: the network gives a number that is not finite.
        """
        cases = begun_otherwise(case, self._onset_error, self.mechanics.time_step, LEAST_OBSERVATIONS)
        start = time.perf_counter()
        features = [contact_features(each, self.mechanics.time_step, surroundings=surroundings) for each in cases]
        window = np.repeat(depth[None], len(cases), axis=0) if self.model.takes_depth else None
        answers = self.model(np.stack(features), window)
        self.seconds["network"] += time.perf_counter() - start
        if not all(np.isfinite(values).all() for values in answers):
            raise ModelFileError(f"{self.model.path} gives a number that is not finite; export another checkpoint.")
        start, box = time.perf_counter(), self.bounds.log_box
        found = combined([self._judged(*told) for told in zip(cases, *answers, strict=True)])
        self.seconds["simulation"] += time.perf_counter() - start
        error = effective_misfit(found)
        return widened(found, error, box) if is_oblique(found) or error > LARGEST_MISFIT else found

    def _judged(
        self, case: ContactCase, mean: np.ndarray, covariance: np.ndarray, decisive: np.ndarray
    ) -> ContactEstimate:
        """What the network says of a contact, mean [3] and covariances [3, 3], with how well it explains the motion."""
        misfit, information = self._linearise(mean, case)
        box = self.bounds.log_box
        return ContactEstimate(
            theta=np.exp(mean) * PRESSING,
            covariance=covariance,
            information=information,
            noise=case.noise,
            misfit=misfit,
            at_bound=np.minimum(mean - box[0], box[1] - mean) < EDGE * (box[1] - box[0]),
            decisive=np.linalg.inv(decisive),
            view_angle=view_angle(case),
        )

    def _linearise(self, logs: np.ndarray, case: ContactCase) -> tuple[float, np.ndarray]:
        """Residual's size along the force in σ, and Fisher information [3, 3] of the contact's trajectory, at φ."""
        steps, theta = int(case.steps.max()) + 1, np.exp(logs) * PRESSING
        mechanics = dataclasses.replace(self.mechanics, steps=steps, load_steps=0)
        path, slopes = simulate_sensitivities(
            theta, case.mesh, case.vertex, case.direction, mechanics, load_steps=min(case.load_steps, steps)
        )
        residual = (path[case.steps] - case.displacement) @ case.direction / case.noise
        jacobian = log_jacobian(slopes[case.steps].astype(np.float64), theta)
        return float(np.sqrt(np.square(residual).mean())), fisher_information(jacobian, case.noise)

    def _lengths(
        self, found: ContactEstimate, case: ContactCase, current: PreparedFrame, run: _Run
    ) -> tuple[float | None, float | None]:
        """Lengths of the simulated and of the observed displacement of the contact's tissue in this frame."""
        elapsed = current.frame.time_s - run.onset.frame.time_s
        steps = round(elapsed / self.mechanics.time_step)
        moved = current.track_position - run.rest
        observed = float(np.linalg.norm(moved)) if np.isfinite(moved).all() else None
        if steps == 0:
            return 0.0, observed
        if steps > self.mechanics.steps:
            return None, observed
        mechanics = dataclasses.replace(self.mechanics, steps=steps, load_steps=0)
        started = time.perf_counter()
        contact = case.mesh, case.vertex, case.direction
        path = simulate(found.theta, *contact, mechanics, load_steps=min(case.load_steps, steps))
        self.seconds["simulation"] += time.perf_counter() - started
        return float(np.linalg.norm(path[-1])), observed


def _remark(estimate: FrameEstimate, *sentences: str) -> FrameEstimate:
    """A frame's estimate with other sentences as its detail."""
    return dataclasses.replace(estimate, detail=" ".join(filter(None, sentences)))


class _Run:
    """A run of contact as it is seen frame by frame."""

    def __init__(self, onset: PreparedFrame, clip: ClipStream, mechanics: Mechanics) -> None:
        self.onset, self.mechanics = onset, mechanics
        contact = onset.geometry
        self.rest = contact.mesh.vertices[contact.vertex].astype(np.float64)
        self.settings = clip.settings.geometry
        self.steps: list[int] = []
        self.moves: list[np.ndarray] = []
        self.surroundings = contact_surroundings(self.case(onset))

    def add(self, current: PreparedFrame) -> None:
        """Take in where the followed tissue is in a frame."""
        step = round((current.frame.time_s - self.onset.frame.time_s) / self.mechanics.time_step) - 1
        moved = current.track_position - self.rest
        if 0 <= step < self.mechanics.steps and np.isfinite(moved).all():
            self.steps.append(step)
            self.moves.append(moved)

    def case(self, current: PreparedFrame) -> ContactCase:
        """The contact as seen until a frame in contact."""
        contact, moves = self.onset.geometry, np.array(self.moves, np.float32).reshape(-1, 3)
        farthest = moves[np.argmax(np.linalg.norm(moves, axis=1))] if len(moves) else None
        elapsed = round((current.frame.time_s - self.onset.frame.time_s) / self.mechanics.time_step)
        return ContactCase(
            mesh=contact.mesh,
            vertex=contact.vertex,
            direction=force_direction(contact.normal, farthest, self.settings),
            load_steps=min(max(elapsed, 1), self.mechanics.steps),
            steps=np.array(self.steps, np.int64),
            displacement=moves,
            weight=np.ones(len(moves), np.float32),
            noise=contact.noise,
        )
