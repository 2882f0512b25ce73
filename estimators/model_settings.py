"""What an exported network says about how its input was prepared, read back as settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from data.clip import PrepareSettings
from data.depth import DepthSettings
from data.depth_model import DepthModel
from data.depth_presets import resolve_model
from data.geometry import GeometrySettings
from data.layout import ClipLayout, is_file
from data.masks import MaskClasses, open_masks
from models.onnx_session import ModelFileError, ParameterModel

Settings = TypeVar("Settings")


def preparation_settings(
    model: ParameterModel,
    *,
    layout: ClipLayout | None = None,
    masks: str | None = None,
    depth: Mapping[str, Any] | None = None,
) -> PrepareSettings:
    """How frames are to be prepared for a model: as it was trained, with what the user chooses otherwise.

    Args:
        layout: how the clips' files are named; None = CholecSeg8k.
        masks: source of the masks; None = the model's, or annotation where a clip has it, else automatic.
        depth: fields of DepthSettings that replace the model's.

    Raises:
        ModelFileError: the metadata holds settings that this program does not know, or names a model file.
        ValueError: a chosen setting is impossible.
    """
    trained, chosen = dict(model.metadata.get("depth", {})), dict(depth or {})
    if "source" not in chosen:
        _require_file(model, "depth", trained.get("source", ""))
    elif Path(chosen["source"]).name != trained.get("source"):
        trained.pop("preset", None)  # It says how to read the model's depth network, not the chosen one.
    if masks is None:
        masks = model.metadata.get("masks", "auto")
        # Clips without annotation are the rule outside training.
        masks = "auto" if masks == "annotation" else masks
        _require_file(model, "masks", masks)
    names = ("bridge_frames", "track_seconds")
    settings: dict[str, Any] = {name: model.metadata[name] for name in names if name in model.metadata}
    prepare = PrepareSettings(
        depth=section(model, "depth", DepthSettings, trained | chosen),
        geometry=section(model, "geometry", GeometrySettings),
        masks=masks,
        classes=section(model, "classes", MaskClasses),
        layout=layout or ClipLayout(),
        **settings,
    )
    size = (prepare.geometry.height, prepare.geometry.width)
    if size != model.input_size:
        raise ModelFileError(f"{model.path} takes {model.input_size} but its geometry gives {size}; export it again.")
    return prepare


def _require_file(model: ParameterModel, option: str, name: str) -> None:
    """Ask for a model file whose name, without a path, the metadata gives."""
    if name.endswith(".onnx") and not is_file(Path(name)):
        raise ModelFileError(
            f"{model.path} was trained with {option} from {name}; give that file's path as --{option}."
        )


def check_sources(settings: PrepareSettings) -> None:
    """Open the depth and mask models that the settings name once, so that a wrong one is told before any work.

    Raises:
        InputError: one can't be used.
    """
    depth = settings.depth
    open_masks(settings.masks, settings.layout, settings.classes)
    if depth.source not in ("auto", "stored"):
        DepthModel(*resolve_model(depth.source, depth.model, depth.preset), threads=depth.threads, device=depth.device)


def section(
    model: ParameterModel, name: str, kind: type[Settings], values: Mapping[str, Any] | None = None
) -> Settings:
    """One section of the model's metadata as its dataclass; JSON's lists become tuples again.

    Args:
        values: the fields to use instead of the section's own.

    Raises:
        ModelFileError: a field is unknown, or its value is impossible.
    """
    values = model.metadata.get(name, {}) if values is None else values
    known = {field.name for field in dataclasses.fields(kind)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ModelFileError(
            f"{model.path} was exported with the unknown setting '{name}.{unknown[0]}'; "
            "use the version of this program that exported it, or export it again."
        )
    try:
        return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in values.items()})
    except (TypeError, ValueError) as error:
        problem = f"{model.path} has unusable settings in '{name}' ({error}); export it again."
        raise ModelFileError(problem) from error
