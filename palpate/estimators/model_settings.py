"""Preparation settings from an exported network's metadata."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os.path import isfile
from pathlib import Path
from typing import Annotated, Any, TypeVar

from palpate.common.onnx_devices import AUTO, DEVICES
from palpate.common.options import option
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.model import DepthModel
from palpate.data.depth.normalise import BUILT_IN, MOST_THREADS, DepthSettings
from palpate.data.depth.preset import resolve_model
from palpate.data.masks.request import MaskClasses
from palpate.data.masks.sources import check_masks
from palpate.data.settings import NUMBERS, PrepareSettings
from palpate.data.source.layout import InputError, from_mapping
from palpate.estimators.contract import Estimator, Preparation
from palpate.models.onnx_session import SHIPPED, ExportedModel, ModelFileError, open_model
from palpate.physics.mechanics import Bounds, Mechanics

Settings = TypeVar("Settings")
Model = TypeVar("Model", bound=ExportedModel)


@dataclass(frozen=True)
class ModelSettings:
    """File of an exported network, and where it runs; part of the settings of estimators with one."""

    model: Path | None = option(None, metavar="FILE")
    """file from train.py export (default: the network that comes along)"""
    threads: Annotated[int, 0, MOST_THREADS] = 0
    """CPU threads; 0 = all"""
    device: str = option(AUTO, choices=lambda: DEVICES)
    """where ONNX networks run"""

    def opened(self, kind: type[Model], name: str) -> Model:
        """Open the network.

        Args:
            kind: that it must be.
            name: of the estimator that takes this kind.

        Raises:
            ModelFileError: the file can't be used, or is of another kind.
        """
        model = open_model(self.model or SHIPPED, self.threads or None, self.device)
        if not isinstance(model, kind):
            raise ModelFileError(f"{model.path} is of another estimator than {name}; leave --estimator out.")
        return model


class ModelEstimator(Estimator):
    """Common part of the estimators with a network.

    Args:
        model: the exported network.

    Raises:
        ModelFileError: its metadata can't be used.
    """

    def __init__(self, model: ExportedModel) -> None:
        self.mechanics = section(model, "mechanics", Mechanics)
        self.bounds = section(model, "bounds", Bounds)
        self.model = model

    def preparation(self, chosen: Preparation) -> PrepareSettings:
        """Return preparation as in the model's training, with the user's choices."""
        return preparation_settings(self.model, chosen)


def preparation_settings(model: ExportedModel, chosen: Preparation) -> PrepareSettings:
    """Return the preparation of frames for a model: as in its training, with the user's choices.

    Raises:
        ModelFileError: the metadata holds settings that this program does not know, or names a model file.
        ValueError: a chosen setting is impossible.
    """
    masks = chosen.masks
    depth, wanted = section(model, "depth", DepthSettings), chosen.depth_fields
    if "source" not in wanted:
        _require_file(model, "depth", depth.source)
    elif Path(wanted["source"]).name != depth.source:
        # The settings of the model's own depth network don't apply to the chosen one.
        wanted = {"model": None, "preset": None} | wanted
    if masks is None:
        masks = model.metadata.get("masks", "auto")
        # Clips without annotation are the rule outside training.
        masks = "auto" if masks == "annotation" else masks
        _require_file(model, "masks", masks)
    settings: dict[str, Any] = {name: model.metadata[name] for name in NUMBERS if name in model.metadata}
    settings |= {"depth": replace(depth, **wanted), "masks": masks, "layout": chosen.clip_layout}
    settings["geometry"] = section(model, "geometry", GeometrySettings)
    settings["classes"] = section(model, "classes", MaskClasses)
    prepare = section(model, "preparation", PrepareSettings, settings)
    size = (prepare.geometry.height, prepare.geometry.width)
    if size != model.input_size:
        raise ModelFileError(f"{model.path} takes {model.input_size} but its geometry gives {size}; export it again.")
    return prepare


def _require_file(model: ExportedModel, option: str, name: str) -> None:
    """Raise a ModelFileError unless the model file that the metadata names, without its folder, exists here."""
    if name.endswith(".onnx") and not isfile(Path(name)):
        raise ModelFileError(f"{model.path} was trained with {option} from {name}; give that file as --{option}.")


def check_sources(settings: PrepareSettings) -> None:
    """Open the depth and mask models that the settings name once, so that a wrong one is reported before any work.

    Raises:
        InputError: a model can't be used.
    """
    depth = settings.depth
    check_masks(settings.masks, threads=depth.threads, device=depth.device)
    if depth.source not in ("auto", *BUILT_IN):
        DepthModel(*resolve_model(depth.source, depth.model, depth.preset), threads=depth.threads, device=depth.device)


def section(model: ExportedModel, name: str, kind: type[Settings], values: Mapping[str, Any] | None = None) -> Settings:
    """Read a section of the model's metadata as its dataclass.

    Args:
        values: the fields to use instead of the section's own.

    Raises:
        ModelFileError: a field is unknown, or its value is impossible.
    """
    values = model.metadata.get(name, {}) if values is None else values
    # Settings of earlier versions, each with the one value that the program still supports and files may state.
    retired = {"mechanics.damping": "implicit", "mechanics.boundary": "fixed", "mechanics.anchor": 0.0}.items()
    values = {key: value for key, value in values.items() if (f"{name}.{key}", value) not in retired}
    try:
        return from_mapping(kind, values, f"{model.path}, '{name}' of its metadata,")
    except (TypeError, InputError) as error:
        raise ModelFileError(f"{error} Export the model again.") from error
