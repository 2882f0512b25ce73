"""What the benchmark compares: estimators by name, each a function from a prepared clip to θ of its contacts."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from data.collected import CollectedClip
from data.samples import Horizon
from data.windows import window_indices
from estimators.contact_network import LARGEST_MISFIT, ContactNetwork
from estimators.direct import DOUBTFUL_MISFIT, DirectSettings, fit_clip
from estimators.estimate import ContactEstimate, NoEstimate
from estimators.oblique import is_oblique
from estimators.onset import STAMP
from models.onnx_session import ModelFileError, ParameterModel
from models.posterior_session import PosteriorModel

NAMES = ("direct", "network", "paper", "constant")
"""Estimators in the order of tables."""
NEEDS_MODEL = {"network": "--model", "paper": "--paper-model"}
"""Estimators that read a file, and the option that names it."""
GRID = (120, 214)
"""Height and width of the clips' depth [px]."""
SMALLEST = 1e-12
"""Parameters nearer to 0 count as this before their logarithm is taken."""


@dataclass(frozen=True)
class EstimatorSpec:
    """Everything that opens an estimator in another process."""

    name: str
    model: str = ""
    """Path of its network."""
    model_sha256: str = ""
    weights_sha256: str = ""
    """Of what a contact posterior was exported from."""
    calibrated: bool | None = None
    """Whether a contact posterior's intervals are; None = no such network."""
    noise: float | None = None
    """σ that `direct` is told; None = the clip's own estimate."""
    seen: Horizon = None
    """Frames after the onset that `direct` and `network` see; None = one second."""
    onset: str = STAMP
    """When `direct` and `network` take a press to begin, one of `estimators.onset.ONSETS`."""
    constant: tuple[tuple[float, ...], ...] = ()
    """Means of log θ, then their covariance: what `constant` answers, shape [4][3]."""

    def describe(self) -> dict[str, object]:
        """What its estimates depend on, for the run's record."""
        names = ("model_sha256", "weights_sha256", "calibrated", "noise", "seen", "onset")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class Answer:
    """What an estimator says about one contact."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3]."""
    covariance: np.ndarray | None = None
    """Of (log k_s, log k_d, log |F|), shape [3, 3]; None from an estimator that gives none."""
    verdict: str = ""
    """determined, ratios, undetermined, or empty."""
    noise: float = math.nan
    """σ that it believed in [scene units]."""
    misfit: float = math.nan
    """RMS residual along the force over that σ."""
    at_bound: np.ndarray = field(default_factory=lambda: np.zeros(3, bool))
    """Whether a parameter lies at the end of its range, shape [3]."""
    warned: bool | None = None
    """Whether it says that the model doesn't explain the motion, or that a dent may hide its bottom; None = it never
    says so."""


Estimator = Callable[[CollectedClip], dict[int, Answer | NoEstimate]]
"""From a prepared clip to an answer, or the reason for none, by the frame of onset."""


@functools.cache
def open_estimator(spec: EstimatorSpec) -> Estimator:
    """The estimator, opened once a process.

    Raises:
        ModelFileError: its network can't be used.
    """
    if spec.name == "direct":
        settings = DirectSettings(noise=spec.noise)
        return lambda clip: _answers(fit_clip(clip, settings, spec.seen, spec.onset), DOUBTFUL_MISFIT)
    if spec.name == "constant":
        return functools.partial(_constant, np.array(spec.constant))
    if spec.name == "paper":
        model = ParameterModel(spec.model, threads=1)
        _require_grid(model)
        return functools.partial(_frame_average, model)
    posterior = PosteriorModel(spec.model, threads=1)
    if posterior.takes_depth:
        _require_grid(posterior)
    network = ContactNetwork(posterior, spec.onset)
    return lambda clip: _answers(network.estimate_clip(clip, spec.seen), LARGEST_MISFIT)


def _require_grid(model: ParameterModel | PosteriorModel) -> None:
    if model.input_size != GRID:
        height, width = model.input_size
        raise ModelFileError(
            f"{model.path} takes depth of {width}x{height} pixels and the benchmark's has {GRID[1]}x{GRID[0]}; "
            "export a network that was trained at that size."
        )


def _answers(found: dict[int, ContactEstimate | NoEstimate], largest_misfit: float) -> dict[int, Answer | NoEstimate]:
    """Answers by onset; a larger misfit than that is what the estimator warns of."""
    return {
        onset: item if isinstance(item, NoEstimate) else answer_of(item, largest_misfit)
        for onset, item in found.items()
    }


def answer_of(estimate: ContactEstimate, largest_misfit: float) -> Answer:
    """An estimate as an answer; a larger misfit than that is what the estimator warns of."""
    return Answer(
        theta=np.asarray(estimate.theta, np.float64),
        covariance=np.asarray(estimate.covariance, np.float64),
        verdict=estimate.verdict,
        noise=float(estimate.noise),
        misfit=float(estimate.misfit),
        at_bound=np.asarray(estimate.at_bound, bool),
        warned=estimate.misfit > largest_misfit or is_oblique(estimate),
    )


def _onsets(clip: CollectedClip) -> list[int]:
    """Frames at which a run of contact whose onset was seen begins."""
    return np.flatnonzero(clip.track_start == np.arange(len(clip))).tolist()


def _constant(moments: np.ndarray, clip: CollectedClip) -> dict[int, Answer | NoEstimate]:
    """The same θ whatever is seen, as wide as the parameters it was fitted on."""
    theta = np.exp(moments[0]) * (1.0, 1.0, -1.0)
    return {onset: Answer(theta, covariance=moments[1:]) for onset in _onsets(clip)}


def _frame_average(model: ParameterModel, clip: CollectedClip) -> dict[int, Answer | NoEstimate]:
    """A network of one estimate a frame: the mean of log θ over a run's frames in contact."""
    return {onset: _average(model, clip, onset) for onset in _onsets(clip)}


def _average(model: ParameterModel, clip: CollectedClip, onset: int) -> Answer | NoEstimate:
    frames = np.flatnonzero((clip.track_start == onset) & clip.contact)
    indices = [window_indices(frame, model.window, clip.consecutive, clip.usable) for frame in frames]
    windows = [np.stack([clip.depth(index) for index in window]) for window in indices if window is not None]
    thetas = [model(window[None])[0] for window in windows]
    if not thetas or not np.isfinite(thetas).all():
        return NoEstimate("the network gives no finite θ for any frame in contact.")
    logs = np.log(np.maximum(np.abs(np.array(thetas, np.float64)), SMALLEST))
    return Answer(np.exp(logs.mean(axis=0)) * (1.0, 1.0, -1.0))


def check_model(spec: EstimatorSpec) -> EstimatorSpec:
    """Open an estimator's network once, so that a wrong file is told before any work; the spec with what it is.

    Raises:
        ModelFileError: it can't be used.
    """
    open_estimator(spec)
    if spec.name != "network":
        return spec
    network = PosteriorModel(spec.model, threads=1)
    weights = network.metadata.get("training", {}).get("weights_sha256", "")
    return dataclasses.replace(spec, weights_sha256=weights, calibrated=network.calibrated)
