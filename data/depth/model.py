"""An ONNX depth network: the one preprocessing function, the session, and its output as depth."""

import glob
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from palpate.data.depth.preset import DepthPreset
from palpate.data.picture_network import PictureNetwork, network_input, resized
from palpate.data.source.layout import InputError


@dataclass(frozen=True)
class RawDepth:
    """A network's output at the picture's size, before it is turned into depth."""

    values: np.ndarray
    """Output times the preset's factor, shape [H, W] float32; NaN and Inf are kept."""
    focal: float | None = None
    """Focal length that the network estimated, as a multiple of the picture's width."""

    def thumbnail(self) -> "RawDepth":
        """Every n-th pixel, about 160 along the longer side; enough for robust statistics of a clip."""
        step = max(1, max(self.values.shape) // 160)
        return RawDepth(self.values[::step, ::step].copy(), self.focal)


@dataclass(frozen=True)
class Placement:
    """Place of the picture in the network's input."""

    height: int
    """Height of the network's input [px]."""
    width: int
    """Width of the network's input [px]."""
    top: int
    """First row of the picture in the input, below the letterbox [px]."""
    left: int
    """First column of the picture in the input [px]."""
    rows: int
    """Rows of the resized picture [px]."""
    columns: int
    """Columns of the resized picture [px]."""


def place(height: int, width: int, preset: DepthPreset, fixed: tuple[int, int] | None = None) -> Placement:
    """Network input size for a picture, and the picture's place in it.

    Args:
        height: rows of the picture [px].
        width: columns of the picture [px].
        preset: conventions of the network.
        fixed: (height, width) that the model file itself prescribes, which replaces the preset's size.
    """
    if preset.resize == "exact" or fixed is not None:
        rows, columns = fixed or (preset.size if isinstance(preset.size, tuple) else (height, width))
        if not preset.letterbox:
            return Placement(rows, columns, 0, 0, rows, columns)
        ratio = min(rows / height, columns / width)
        inner_rows, inner_columns = min(rows, round(height * ratio)), min(columns, round(width * ratio))
        top, left = (rows - inner_rows) // 2, (columns - inner_columns) // 2
        return Placement(rows, columns, top, left, max(1, inner_rows), max(1, inner_columns))
    ratio, most = 1.0, math.inf
    if isinstance(preset.size, int):
        shorter = preset.resize == "shorter"
        ratio = preset.size / (min(height, width) if shorter else max(height, width))
        most = math.inf if shorter else preset.size // preset.multiple
    counts = (max(1, min(round(side * ratio / preset.multiple), most)) for side in (height, width))
    rows, columns = (int(count) * preset.multiple for count in counts)
    return Placement(rows, columns, 0, 0, rows, columns)


def preprocess(image: np.ndarray, preset: DepthPreset, placement: Placement) -> np.ndarray:
    """The network's input: resized (area average when shrinking, bilinear when enlarging), scaled, normalised.

    Args:
        image: RGB uint8, shape [H, W, 3].
        preset: conventions of the network.
        placement: size and position, from `place`.

    Returns:
        float32, shape [1, 3, h, w] or [1, h, w, 3] by the preset's layout.
    """
    canvas = resized(image.astype(np.float32), placement.rows, placement.columns)
    if preset.letterbox:
        bottom = placement.height - placement.top - placement.rows
        right = placement.width - placement.left - placement.columns
        sides = (placement.top, bottom, placement.left, right)
        canvas = cv2.copyMakeBorder(canvas, *sides, cv2.BORDER_CONSTANT, value=preset.letterbox_value)
    order = -1 if preset.channels == "BGR" else 1
    mean, std = preset.mean[::order], preset.std[::order]
    return network_input(canvas[..., ::order], preset.value_scale / 255, mean, std, preset.layout)


class DepthModel:
    """An ONNX depth network opened once; `raw` runs it on one picture."""

    def __init__(self, path: Path, preset: DepthPreset, *, threads: int = 0, device: str = "cpu") -> None:
        """Open the model and check it against the preset.

        Args:
            path: ONNX file.
            preset: conventions of the network.
            threads: intra-op threads, 0 = onnxruntime's choice.
            device: one of `palpate.common.onnx_devices.DEVICES`.

        Raises:
            InputError: not an ONNX model, other inputs or outputs than the preset states, or no such device.
        """
        self.path, self.preset = path, preset
        self.network = PictureNetwork(path, threads=threads, device=device, raw=True)
        self._fixed = self._fixed_size()
        self._outputs = [self._named_output(preset.output)]
        if preset.focal_output:
            self._outputs.append(self._named_output(preset.focal_output))

    @property
    def identity(self) -> str:
        """Digest of the model file and the preset; external weights, which may be huge, enter by name and size."""
        with self.path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        for weights in sorted(self.path.parent.glob(f"{glob.escape(self.path.name)}[_.]*")):
            digest.update(f"{weights.name}:{weights.stat().st_size}".encode())
        return f"{self.preset.name}:{self.preset.identity}:{digest.hexdigest()}"

    def raw(self, image: np.ndarray) -> RawDepth:
        """Output of the network for one picture, resized to it bilinearly.

        Args:
            image: RGB uint8, shape [H, W, 3].

        Raises:
            InputError: the model fails on the picture, or gives something that is not a depth map.
        """
        height, width = image.shape[:2]
        placement = place(height, width, self.preset, self._fixed)
        results = self.network.run(preprocess(image, self.preset, placement), self._outputs)
        values = self._crop(np.asarray(results[0], np.float32), placement)
        # Resized in the network's own quantity, as the networks' authors do: inverse depth stays piecewise linear.
        values = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
        focal = self._focal_length(results[1], placement) if self.preset.focal_output else None
        if self.preset.canonical_focal_px is not None:
            values = values * np.float32(placement.columns / self.preset.canonical_focal_px)
        return RawDepth(values * np.float32(self.preset.factor), focal)

    def _crop(self, output: np.ndarray, placement: Placement) -> np.ndarray:
        """The picture's part of the output, shape [h, w]."""
        map_ = output.squeeze()
        if map_.ndim != 2:
            problem = f"{self.path} gives an output '{self._outputs[0]}' of shape {list(output.shape)},"
            raise InputError(f"{problem} which is not one depth map; choose the preset that fits with depth.preset.")
        down, across = map_.shape[0] / placement.height, map_.shape[1] / placement.width
        top, left = round(placement.top * down), round(placement.left * across)
        bottom = max(top + 1, round((placement.top + placement.rows) * down))
        right = max(left + 1, round((placement.left + placement.columns) * across))
        return map_[top:bottom, left:right]

    def _focal_length(self, output: np.ndarray, placement: Placement) -> float | None:
        """Focal length as a multiple of the picture's width; None where the network gives no usable one."""
        value = float(output.ravel()[0])
        if self.preset.focal_kind == "fov_deg":
            return 0.5 / math.tan(math.radians(value) / 2) if 0 < value < 180 else None
        return value / (self.preset.focal_grid or placement.columns) if 0 < value < math.inf else None

    def _named_output(self, names: str | tuple[str, ...]) -> str:
        """The output with an accepted name, or the only one where no name is asked for."""
        accepted, outputs = (names,) if isinstance(names, str) else names, self.network.outputs
        for name in outputs:
            if name in accepted or (not accepted and len(outputs) == 1):
                return name
        raise InputError(
            f"{self.path} has the outputs {', '.join(outputs)}, and not {' or '.join(accepted) or 'one alone'}, what "
            f"depth preset {self.preset.name} expects; give another, or write one (docs/depth.md)."
        )

    def _fixed_size(self) -> tuple[int, int] | None:
        """(height, width) that the model file prescribes, or None where it takes any."""
        height, width = self.network.fixed_size(self.preset.layout)
        if height is None or width is None:
            return None
        size = self.preset.size
        if isinstance(size, tuple) and size != (height, width):
            raise InputError(
                f"{self.path} takes pictures of {height}x{width} (height x width), and depth preset {self.preset.name} "
                f"says {size[0]}x{size[1]}; write a preset with that size and give it as depth.preset."
            )
        return height, width
