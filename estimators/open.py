"""Opens an estimator by its name and its model's file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from data.contact.interaction import FIELD, Horizon
from estimators.contract import Estimator
from estimators.direct.estimator import DirectEstimator
from estimators.gan import GanEstimator
from estimators.network.estimator import NetworkEstimator
from estimators.online.estimator import OnlineEstimator
from estimators.online.settings import OnlineSettings, load_settings
from estimators.onset import BETWEEN, STAMP
from models.onnx_session import SHIPPED, ModelFileError, PosteriorModel, open_model

OF_THETA = ("network", "gan", "direct")
"""Those that tell stiffness, damping and force of a press."""
NAMES = (*OF_THETA, "online")
SHEET, FEM = "sheet", "fem"
MODELS = (SHEET, FEM)
"""What `direct` fits: a sheet of springs, or a slab of finite elements."""


@dataclass(frozen=True)
class EstimatorOptions:
    """Everything that opens an estimator, also in another process."""

    name: str | None = None
    """One of NAMES; None = what the model's file is for, and without one `network`."""
    model: Path | None = None
    """ONNX file that `train.py export` or `estimators.network.calibration` wrote; None = the one that
    comes along. Of `direct` the name of what it fits, one of MODELS; None = the sheet."""
    onset: str | None = None
    """When a press begins, one of `estimators.onset.ONSETS`; None = between frames, as in real videos."""
    observation: str | None = None
    """What `direct` and `network` look at, one of `data.contact.interaction.OBSERVATIONS`; None = the whole dent."""
    noise: float | None = None
    """σ that `direct` is told [scene units]; None = the clip's own estimate."""
    horizon: Horizon = None
    """How much of a whole contact `network` and `direct` look at."""
    settings: Path | None = None
    """YAML file of `online`, as `configs/online.yaml`; None = its defaults, which are the same."""
    threads: int | None = None
    """CPU threads of a model; None leaves the choice to ONNX Runtime."""
    thickness: float | None = None
    """Of the tissue, for `direct` with the model FEM [scene units]."""


def open_estimator(options: EstimatorOptions) -> Estimator:
    """Open an estimator.

    Raises:
        ModelFileError: the model's file can't be used, or not with these options.
        ValueError: options that don't belong together.
    """
    if options.name == "online":
        return _open_online(options)
    if options.settings is not None:
        raise ValueError(f"--settings {options.settings} is for --estimator online; leave it out.")
    seen = options.observation or FIELD
    if options.name == "direct":
        return _open_direct(options, seen)
    if options.thickness is not None:
        raise ValueError("--thickness is for --estimator direct --model fem; leave it out.")
    if options.noise is not None:
        raise ValueError("--noise is for --estimator direct; leave it out.")
    if options.name == "gan" and options.model is None:
        raise ValueError("--estimator gan needs a trained generator; give the file of train.py export as --model.")
    model = open_model(options.model or SHIPPED, options.threads)
    kind = "network" if isinstance(model, PosteriorModel) else "gan"
    if options.name not in (None, kind):
        raise ModelFileError(f"{model.path} is of the estimator {kind}; give --estimator {kind}, or leave it out.")
    if isinstance(model, PosteriorModel):
        return NetworkEstimator(model, options.onset or BETWEEN, options.horizon, seen)
    if options.onset not in (None, STAMP):
        raise ModelFileError(f"{model.path} knows nothing of when a press begins; leave --onset {options.onset} out.")
    if options.horizon is not None:
        raise ModelFileError(f"{model.path} sees single frames; leave the horizon {options.horizon} out.")
    if options.observation is not None:
        raise ValueError(f"{model.path} sees single frames; leave --observation {options.observation} out.")
    return GanEstimator(model)


def _open_direct(options: EstimatorOptions, seen: str) -> DirectEstimator:
    model = SHEET if options.model is None else str(options.model)
    if model not in MODELS:
        raise ValueError(f"--estimator direct needs no network; give --model fem, or leave --model {model} out.")
    if model == FEM and options.thickness is None:
        raise ValueError("--model fem must be told how thick the tissue is; give --thickness in scene units.")
    if model == SHEET and options.thickness is not None:
        raise ValueError("--thickness is for --model fem; a sheet has none, so leave it out.")
    return DirectEstimator(
        options.onset or BETWEEN,
        seen,
        options.horizon,
        options.noise,
        thickness=options.thickness,
    )


def _open_online(options: EstimatorOptions) -> OnlineEstimator:
    for name in ("model", "thickness", "onset", "observation", "noise", "horizon"):
        if getattr(options, name) is not None:
            raise ValueError(f"--{name} is not for --estimator online; leave it out.")
    return OnlineEstimator(OnlineSettings() if options.settings is None else load_settings(options.settings))
