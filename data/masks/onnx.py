"""Masks from any ONNX segmentation model, read through settings beside it; onnxruntime only.

Settings stand in a YAML file of the model's name (`model.onnx` → `model.yaml`) or, as JSON, in the model's own metadata
under the key `masks`. They name the channels that are tool and tissue; docs/masks.md has an example.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import onnxruntime

from data.labels import TISSUE, TOOL
from data.masks.automatic import lit_picture
from data.source.frames import Frame
from data.source.layout import InputError, is_file, read_mapping

METADATA_KEY = "masks"


@dataclass(frozen=True)
class SegmentationSettings:
    """How a segmentation model wants its picture and what its output means."""

    tool: tuple[int, ...]
    """Output channels (or labels) that are tool."""
    tissue: tuple[int, ...] = ()
    """Output channels (or labels) that are tissue; none = the lit rest of the picture."""
    output: Literal["logits", "sigmoid_logits", "probabilities", "labels"] = "logits"
    """Class logits (softmax over channels), independent logits (sigmoid each), probabilities, or one label a pixel."""
    threshold: float = 0.5
    """Least probability of a tool or tissue pixel: the sum over the channels above, the largest for sigmoid."""
    height: int | None = None
    """Input height [px]; by default the model's own, else the frame's rounded up to `multiple`."""
    width: int | None = None
    """Input width [px], likewise."""
    multiple: int = 32
    """Divisor of the input size where neither settings nor model fix it."""
    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    """Mean of the channels, after `value_scale` (default: ImageNet)."""
    std: tuple[float, float, float] = (0.229, 0.224, 0.225)
    """Standard deviation of the channels, after `value_scale`."""
    value_scale: float = 1 / 255
    """Factor on the 8-bit values before mean and std."""
    channels: Literal["rgb", "bgr"] = "rgb"
    """Order of the input's channels."""
    axes: Literal["nchw", "nhwc"] = "nchw"
    """Order of the axes of input and output."""

    def __post_init__(self) -> None:
        for name in ("tool", "tissue", "mean", "std"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not self.tool or any(not isinstance(c, int) or c < 0 for c in self.tool + self.tissue):
            raise ValueError("tool must list at least one output channel, from 0, and tissue none or more.")
        if set(self.tool) & set(self.tissue):
            raise ValueError(f"tool {list(self.tool)} and tissue {list(self.tissue)} share a channel.")
        for name, choices in (
            ("output", ("logits", "sigmoid_logits", "probabilities", "labels")),
            ("channels", ("rgb", "bgr")),
            ("axes", ("nchw", "nhwc")),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} is '{getattr(self, name)}'; choose {', '.join(choices)}.")
        if len(self.mean) != 3 or len(self.std) != 3 or min(self.std) <= 0:
            raise ValueError("mean and std need three numbers each, std above 0.")
        if not 0 < self.threshold < 1:
            raise ValueError(f"threshold is {self.threshold}; give a number between 0 and 1.")
        if self.multiple < 1 or any(size is not None and size < 1 for size in (self.height, self.width)):
            raise ValueError("height, width and multiple must be positive.")


class OnnxMasks:
    """Mask source (see masks.MaskSource) that asks an ONNX segmentation model."""

    def __init__(self, path: Path) -> None:
        """Open the model and its settings.

        Raises:
            InputError: not a file, not an ONNX model, no or wrong settings, or inputs that are not one picture.
        """
        if not is_file(path):
            raise InputError(f"{path} does not exist; give the path of an ONNX segmentation model.")
        self.path = path
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's errors share no base class of their own
            raise InputError(f"{path} is not an ONNX model ({_first_line(error)}); export it again.") from error
        self.settings = read_settings(path, self._session.get_modelmeta().custom_metadata_map)
        inputs = self._session.get_inputs()
        if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].type not in _TYPES:
            found = ", ".join(f"{i.name} {i.type} {i.shape}" for i in inputs)
            raise InputError(f"{path} takes {found}, not one picture [1, 3, height, width]; export it that way.")
        self._input, self._type = inputs[0].name, _TYPES[inputs[0].type]
        axes = inputs[0].shape if self.settings.axes == "nchw" else [inputs[0].shape[i] for i in (0, 3, 1, 2)]
        if isinstance(axes[1], int) and axes[1] != 3:
            raise InputError(f"{path} takes {axes[1]} channels where a picture has 3; check axes in its settings.")
        self._fixed = tuple(size if isinstance(size, int) else None for size in axes[2:])
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        self.identity = f"onnx:{content}:{self.settings}"

    def reset(self) -> None:
        """Nothing is remembered from frame to frame."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a frame."""
        image = frame.picture
        picture = self._picture(image)
        try:
            output = self._session.run(None, {self._input: picture})[0]
        except Exception as error:  # onnxruntime's errors share no base class of their own
            reason = f"input {list(picture.shape)}: {_first_line(error)}"
            raise InputError(f"{self.path} fails ({reason}); check height and width in its settings.") from error
        tool, tissue = self._probabilities(output, image.shape[:2])
        labels = np.zeros(image.shape[:2], np.uint8)
        rest = lit_picture(image) if tissue is None else (tissue >= self.settings.threshold)
        labels[rest] = TISSUE
        is_tool = tool >= self.settings.threshold
        labels[is_tool if tissue is None else is_tool & (tool >= tissue)] = TOOL
        return labels

    def _picture(self, image: np.ndarray) -> np.ndarray:
        """Network input of the configured layout from an RGB frame."""
        settings = self.settings
        height, width = (
            chosen or fixed or -(-size // settings.multiple) * settings.multiple
            for chosen, fixed, size in zip((settings.height, settings.width), self._fixed, image.shape[:2], strict=True)
        )
        shrinks = height * width < image.shape[0] * image.shape[1]
        scaled = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        scaled = scaled if settings.channels == "rgb" else scaled[..., ::-1]
        mean, std = np.asarray(settings.mean, np.float32), np.asarray(settings.std, np.float32)
        values = (scaled * np.float32(settings.value_scale) - mean) / std
        values = values if settings.axes == "nhwc" else values.transpose(2, 0, 1)
        return np.ascontiguousarray(values[None], self._type)

    def _probabilities(self, output: Any, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray | None]:
        """Probability of tool and of tissue at the frame's size [H, W]; None for tissue where no channel means it."""
        settings = self.settings
        maps = self._label_maps(output) if settings.output == "labels" else self._class_maps(output)
        if not all(np.isfinite(values).all() for values in maps):
            raise InputError(f"{self.path} gives values that are not finite; check mean, std and value_scale.")
        # Labels are mixed like probabilities, so that a threshold of a half draws the outline midway.
        tool, tissue = (cv2.resize(values, size[::-1], interpolation=cv2.INTER_LINEAR) for values in maps)
        return tool, tissue if settings.tissue else None

    def _label_maps(self, output: Any) -> list[np.ndarray]:
        """1 where a label is tool and where it is tissue, float32 [h, w] each."""
        labels = np.asarray(output)
        while labels.ndim > 2 and 1 in labels.shape:
            labels = labels.squeeze(labels.shape.index(1))
        if labels.ndim != 2:
            found = list(np.shape(output))
            raise InputError(f"{self.path} gives {found}, not one label a pixel; check output in its settings.")
        groups = (self.settings.tool, self.settings.tissue)
        return [np.isin(np.rint(labels), names).astype(np.float32) for names in groups]

    def _class_maps(self, output: Any) -> list[np.ndarray]:
        """Probability of the tool channels and of the tissue channels, float32 [h, w] each."""
        settings, maps = self.settings, np.asarray(output, np.float32)
        found = list(maps.shape)
        if maps.ndim == 4 and maps.shape[0] == 1:
            maps = maps[0]
        if maps.ndim == 3 and settings.axes == "nhwc":
            maps = maps.transpose(2, 0, 1)
        highest = max(settings.tool + settings.tissue)
        if maps.ndim != 3 or len(maps) <= highest:
            raise InputError(f"{self.path} gives {found}, without a channel {highest}; check tool and tissue.")
        if len(maps) == 1 and settings.output == "logits":
            raise InputError(f"{self.path} gives one channel; write 'output: sigmoid_logits' or 'probabilities'.")
        maps = _activate(maps, settings.output)
        # Independent channels may overlap, exclusive ones add up.
        combine = np.max if settings.output == "sigmoid_logits" else np.sum
        none = np.zeros(maps.shape[1:], np.float32)
        return [combine(maps[list(names)], axis=0) if names else none for names in (settings.tool, settings.tissue)]


_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64}


def read_settings(path: Path, metadata: dict[str, str]) -> SegmentationSettings:
    """Settings of a model from the YAML file beside it, else from its metadata.

    Raises:
        InputError: neither exists, an unknown key, or an impossible value.
    """
    beside = path.with_suffix(".yaml")
    if is_file(beside):
        where, values = str(beside), read_mapping(beside, "settings of a segmentation model")
    elif METADATA_KEY in metadata:
        where = f"the metadata '{METADATA_KEY}' of {path}"
        try:
            values = json.loads(metadata[METADATA_KEY])
        except json.JSONDecodeError as error:
            raise InputError(f"{where} is not JSON ({error}); write {beside.name} beside the model instead.") from error
    else:
        raise InputError(f"{path} has no settings; write {beside.name} beside it that names its tool channels.")
    known = [field.name for field in dataclasses.fields(SegmentationSettings)]
    unknown = [key for key in values if key not in known] if isinstance(values, dict) else ["not a mapping"]
    if unknown:
        raise InputError(f"{where} has the unknown key '{unknown[0]}'; known are {', '.join(known)}.")
    if "tool" not in values:
        raise InputError(f"{where} does not say which output channels are tool; add 'tool: [1]' or the like.")
    try:
        return SegmentationSettings(**values)
    except (ValueError, TypeError) as error:
        raise InputError(f"{where} can't be used: {error}") from error


def _activate(maps: np.ndarray, kind: str) -> np.ndarray:
    """Probabilities [C, h, w] from a model's output."""
    if kind == "probabilities":
        return maps
    if kind == "sigmoid_logits":
        return 1 / (1 + np.exp(-np.clip(maps, -60, 60)))
    exponents = np.exp(maps - maps.max(axis=0))
    return exponents / exponents.sum(axis=0)


def _first_line(error: Exception) -> str:
    """First line of an error, short enough for a sentence."""
    return str(error).strip().split("\n")[0][:160]
