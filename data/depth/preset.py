"""Input and output conventions of a depth network, so that any ONNX depth model works by configuration alone."""

from dataclasses import asdict, dataclass
from os.path import isfile
from pathlib import Path
from typing import Annotated, Literal

from palpate.common.files import digest_of
from palpate.common.settings import Checked, Positive
from palpate.data.source.camera import MOST_SIDE
from palpate.data.source.layout import InputError, from_mapping, read_mapping

PRESET_FOLDER = Path(__file__).parent / "presets"
"""Folder of the presets that come with this project."""


@dataclass(frozen=True)
class DepthPreset(Checked):
    """Input and output conventions of one depth network."""

    name: str
    """Name in messages, in the cache key and in run.json."""
    kind: Literal["metric", "relative", "inverse", "relative_inverse", "canonical_inverse"]
    """Meaning of the output D̂; `factor` multiplies it first.
    metric: depth D = D̂ [m].
    relative: depth up to one scale that holds for the whole clip, D = D̂.
    inverse: D = 1/D̂.
    relative_inverse: D = 1/(a·D̂ + b), with a and b from near, far and the clip's frozen range of D̂.
    canonical_inverse: D = f_px/(w·D̂) (DepthPro; f_px at the width w)."""
    obtain: str = ""
    """Instruction to obtain the ONNX file, printed when it is missing."""
    output: str | tuple[str, ...] = ()
    """Accepted names of the depth output; none = the model's only output."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    """Axis order of the input."""
    channels: Literal["RGB", "BGR"] = "RGB"
    """Channel order of the input."""
    resize: Literal["exact", "shorter", "longer", "none"] = "exact"
    """Resizing of the picture: to `size` exactly, so that its shorter or longer side is `size` (aspect kept), or none.
    A fixed input size of the model file takes precedence."""
    size: tuple[int, int] | int | None = None
    """Size of the network's input: [height, width] for exact, one side for shorter and longer [px]."""
    multiple: Annotated[int, 1, MOST_SIDE] = 1
    """Number of pixels to multiples of which sides are rounded; with `longer` they never exceed `size`."""
    letterbox: bool = False
    """Keep the aspect within an exact size and fill the rest with `letterbox_value`."""
    letterbox_value: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Fill colour, in RGB on the scale of 0 to 255, before normalisation."""
    value_scale: Literal[1, 255] = 1
    """Largest input value before mean and standard deviation."""
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Mean that is subtracted from RGB [value_scale]."""
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Standard deviation by which RGB is divided after the mean [value_scale]."""
    factor: Positive = 1.0
    """Factor on the output, such as 0.001 if it is in millimetres."""
    focal_output: str | tuple[str, ...] = ()
    """Accepted names of an output that estimates the focal length; none = the model gives none."""
    focal_kind: Literal["px", "fov_deg"] = "px"
    """Kind of that output: focal length [px] or horizontal field of view [degrees]."""
    focal_grid: Annotated[int, 1, MOST_SIDE] | None = None
    """Width of the picture that the focal length refers to [px]; none = the network's input width."""
    canonical_focal_px: Positive | None = None
    """Focal length f_c of the camera for which depth is given (Metric3D: 1000): D = D̂·f/f_c, f on the input [px]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sides = self.size if isinstance(self.size, tuple) else (self.size,)
        if any(pixels is not None and not 1 <= pixels <= MOST_SIDE for pixels in sides):
            raise ValueError(f"size is {self.size}; give 1 to {MOST_SIDE} pixels.")
        if self.resize in ("shorter", "longer") and not isinstance(self.size, int):
            raise ValueError(f"resize {self.resize} needs one number as size, not {self.size!r}.")
        if self.resize == "exact" and isinstance(self.size, int):
            raise ValueError(f"resize exact needs size as [height, width], not {self.size!r}.")
        if self.letterbox and self.resize != "exact":
            raise ValueError("letterbox needs resize exact.")
        if min(self.std) <= 0:
            raise ValueError(f"std is {list(self.std)}; give positive numbers.")

    @property
    def metric(self) -> bool:
        """True if depth is in metres."""
        return self.kind in ("metric", "canonical_inverse")

    @property
    def identity(self) -> str:
        """Digest of all fields, for cache keys."""
        fields = {key: value for key, value in asdict(self).items() if key != "obtain"}
        return digest_of(fields)[:16]


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return sorted(path.stem for path in PRESET_FOLDER.glob("*.yaml"))


def load_preset(name: str | Path) -> DepthPreset:
    """Preset by its shipped name, or from a YAML file of the same fields.

    Raises:
        InputError: no such preset, unreadable file, unknown key or impossible value.
    """
    path = Path(name)
    if path.suffix.lower() not in (".yaml", ".yml"):
        if str(name) not in (names := preset_names()):
            raise InputError(f"'{name}' is no depth preset; choose one of {', '.join(names)}, or a .yaml file.")
        path = PRESET_FOLDER / f"{name}.yaml"
    return from_mapping(DepthPreset, {"name": path.stem} | read_mapping(path, "a depth preset"), str(path))


def resolve_model(source: str, model: str | None, preset: str | None) -> tuple[Path, DepthPreset]:
    """ONNX file and preset that the settings name.

    Args:
        source: preset name, or path of an ONNX file.
        model: ONNX file for a preset.
        preset: preset name or YAML file for an ONNX file; without it, the YAML file of the
            same stem in the model's folder.

    Raises:
        InputError: no model file, or no preset for it.
    """
    if Path(source).suffix.lower() != ".onnx":
        chosen = load_preset(source)
        if model is None:
            remedy = chosen.obtain or "export it to ONNX"
            raise InputError(f"Depth preset {chosen.name} needs a model file; {remedy}, and give it as depth.model.")
        path = Path(model)
        if not isfile(path):
            remedy = f", or {chosen.obtain}" if chosen.obtain else ""
            raise InputError(f"{path} (for depth preset {chosen.name}) does not exist; check depth.model{remedy}.")
        return path, chosen
    path = Path(source)
    if not isfile(path):
        raise InputError(f"{path} does not exist; check the path of the depth model.")
    preset_file = path.with_suffix(".yaml")
    if preset is None and not isfile(preset_file):
        problem = f"Nothing says how to read the depth model {path}; give depth.preset ({', '.join(preset_names())},"
        raise InputError(f"{problem} or a .yaml file), or put {preset_file.name} next to it.")
    return path, load_preset(preset if preset is not None else preset_file)
