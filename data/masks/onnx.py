"""Masks from any ONNX segmentation model, read by settings stored next to it; only onnxruntime is needed.

The settings are a YAML file of the model's name (`model.onnx` → `model.yaml`), which names the channels that are tool
and tissue. docs/inputs.md has an example.
"""

from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from scipy.special import expit, softmax

from palpate.common.files import file_sha256
from palpate.common.settings import Checked
from palpate.data.labels import TISSUE, TOOL
from palpate.data.masks.lit import lit_picture
from palpate.data.picture_network import PictureNetwork, network_input, resized
from palpate.data.source.camera import MOST_SIDE
from palpate.data.source.frames import Frame
from palpate.data.source.layout import InputError, from_mapping, read_mapping


@dataclass(frozen=True)
class SegmentationSettings(Checked):
    """Input convention of a segmentation model, and the meaning of its output."""

    tool: tuple[int, ...]
    """Output channels (or labels) that are tool."""
    tissue: tuple[int, ...] = ()
    """Output channels (or labels) that are tissue; none = all other lit pixels."""
    output: Literal["logits", "sigmoid_logits", "probabilities", "labels"] = "logits"
    """Class logits (softmax over channels), independent logits (sigmoid each), probabilities, or one label a pixel."""
    threshold: Annotated[float, 1e-6, 1 - 1e-6] = 0.5
    """Least probability of a tool or tissue pixel: the sum over the channels above, the largest for sigmoid."""
    height: Annotated[int, 1, MOST_SIDE] | None = None
    """Input height [px]; by default the model's own, else the frame's rounded up to `multiple`."""
    width: Annotated[int, 1, MOST_SIDE] | None = None
    """Input width [px]; by default the model's own, else the frame's rounded up to `multiple`."""
    multiple: Annotated[int, 1, MOST_SIDE] = 32
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
        super().__post_init__()
        if not self.tool or min(self.tool + self.tissue) < 0:
            raise ValueError("tool must list at least one output channel, from 0, and tissue none or more.")
        if set(self.tool) & set(self.tissue):
            raise ValueError(f"tool {list(self.tool)} and tissue {list(self.tissue)} share a channel.")
        if min(self.std) <= 0:
            raise ValueError("std needs numbers above 0.")


class OnnxMasks:
    """Mask source (see masks.MaskSource) that asks an ONNX segmentation model."""

    def __init__(self, path: Path, *, threads: int = 0, device: str = "cpu") -> None:
        """Open the model and its settings; threads and device as in `PictureNetwork`.

        Raises:
            InputError: not a file, not an ONNX model, no or wrong settings, or inputs that are not one picture.
        """
        self.network = PictureNetwork(path, threads=threads, device=device)
        self.path, self.settings = path, read_settings(path)
        self._fixed = self.network.fixed_size(self.settings.axes.upper())
        self.identity = f"onnx:{file_sha256(path)}:{self.settings}"

    def reset(self) -> None:
        """Nothing is remembered from frame to frame."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a frame."""
        image, settings = frame.picture, self.settings
        output, wanted = self.network.run(self._picture(image))[0], (settings.tool, settings.tissue)
        if settings.output == "labels":
            # The maps are resized like the probabilities below, so that a threshold of a half draws the outline midway.
            labels = self._label_map(output)
            maps = [np.isin(labels, values).astype(np.float32) for values in wanted]
        else:
            probabilities = self._probabilities(output)
            # Independent channels may overlap; exclusive ones add up.
            combine = np.max if settings.output == "sigmoid_logits" else np.sum
            maps = [combine(probabilities[list(channels)], axis=0, initial=0) for channels in wanted]
        tool, tissue = (cv2.resize(each, image.shape[1::-1]) for each in maps)
        rest = tissue >= settings.threshold if settings.tissue else lit_picture(image)
        labels = rest.astype(np.uint8) * np.uint8(TISSUE)
        labels[(tool >= settings.threshold) & (tool >= tissue)] = TOOL
        return labels

    def _picture(self, image: np.ndarray) -> np.ndarray:
        """Network input of the configured layout from an RGB frame."""
        settings = self.settings
        height, width = (
            chosen or fixed or -(-size // settings.multiple) * settings.multiple
            for chosen, fixed, size in zip((settings.height, settings.width), self._fixed, image.shape[:2], strict=True)
        )
        scaled = resized(image, height, width)[..., :: 1 if settings.channels == "rgb" else -1]
        return network_input(scaled, settings.value_scale, settings.mean, settings.std, settings.axes.upper())

    def _label_map(self, output: np.ndarray) -> np.ndarray:
        """Label of every pixel, [h, w]."""
        labels = output.squeeze()
        if labels.ndim != 2:
            found = list(output.shape)
            raise InputError(f"{self.path} gives {found}, not one label a pixel; check output in its settings.")
        return np.rint(labels)

    def _probabilities(self, output: np.ndarray) -> np.ndarray:
        """Probability of every channel, float32 [C, h, w]."""
        settings, found = self.settings, list(output.shape)
        highest = max(settings.tool + settings.tissue)
        maps = output.astype(np.float32)
        if maps.ndim == 4 and maps.shape[0] == 1:
            maps = maps[0]
        if maps.ndim == 3 and settings.axes == "nhwc":
            maps = maps.transpose(2, 0, 1)
        if maps.ndim != 3 or len(maps) <= highest:
            raise InputError(f"{self.path} gives {found}, without a channel {highest}; check tool and tissue.")
        if len(maps) == 1 and settings.output == "logits":
            raise InputError(f"{self.path} gives one channel; write 'output: sigmoid_logits' or 'probabilities'.")
        if settings.output == "logits":
            maps = softmax(maps, axis=0)
        elif settings.output == "sigmoid_logits":
            maps = expit(maps)
        if not np.isfinite(maps).all():
            raise InputError(f"{self.path} gives values that are not finite; check mean, std and value_scale.")
        return maps


def read_settings(path: Path) -> SegmentationSettings:
    """Settings of a model from the YAML file of its name in its folder.

    Raises:
        InputError: there is none, or it has an unknown key or an impossible value.
    """
    file = path.with_suffix(".yaml")
    if not isfile(file):
        raise InputError(f"{path} has no settings; write {file.name} next to it that names its tool channels.")
    return from_mapping(SegmentationSettings, read_mapping(file, "settings of a segmentation model"), str(file))
