"""What the benchmark compares: the estimators that users run, and a constant."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from data.prepared import PreparedFrame
from data.settings import PrepareSettings
from estimators.contract import Chosen, ClipInfo, Estimator, Said
from estimators.estimate import Estimate
from estimators.open import EstimatorOptions, open_estimator
from estimators.runs import RunTracker, frame_estimate
from models.onnx_session import ModelFileError, PosteriorModel
from physics.mechanics import Mechanics, theta_of
from results.record import sha256_of

NAMES = ("direct", "network", "gan", "constant")
"""Estimators in the order of tables."""
NEEDS_MODEL = {"network": "--model", "gan": "--gan-model"}
"""Estimators that read a file, and the option that names it."""
GRID = (120, 214)
"""Height and width of the clips' depth [px]."""


@dataclass(frozen=True)
class ConstantOptions:
    """Everything that opens the constant in another process."""

    moments: tuple[tuple[float, ...], ...] = ()
    """Means of log θ, then their covariance, shape [4][3]; empty until they are known."""
    name: str = "constant"


Candidate = EstimatorOptions | ConstantOptions


@functools.cache
def opened(candidate: Candidate) -> Estimator:
    """The estimator, opened once a process.

    Raises:
        ModelFileError: its network can't be used.
    """
    if isinstance(candidate, ConstantOptions):
        return ConstantEstimator(np.array(candidate.moments))
    found = open_estimator(candidate)
    model = getattr(found, "model", None)
    if model is not None and getattr(model, "takes_depth", True) and model.input_size != GRID:
        height, width = model.input_size
        raise ModelFileError(
            f"{model.path} takes depth of {width}x{height} pixels and the benchmark's has {GRID[1]}x{GRID[0]}; "
            "export a network that was trained at that size."
        )
    return found


def describe(candidate: Candidate) -> dict[str, Any]:
    """What its estimates depend on, for the run's record.

    Raises:
        ModelFileError: its network can't be used.
    """
    if isinstance(candidate, ConstantOptions):
        return {}
    model = getattr(opened(candidate), "model", None)
    posterior = model if isinstance(model, PosteriorModel) else None
    return {
        "model_sha256": "" if model is None else sha256_of(model.path),
        "weights_sha256": "" if posterior is None else posterior.metadata.get("training", {}).get("weights_sha256", ""),
        "calibrated": None if posterior is None else posterior.calibrated,
        "noise": candidate.noise,
        "seen": candidate.horizon,
        "onset": candidate.onset,
    }


class ConstantEstimator:
    """The same θ whatever is seen, as wide as the parameters it was fitted on.

    Args:
        moments: mean of log θ, then its covariance, shape [4, 3].
    """

    name = "constant"

    def __init__(self, moments: np.ndarray) -> None:
        self.answer = Estimate(theta_of(moments[0]), moments[1:], told_verdict="undetermined")

    @property
    def described(self) -> dict[str, Any]:
        """Its answer."""
        return {"name": self.name, "theta": self.answer.theta.tolist()}

    def preparation(self, chosen: Chosen) -> PrepareSettings:
        """Any."""
        return PrepareSettings(layout=chosen.layout)

    def start(self, clip: ClipInfo) -> ConstantSession:
        """Open a session."""
        return ConstantSession(self.answer, clip)


class ConstantSession:
    """One clip."""

    def __init__(self, answer: Estimate, clip: ClipInfo) -> None:
        self.answer, self.clip, self.seconds = answer, clip, dict[str, float]()
        self._runs = RunTracker(clip, Mechanics().seconds)

    def push(self, frame: PreparedFrame) -> Iterator[Said]:
        """The next frame."""
        run = self._runs.push(frame)
        if run is not None:
            yield run.estimate(estimate=self.answer)
        yield frame_estimate(frame, self.clip, whole=True)

    def finish(self) -> Iterator[Said]:
        """The run that the clip's end has cut off."""
        run = self._runs.finish()
        if run is not None:
            yield run.estimate(estimate=self.answer)
