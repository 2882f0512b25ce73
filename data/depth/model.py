"""An ONNX depth network: the one preprocessing function, the session, and what its output means as depth."""

from __future__ import annotations

import glob
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from data.depth.preset import DepthError, DepthPreset

_INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}
_PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}


@dataclass(frozen=True)
class RawDepth:
    """A network's output at the picture's size, before it is turned into depth."""

    values: np.ndarray
    """Output times the preset's factor, shape [H, W] float32; NaN and Inf as the network gave them."""
    focal: float | None = None
    """Focal length that the network estimated, as a multiple of the picture's width."""

    def thumbnail(self, side: int = 160) -> RawDepth:
        """Every n-th pixel, so that neither side exceeds `side` much; enough for robust statistics of a clip."""
        step = max(1, max(self.values.shape) // side)
        return RawDepth(self.values[::step, ::step].copy(), self.focal)


@dataclass(frozen=True)
class Placement:
    """Where the picture lies in the network's input."""

    height: int
    """Height of the network's input [px]."""
    width: int
    """Width of the network's input [px]."""
    top: int
    """First row of the picture in the input; above it lies the letterbox [px]."""
    left: int
    """First column of the picture in the input [px]."""
    rows: int
    """Rows of the resized picture [px]."""
    columns: int
    """Columns of the resized picture [px]."""


def place(height: int, width: int, preset: DepthPreset, fixed: tuple[int, int] | None = None) -> Placement:
    """Network input size for a picture and where the picture lies in it.

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
    ratio = 1.0
    if isinstance(preset.size, int):
        ratio = preset.size / (min(height, width) if preset.resize == "shorter" else max(height, width))
    bound = preset.size if preset.resize == "longer" and isinstance(preset.size, int) else None
    rows, columns = (_multiple(side * ratio, preset.multiple, bound) for side in (height, width))
    return Placement(rows, columns, 0, 0, rows, columns)


def _multiple(side: float, multiple: int, bound: int | None) -> int:
    """The multiple nearest to a side, at least one of them and not above the bound."""
    count = round(side / multiple)
    if bound is not None and count * multiple > bound:
        count = math.floor(side / multiple)
    return max(1, count) * multiple


def preprocess(image: np.ndarray, preset: DepthPreset, placement: Placement) -> np.ndarray:
    """The network's input: resized (area average when shrinking, bilinear when enlarging), scaled, normalised.

    Args:
        image: RGB uint8, shape [H, W, 3].
        preset: conventions of the network.
        placement: size and position, from `place`.

    Returns:
        float32, shape [1, 3, h, w] or [1, h, w, 3] by the preset's layout.
    """
    shrinking = placement.rows * placement.columns < image.shape[0] * image.shape[1]
    interpolation = cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR
    picture = cv2.resize(image.astype(np.float32), (placement.columns, placement.rows), interpolation=interpolation)
    canvas = picture
    if (placement.rows, placement.columns) != (placement.height, placement.width):
        canvas = np.empty((placement.height, placement.width, 3), np.float32)
        canvas[:] = preset.letterbox_value
        bottom, right = placement.top + placement.rows, placement.left + placement.columns
        canvas[placement.top : bottom, placement.left : right] = picture
    scaled = canvas * np.float32(preset.value_scale / 255)
    scaled = (scaled - np.asarray(preset.mean, np.float32)) / np.asarray(preset.std, np.float32)
    if preset.channels == "BGR":
        scaled = scaled[..., ::-1]
    if preset.layout == "NCHW":
        scaled = scaled.transpose(2, 0, 1)
    return np.ascontiguousarray(scaled[None])


class DepthModel:
    """An ONNX depth network opened once; `raw` runs it on one picture."""

    def __init__(self, path: Path, preset: DepthPreset, *, threads: int = 0, device: str = "cpu") -> None:
        """Open the model and check it against the preset.

        Args:
            path: ONNX file.
            preset: conventions of the network.
            threads: intra-op threads, 0 = onnxruntime's choice.
            device: cpu or cuda.

        Raises:
            DepthError: not an ONNX model, other inputs or outputs than the preset says, or no such device.
        """
        self.path, self.preset = path, preset
        self._session = _open_session(path, threads, device)
        wanted = f"what depth preset {preset.name} expects; choose the preset that fits with depth.preset"
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        self._input = _pick(inputs, preset.input, f"{path} has the inputs", wanted)
        if len(inputs) > 1:
            names = ", ".join(entry.name for entry in inputs)
            raise DepthError(f"{path} has the inputs {names}, and a depth model takes one picture; export it that way.")
        self._check_input(inputs[0])
        self._output = _pick(outputs, preset.output, f"{path} has the outputs", wanted).name
        self._focal = None
        if preset.focal_output:
            self._focal = _pick(outputs, preset.focal_output, f"{path} has the outputs", wanted).name
        self._fixed = self._fixed_size()

    @property
    def identity(self) -> str:
        """Digest of the model file and the preset; of external weights, which may be huge, name and size count."""
        digest = hashlib.sha256()
        with self.path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
        for weights in sorted(self.path.parent.glob(f"{glob.escape(self.path.name)}[_.]*")):
            digest.update(f"{weights.name}:{weights.stat().st_size}".encode())
        return f"{self.preset.name}:{self.preset.identity}:{digest.hexdigest()}"

    def raw(self, image: np.ndarray) -> RawDepth:
        """Output of the network for one picture, resized to it bilinearly.

        Args:
            image: RGB uint8, shape [H, W, 3].

        Raises:
            DepthError: the model fails on the picture, or gives something that is not a depth map.
        """
        height, width = image.shape[:2]
        placement = place(height, width, self.preset, self._fixed)
        tensor = preprocess(image, self.preset, placement)
        dtype = _INPUT_TYPES[self._input.type]
        tensor = np.rint(tensor).clip(0, 255).astype(dtype) if dtype is np.uint8 else tensor.astype(dtype)
        names = [self._output] if self._focal is None else [self._output, self._focal]
        try:
            results = self._session.run(names, {self._input.name: tensor})
        except Exception as error:  # onnxruntime's errors share no base class of their own
            raise DepthError(
                f"{self.path} fails on a picture of {width}x{height} ({_one_line(error)}); "
                f"check the size that depth preset {self.preset.name} says."
            ) from error
        values = self._crop(np.asarray(results[0], np.float32), placement)
        # Resized in the network's own quantity, as the networks' authors do: inverse depth stays piecewise linear.
        values = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
        focal = None if self._focal is None else self._focal_length(np.asarray(results[1], np.float64), placement)
        if self.preset.canonical_focal_px is not None:
            values = values * np.float32(placement.columns / self.preset.canonical_focal_px)
        return RawDepth(values * np.float32(self.preset.factor), focal)

    def _crop(self, output: np.ndarray, placement: Placement) -> np.ndarray:
        """The picture's part of the output, shape [h, w]."""
        map_ = output.reshape([side for side in output.shape if side != 1] or [1])
        if map_.ndim != 2:
            raise DepthError(
                f"{self.path} gives an output '{self._output}' of shape {list(output.shape)}, which is not one depth "
                "map; choose the preset that fits with depth.preset."
            )
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

    def _check_input(self, entry: onnxruntime.NodeArg) -> None:
        """Refuse an input that is not one colour picture."""
        shape = entry.shape
        # Dimensions that are names or None are free.
        fixed = [side if isinstance(side, int) else None for side in shape]
        fits = len(shape) == 4 and fixed[0] in (1, None) and entry.type in _INPUT_TYPES
        if not fits or fixed[1 if self.preset.layout == "NCHW" else 3] not in (3, None):
            raise DepthError(
                f"{self.path} takes an input '{entry.name}' of shape {shape} and type {entry.type}, and depth preset "
                f"{self.preset.name} feeds one colour picture as {self.preset.layout}; choose the preset that fits "
                "with depth.preset."
            )

    def _fixed_size(self) -> tuple[int, int] | None:
        """(height, width) that the model file prescribes, or None where it takes any."""
        shape = self._input.shape
        height, width = (shape[2], shape[3]) if self.preset.layout == "NCHW" else (shape[1], shape[2])
        if not (isinstance(height, int) and isinstance(width, int)):
            return None
        size = self.preset.size
        if isinstance(size, tuple) and size != (height, width):
            raise DepthError(
                f"{self.path} takes pictures of {height}x{width} (height x width), and depth preset {self.preset.name} "
                f"says {size[0]}x{size[1]}; write a preset with that size and give it as depth.preset."
            )
        return height, width


def _open_session(path: Path, threads: int, device: str) -> onnxruntime.InferenceSession:
    """A quiet, deterministic session."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads
    options.use_deterministic_compute = True
    provider = _PROVIDERS[device]
    if provider not in onnxruntime.get_available_providers():
        raise DepthError(f"depth.device is {device}, which this onnxruntime lacks; install onnxruntime-gpu or use cpu.")
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=[provider])
    except Exception as error:  # onnxruntime's errors share no base class of their own
        raise DepthError(
            f"{path} can't be opened as an ONNX model ({_one_line(error)}); export or download it again."
        ) from error


def _pick(entries: Sequence[onnxruntime.NodeArg], names: tuple[str, ...], has: str, wanted: str) -> onnxruntime.NodeArg:
    """The input or output with an accepted name, or the only one where no name is asked for."""
    for entry in entries:
        if entry.name in names or (not names and len(entries) == 1):
            return entry
    listed = ", ".join(entry.name for entry in entries)
    expected = " or ".join(names) if names else "one alone"
    raise DepthError(f"{has} {listed}, and not {expected}, {wanted}.")


def _one_line(error: Exception) -> str:
    """An exception's first line, short enough for a sentence."""
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__
