"""The direct estimator: θ of one contact from its motion through the simulator, without a trained network.

It is the strongest classical rival of a network (docs/reports/identifiability.md). Levenberg–Marquardt with a trust
region fits the sequence of a dent (`observations.depth`), as a step on a vertex or as a press of any shape
(`estimators.direct.patch`). Parameters are φ = (log k_s, log k_d, log |F|) and, where the instants are not known,
delays of the press (`estimators.direct.motion`). Around these optima the posterior is sampled
(`estimators.direct.sampling`), with a uniform prior on the box. Mean and covariance of φ are the estimate.
"""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from palpate.common.options import option
from palpate.common.settings import LARGEST
from palpate.data.contact.interaction import SHADING, Interaction
from palpate.data.prepared import PreparedFrame
from palpate.estimators.contract import SMOOTHING, ClipInfo, Estimator, Output
from palpate.estimators.direct.contact_fit import fit_press
from palpate.estimators.direct.joint import fit_together
from palpate.estimators.direct.motion import FITTED
from palpate.estimators.direct.shading_fit import WITHIN
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.estimators.oblique import remark
from palpate.estimators.onset import PressSettings, onset_error
from palpate.estimators.run_tracker import RECORDED
from palpate.estimators.runs import WHOLE, RunSession, frame_estimate
from palpate.observations.kinds import OBSERVATIONS
from palpate.physics.load import Press, held
from palpate.physics.mechanics import PARAMETERS, RECOMMENDED, Bounds, Mechanics
from palpate.physics.msd.simulation import simulate

LEAST_OBSERVATIONS = 3
"""Frames after the onset in which the tissue around the contact is visible."""
MODEL_COVARIANCE = 0.1**2 * (np.ones((3, 3)) + np.diag([0.0, 1.0, 1.0]))
"""Covariance of φ by what simulator, mesh and masks get wrong: a tenth of k_d/k_s and of F/k_s, and a tenth common to
all three. It was chosen on path-traced presses, such as `python -m benchmarks.path_traced --given depth` measures."""

PATCH_ERROR = 0.35
"""Standard deviation of log F by what an instrument hides of the patch under it, where the patch is fitted, or the dent
lies beside the contact; from 22 validation clips of suite `filled` of `python -m benchmarks.recovery`."""


@dataclass(frozen=True)
class DirectSettings(PressSettings):
    """Fit of the simulator to every contact when it has ended, without a network.

    Raises:
        ValueError: a value out of range.
    """

    observation: tuple[str, ...] = option((), choices=lambda: tuple(OBSERVATIONS.entries))
    """observations of one fit: depth of all visible tissue around the contact (default where depth is given); shading,
    the change of the tissue's light (default where depth is guessed); or both"""
    smoothing: Annotated[float, 0, LARGEST] = option(SMOOTHING, metavar="PIXELS")
    """smooth the tissue's resting shape over this many grid pixels, which also measures the depth's noise"""
    # A smaller σ is refused [scene units]: that is the fitted simulator's own error (docs/reports/identifiability.md),
    # which would be taken for motion of the tissue.
    noise: Annotated[float, 3e-5, LARGEST] | None = option(None, metavar="X")
    """noise of the depth [scene units] (default: as measured)"""

    def __post_init__(self) -> None:
        if isinstance(self.observation, str):
            object.__setattr__(self, "observation", (self.observation,))
        super().__post_init__()
        for name in self.observation:
            OBSERVATIONS[name]

    def build(self) -> "DirectEstimator":
        """Open the estimator."""
        return DirectEstimator(self)


class DirectEstimator(Estimator):
    """Estimator that fits every run of contact when it has ended; needs no network."""

    name = "direct"
    mechanics = FITTED
    """Integrator of the fitted model."""
    bounds = RECOMMENDED
    """Admissible box, in which the prior is uniform; F presses."""

    def __init__(self, settings: DirectSettings) -> None:
        self.settings, self.smoothing = settings, settings.smoothing

    @property
    def described(self) -> dict[str, Any]:
        """All that the fits depend on besides the clip."""
        model = {"mechanics": dataclasses.asdict(self.mechanics), "bounds": dataclasses.asdict(self.bounds)}
        return super().described | model

    def start(self, clip: ClipInfo) -> "DirectSession":
        """Open a session."""
        return DirectSession(self, clip)


class DirectSession(RunSession):
    """One clip: a record for every frame, and a fit for every run of contact."""

    follows_all, needs_point = True, False

    def __init__(self, estimator: DirectEstimator, clip: ClipInfo) -> None:
        settings, names = estimator.settings, estimator.settings.observation
        super().__init__(clip, estimator.mechanics, settings.horizon, tuple(dict.fromkeys((*RECORDED, *names))))
        self.by_light, self.needs_light = names in ((), (SHADING,)), SHADING in names
        self.estimator = estimator
        self._within = WITHIN * onset_error(settings.onset, clip.fps)

    def push(self, frame: PreparedFrame) -> Iterator[Output]:
        """Take the next frame."""
        yield from self._ended(self._pushed(frame))
        self._follow(frame)
        yield frame_estimate(frame, self.clip, doubts=WHOLE if frame.in_contact else "", whole=True)

    def fit(self, contact: Interaction) -> tuple[PressResult, tuple[np.ndarray, np.ndarray]]:
        """Fit θ to one contact; gives the estimate and the simulated motion, as in `simulated_motion`.

        Where the beginning of the press isn't known its delay is fitted as well, and the information is that for a
        known beginning. Where the contact is pressed aslant to the line of sight its uncertainty is inflated
        (`estimators.oblique`), because the bottom of the dent may be hidden.

        Raises:
            NoEstimate: fewer than three observations, or no noise level.
        """
        settings, within = self.estimator.settings, self._within * contact.intervals
        how = self.mechanics, within, settings.noise, self.estimator.bounds.log_box
        if settings.observation not in ((), ("depth",)):
            found = fit_together(contact, settings.observation, *how)
        elif contact.sequence is None:
            raise NoEstimate("The depth's noise isn't known; set --smoothing above 0, or give --noise.")
        elif (count := len(contact.sequence.times)) < LEAST_OBSERVATIONS:
            problem = f"The tissue around the contact was followed over {count} frames after its onset;"
            raise NoEstimate(f"{problem} {LEAST_OBSERVATIONS} are needed.")
        else:
            found = fit_press(contact, *how)
        return found, simulated_motion(contact, found, self.mechanics)

    def _whole(self, contact: Interaction) -> tuple[PressResult, tuple[np.ndarray, np.ndarray], str]:
        with self.seconds.timed("fit"):
            found, motion = self.fit(contact)
        if found.covariance is not None and SHADING not in self.estimator.settings.observation:  # which has its own
            hidden = PATCH_ERROR**2 if found.course.shape else 0.0
            covariance = found.covariance + MODEL_COVARIANCE + np.diag([0.0, 0.0, hidden])
            found = dataclasses.replace(found, covariance=covariance)
        return found, motion, doubts(found, self.estimator.bounds)


def simulated_motion(contact: Interaction, found: PressResult, mechanics: Mechanics) -> tuple[np.ndarray, np.ndarray]:
    """Return times from the first frame in contact to the last observation [s], and the motion along the force, [T]
    each."""
    delay = found.course.delays[0]
    steps = contact.steps + math.ceil(max(-delay, 0.0) / mechanics.time_step)
    press = fitted_press(contact, found, mechanics.time_step, steps)
    moved = simulate(found.theta, contact.mesh, press, mechanics, watch=np.array([contact.vertex]))[:, 0]
    path = moved @ np.asarray(contact.direction, np.float64)
    began = delay + mechanics.time_step * np.arange(steps + 1)
    times = np.linspace(0, contact.steps * mechanics.time_step, steps + 1)
    return times, np.interp(times, began, np.concatenate([[0.0], path]))


def fitted_press(contact: Interaction, found: PressResult, time_step: float, steps: int) -> Press:
    """Return the load of an estimate over so many steps [s] from the beginning of the press, by its fitted delays."""
    delay, release = found.course.delays
    seconds = contact.load_seconds + release - delay if contact.released else math.inf
    if found.course.shape is None:
        return dataclasses.replace(contact.load, factor=held(seconds / time_step, steps))
    return found.course.shape.press(contact.mesh, contact.vertex, contact.direction, seconds, time_step, steps)


def doubts(found: PressResult, bounds: Bounds) -> str:
    """Return sentences on why an estimate can't be trusted; empty where nothing speaks against it."""
    texts = [remark(found), found.refuted]
    if found.misfit > found.largest_misfit:
        apart = f"they lie {found.misfit:.2g} times the noise from it"
        texts.append(f"The model does not explain the data: {apart}; don't trust the fit.")
    if found.course.at_end:
        texts.append("The press seems to begin or end a whole frame from where it was seen to; don't trust the fit.")
    for name, stuck, (low, high) in zip(PARAMETERS, found.at_bound, np.exp(bounds.log_box).T, strict=True):
        if stuck:
            texts.append(f"The best fit lies at the end of the {name}'s admissible range, {low:g} to {high:g}.")
    return " ".join(filter(None, texts))
