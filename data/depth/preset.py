"""What a depth network expects and gives: the facts that let any ONNX depth model plug in by configuration alone."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from data.source.layout import InputError, is_file, read_mapping

PRESET_FOLDER = Path(__file__).parent / "presets"
KINDS = ("metric", "relative", "inverse", "relative_inverse", "canonical_inverse")


class DepthError(InputError):
    """Depth that can't be used: of one frame (its status is `bad_depth`), or a model or preset that can't be opened."""


@dataclass(frozen=True)
class DepthPreset:
    """Input and output conventions of one depth network."""

    name: str
    """Name in messages, in the cache key and in run.json."""
    kind: Literal["metric", "relative", "inverse", "relative_inverse", "canonical_inverse"]
    """What the output D̂ means; `factor` multiplies it first.
    metric: depth D = D̂ [m].
    relative: depth up to one scale that holds for the whole clip, D = D̂.
    inverse: D = 1/D̂.
    relative_inverse: D = 1/(a·D̂ + b), with a and b from near, far and the clip's frozen range of D̂.
    canonical_inverse: D = f_px/(w·D̂) (DepthPro; f_px at the width w)."""
    obtain: str = ""
    """Where the ONNX file comes from, printed when it is missing."""
    model: str | None = None
    """ONNX file shipped beside this module, used when the settings name none."""
    input: tuple[str, ...] = ()
    """Accepted names of the image input; none = the model's only input."""
    output: tuple[str, ...] = ()
    """Accepted names of the depth output; none = the model's only output."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    """Axis order of the input."""
    channels: Literal["RGB", "BGR"] = "RGB"
    """Channel order of the input."""
    resize: Literal["exact", "shorter", "longer", "none"] = "exact"
    """How the picture is brought to the network's size: to `size` exactly, so that its shorter or longer side is `size`
    (aspect kept), or not at all. A model file with a fixed input size is given that size."""
    size: tuple[int, int] | int | None = None
    """[height, width] for exact, one side for shorter and longer [px]."""
    multiple: int = 1
    """Sides are rounded to a multiple of this [px]; with `longer` they never exceed `size`."""
    letterbox: bool = False
    """Keep the aspect within an exact size and fill the rest with `letterbox_value`."""
    letterbox_value: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Fill colour, in RGB on the scale of 0 to 255, before normalisation."""
    value_scale: Literal[1, 255] = 1
    """Largest input value before mean and standard deviation."""
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Subtracted from RGB [value_scale]."""
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Divides RGB after the mean [value_scale]."""
    factor: float = 1.0
    """Multiplies the output, e.g. 0.001 where it is in millimetres."""
    focal_output: tuple[str, ...] = ()
    """Accepted names of an output that estimates the focal length; none = the model gives none."""
    focal_kind: Literal["px", "fov_deg"] = "px"
    """Whether that output is a focal length [px] or a horizontal field of view [degrees]."""
    focal_grid: int | None = None
    """Width of the picture that the focal length refers to [px]; none = the network's input width."""
    canonical_focal_px: float | None = None
    """Depth for a camera of this focal length (Metric3D: 1000): D = D̂·f/f_canonical with f on the input [px]."""
    metric: bool = False
    """Whether depth is in metres."""

    def __post_init__(self) -> None:
        for name in ("input", "output", "focal_output"):
            value = getattr(self, name)
            names = () if value is None else (value,) if isinstance(value, str) else tuple(str(item) for item in value)
            object.__setattr__(self, name, names)
        for name in ("mean", "std", "letterbox_value"):
            object.__setattr__(self, name, self._three_numbers(name))
        if isinstance(self.size, (list, tuple)):
            object.__setattr__(self, "size", tuple(int(side) for side in self.size))
        for name, choices in {
            "kind": KINDS,
            "layout": ("NCHW", "NHWC"),
            "channels": ("RGB", "BGR"),
            "resize": ("exact", "shorter", "longer", "none"),
            "value_scale": (1, 255),
            "focal_kind": ("px", "fov_deg"),
        }.items():
            if getattr(self, name) not in choices:
                listed = ", ".join(str(choice) for choice in choices)
                raise ValueError(f"{name} is {getattr(self, name)!r}; choose one of {listed}")
        self._check_sizes()
        for name in ("factor", "canonical_focal_px"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value}; give a positive number")
        if min(self.std) <= 0:
            raise ValueError(f"std is {list(self.std)}; give positive numbers")
        if self.metric and self.kind in ("relative", "relative_inverse"):
            raise ValueError(f"a model of kind {self.kind} is not metric; leave metric out")

    def _three_numbers(self, name: str) -> tuple[float, ...]:
        """The field as three finite floats."""
        try:
            values = tuple(float(item) for item in getattr(self, name))
        except (TypeError, ValueError):
            values = ()
        if len(values) != 3 or not all(math.isfinite(value) for value in values):
            raise ValueError(f"{name} is {getattr(self, name)!r}; give three numbers in RGB order")
        return values

    def _check_sizes(self) -> None:
        """Refuse sizes that don't fit the way of resizing."""
        sides = self.size if isinstance(self.size, tuple) else () if self.size is None else (self.size,)
        if any(side < 1 for side in sides) or self.multiple < 1 or (self.focal_grid or 1) < 1:
            raise ValueError("size, multiple and focal_grid are pixels; give numbers of at least 1")
        if self.resize in ("shorter", "longer") and not isinstance(self.size, int):
            raise ValueError(f"resize {self.resize} needs one number as size, not {self.size!r}")
        if self.resize == "exact" and self.size is not None and len(sides) != 2:
            raise ValueError(f"resize exact needs size as [height, width], not {self.size!r}")
        if self.letterbox and self.resize != "exact":
            raise ValueError("letterbox needs resize exact")

    @property
    def identity(self) -> str:
        """Digest of all fields, for cache keys."""
        fields = {key: value for key, value in dataclasses.asdict(self).items() if key != "obtain"}
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()[:16]


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return sorted(path.stem for path in PRESET_FOLDER.glob("*.yaml"))


def load_preset(name: str | Path) -> DepthPreset:
    """Preset by its shipped name, or from a YAML file of the same fields.

    Raises:
        DepthError: no such preset, unreadable file, unknown key or impossible value.
    """
    path = Path(name)
    if path.suffix.lower() not in (".yaml", ".yml"):
        if str(name) not in preset_names():
            raise DepthError(
                f"'{name}' is no depth preset; choose one of {', '.join(preset_names())}, "
                "or give the path of a .yaml file."
            )
        path = PRESET_FOLDER / f"{name}.yaml"
    try:
        values: dict[str, Any] = {"name": path.stem} | read_mapping(path, "a depth preset")
    except InputError as error:
        raise DepthError(str(error)) from error
    known = [field.name for field in dataclasses.fields(DepthPreset)]
    for key in values:
        if key not in known:
            raise DepthError(f"{path} has the unknown key '{key}'; known are {', '.join(known)}.")
    try:
        return DepthPreset(**values)
    except (TypeError, ValueError) as error:
        raise DepthError(f"{path} is not a depth preset: {error}.") from error


def resolve_model(source: str, model: str | None, preset: str | None) -> tuple[Path, DepthPreset]:
    """ONNX file and preset that the settings mean.

    Args:
        source: preset name, or path of an ONNX file.
        model: ONNX file for a preset.
        preset: preset name or YAML file for an ONNX file; without it, a YAML file of the same stem beside the model.

    Raises:
        DepthError: no file, or nothing that says how to read it.
    """
    if Path(source).suffix.lower() != ".onnx":
        chosen = load_preset(source)
        path = Path(model) if model is not None else None
        if path is None and chosen.model is not None:
            path = PRESET_FOLDER.parent / chosen.model
        if path is None:
            remedy = chosen.obtain or "export it to ONNX"
            raise DepthError(f"Depth preset {chosen.name} needs a model file; {remedy}, and give it as depth.model.")
        if not is_file(path):
            remedy = f", or {chosen.obtain}" if chosen.obtain else ""
            raise DepthError(f"{path} (for depth preset {chosen.name}) does not exist; check depth.model{remedy}.")
        return path, chosen
    path = Path(source)
    if not is_file(path):
        raise DepthError(f"{path} does not exist; check the path of the depth model.")
    beside = path.with_suffix(".yaml")
    if preset is None and not is_file(beside):
        raise DepthError(
            f"Nothing says how to read the depth model {path}; give depth.preset ({', '.join(preset_names())}, or a "
            f".yaml file), or put {beside.name} beside it."
        )
    return path, load_preset(preset if preset is not None else beside)
