"""Exported parameter networks at inference: ONNX in, numpy out. No torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as runtime_errors

METADATA_KEY = "palpate"
"""Key of the custom metadata entry that holds everything inference needs, as one JSON document."""
FORMAT_VERSION = 1
"""Version of that document's layout; raised when a reader of the old layout would misread the new one."""
INPUT, OUTPUT = "depth", "theta"

_UNREADABLE = (
    runtime_errors.Fail,
    runtime_errors.InvalidArgument,
    runtime_errors.InvalidGraph,
    runtime_errors.InvalidProtobuf,
    runtime_errors.NotImplemented,
    runtime_errors.RuntimeException,
)


class ModelFileError(ValueError):
    """A model file that can't be used, in one sentence with the remedy."""


class ParameterModel:
    """Encoder and parameter head of a trained generator: windows of depth maps → θ.

    Args:
        path: file written by `train.py export`.
        threads: CPU threads for one call; None leaves the choice to ONNX Runtime.

    Raises:
        ModelFileError: no such file, not an ONNX file, not a parameter network of ours, with other inputs, or newer
            than this program.
    """

    def __init__(self, path: str | Path, threads: int | None = None) -> None:
        self.path = Path(path)
        self._session = open_session(self.path, threads)
        self.metadata: dict[str, Any] = read_metadata(self.path, self._session)
        """Everything the export wrote: bounds, units, mechanics, preprocessing settings and versions."""
        size = self.metadata["input"]
        self.window: int = size["window"]
        """Frames in the input window, K; the last is the current one."""
        self.input_size: tuple[int, int] = (size["height"], size["width"])
        """Height and width of the depth maps [pixels]."""
        _check_signature(self.path, self._session, (self.window, *self.input_size))

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        """θ of windows of depth maps.

        Args:
            windows: depth normalised by the clip's fixed scale, 0 = invalid, shape [B, K, H, W].

        Returns:
            θ = [k_s, k_d, F] in scene units, F signed, shape [B, 3], float32.

        Raises:
            ValueError: another shape.
        """
        expected = (self.window, *self.input_size)
        if windows.ndim != 4 or windows.shape[1:] != expected:
            raise ValueError(f"windows has shape {list(windows.shape)}; expected [B, {', '.join(map(str, expected))}].")
        return self._session.run([OUTPUT], {INPUT: np.ascontiguousarray(windows, dtype=np.float32)})[0]


def open_session(path: Path, threads: int | None) -> onnxruntime.InferenceSession:
    """Open an ONNX file.

    Raises:
        ModelFileError: no such file, or not an ONNX file.
    """
    if not path.is_file():
        raise ModelFileError(f"{path} is not a file; give the file that train.py export wrote.")
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # what goes wrong is said once, below
    if threads is not None:
        options.intra_op_num_threads = threads
    available = onnxruntime.get_available_providers()
    providers = [name for name in ("CUDAExecutionProvider", "CPUExecutionProvider") if name in available]
    try:
        return onnxruntime.InferenceSession(path.read_bytes(), options, providers=providers)
    except _UNREADABLE as error:
        raise ModelFileError(f"{path} is not a readable ONNX file; export it again with train.py export.") from error
    except OSError as error:
        raise ModelFileError(f"{path} can't be read ({error.strerror}); check the file and its permissions.") from error


def read_metadata(path: Path, session: onnxruntime.InferenceSession) -> dict[str, Any]:
    """The document that our export wrote into a file.

    Raises:
        ModelFileError: the file is not ours, or newer than this program.
    """
    foreign = f"{path} is an ONNX file without palpate's metadata; give a file that train.py export wrote."
    text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
    if text is None:
        raise ModelFileError(foreign)
    try:
        metadata = json.loads(text)
        version = int(metadata["format_version"])
        complete = all(int(metadata["input"][key]) > 0 for key in ("window", "height", "width"))
    except (ValueError, KeyError, TypeError) as error:
        raise ModelFileError(foreign) from error
    if version > FORMAT_VERSION:
        raise ModelFileError(
            f"{path} has format {version} and this program reads up to {FORMAT_VERSION}; update the program."
        )
    if not complete:
        raise ModelFileError(foreign)
    return metadata


def _check_signature(path: Path, session: onnxruntime.InferenceSession, expected: tuple[int, int, int]) -> None:
    """Compare the graph's inputs and outputs with what the metadata promises."""
    inputs = {value.name: list(value.shape) for value in session.get_inputs()}
    outputs = [value.name for value in session.get_outputs()]
    if list(inputs) != [INPUT] or inputs[INPUT][1:] != list(expected) or OUTPUT not in outputs:
        described = ", ".join(f"{name} {shape}" for name, shape in inputs.items())
        raise ModelFileError(
            f"{path} takes {described} and gives {', '.join(outputs)}, not {INPUT} [batch, "
            f"{', '.join(map(str, expected))}] and {OUTPUT}; export it again with train.py export."
        )
