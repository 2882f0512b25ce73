"""Opens an estimator by its name and its model's file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from palpate.common.onnx_devices import AUTO
from palpate.data.contact.interaction import Horizon
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import load_camera
from palpate.data.source.layout import ClipLayout, load_layout
from palpate.estimators.contract import Chosen, Estimator
from palpate.estimators.direct.estimator import DirectEstimator
from palpate.estimators.gan import GanEstimator
from palpate.estimators.model_settings import check_sources
from palpate.estimators.network.estimator import FAST, FULL, NetworkEstimator
from palpate.estimators.online.estimator import OnlineEstimator
from palpate.estimators.online.settings import OnlineSettings, load_settings
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.models.onnx_session import SHIPPED, ModelFileError, PosteriorModel, open_model

OF_THETA = ("network", "gan", "direct")
"""Those that tell stiffness, damping and force of a press."""
NAMES = (*OF_THETA, "online")
DEPTH = {"depth": "source", "depth_model": "model", "depth_preset": "preset", "threads": "threads", "device": "device"}
"""Arguments of `preparation` that are fields of `DepthSettings`."""


@dataclass(frozen=True)
class EstimatorOptions:
    """Everything that opens an estimator, also in another process."""

    name: str | None = None
    """One of NAMES; None = what the model's file is for, and without one `network`."""
    model: Path | None = None
    """ONNX file that `train.py export` or `estimators.network.calibration` wrote; None = the one that
    comes along."""
    onset: str | None = None
    """When a press begins, one of `estimators.onset.ONSETS`; None = between frames, as in real videos."""
    observation: str | None = None
    """What `direct` and `network` look at, one of `data.contact.interaction.OBSERVATIONS`; None = the whole dent,
    of pictures without depth its light."""
    noise: float | None = None
    """σ that `direct` is given [scene units]; None = the clip's own estimate."""
    horizon: Horizon = None
    """How much of a whole contact `network` and `direct` look at."""
    settings: Path | None = None
    """YAML file of `online`, as `configs/online.yaml`; None = its defaults, which are the same."""
    threads: int | None = None
    """CPU threads of a model; None leaves the choice to ONNX Runtime."""
    device: str = AUTO
    """Where a model runs, one of `common.onnx_devices.DEVICES`."""
    rate: str = FULL
    """What `network` does of a clip, one of `estimators.network.estimator.RATES`."""


def open_estimator(options: EstimatorOptions) -> Estimator:
    """Open an estimator.

    Raises:
        ModelFileError: the model's file can't be used, or not with these options.
        ValueError: options that don't belong together.
    """
    if options.name is not None and options.name not in NAMES:
        raise ValueError(f"there is no estimator {options.name}; choose {', '.join(NAMES)}.")
    if options.rate == FAST and options.name in ("direct", "online"):
        raise ValueError(f"--rate fast is for --estimator network; {options.name} has nothing that it could leave out.")
    if options.name == "online":
        for name in ("model", "onset", "observation", "noise", "horizon"):
            if getattr(options, name) is not None:
                raise ValueError(f"--{name} is not for --estimator online; leave it out.")
        return OnlineEstimator(OnlineSettings() if options.settings is None else load_settings(options.settings))
    if options.settings is not None:
        raise ValueError(f"--settings {options.settings} is for --estimator online; leave it out.")
    if options.name == "direct":
        return _open_direct(options)
    if options.noise is not None:
        raise ValueError("--noise is for --estimator direct; leave it out.")
    if options.name == "gan" and options.model is None:
        raise ValueError("--estimator gan needs a trained generator; give the file of train.py export as --model.")
    model = open_model(options.model or SHIPPED, options.threads, options.device)
    kind = "network" if isinstance(model, PosteriorModel) else "gan"
    if options.name not in (None, kind):
        raise ModelFileError(f"{model.path} is of the estimator {kind}; give --estimator {kind}, or leave it out.")
    if isinstance(model, PosteriorModel):
        return NetworkEstimator(model, options.onset or BETWEEN, options.horizon, options.observation, options.rate)
    if options.rate == FAST:
        raise ValueError(f"{model.path} fits nothing that could be left out; leave --rate fast out.")
    if options.onset not in (None, STAMP):
        raise ModelFileError(f"{model.path} knows nothing of when a press begins; leave --onset {options.onset} out.")
    if options.horizon is not None:
        raise ModelFileError(f"{model.path} sees single frames; leave the horizon {options.horizon} out.")
    if options.observation is not None:
        raise ValueError(f"{model.path} sees single frames; leave --observation {options.observation} out.")
    return GanEstimator(model)


def _open_direct(options: EstimatorOptions) -> DirectEstimator:
    if options.model is not None:
        raise ValueError(f"--estimator direct needs no network; leave --model {options.model} out.")
    return DirectEstimator(options.onset or BETWEEN, options.observation, options.horizon, options.noise)


def preparation(
    estimator: Estimator,
    *,
    masks: str | None = None,
    layout: str | Path | ClipLayout | None = None,
    camera: str | Path | None = None,
    smoothing: float | None = None,
    topic: str | None = None,
    **depth: Any,
) -> PrepareSettings:
    """How an estimator's frames are prepared, with what is chosen for them; None = the estimator's choice.

    Args:
        estimator: opened.
        masks: `auto`, `annotation`, `automatic`, or a file: a segmentation network's .onnx, or outlines in .yaml.
        layout: YAML file that names a folder's files, or what such a file says.
        camera: YAML or JSON file of the camera of clips that bring none of their own.
        smoothing: width over which the resting shape is smoothed [grid px] (estimators direct and online).
        topic: of the pictures in bags.
        depth: of `DEPTH`: where depth comes from (`stored`, a preset's name, or an .onnx file), and how.

    Raises:
        ValueError: something chosen can't be used, or not by this estimator.
        TypeError: there is no such choice.
    """
    if unknown := set(depth) - set(DEPTH):
        raise TypeError(f"there is no choice called {', '.join(sorted(unknown))}; choose {', '.join(DEPTH)}.")
    if smoothing is not None and estimator.name not in ("direct", "online"):
        raise ValueError(
            "geometry.smoothing is for --estimator direct and online; a network's preparation is as it was trained."
        )
    found = layout if isinstance(layout, ClipLayout) else ClipLayout() if layout is None else load_layout(Path(layout))
    if camera is not None:
        load_camera(Path(camera))
        found = replace(found, camera=str(Path(camera).resolve()))
    found = replace(found, topic=topic or found.topic)
    chosen = {DEPTH[name]: value for name, value in depth.items() if value is not None}
    settings = estimator.preparation(Chosen(found, masks, chosen, smoothing))
    check_sources(settings)
    return settings
