"""Trained generator → one ONNX file: encoder and parameter head, with everything inference needs in its metadata."""

from __future__ import annotations

import json
import logging
import os
import platform
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from models.generator import Generator
from models.onnx_session import FORMAT_VERSION, INPUT, METADATA_KEY, OUTPUT, ParameterModel

OPSET = 18
PARITY_BATCHES = (1, 2, 7)
PARITY_TOLERANCE = 1e-5
UNITS = {
    "stiffness": "scene units (normalised), not N/m",
    "damping": "scene units (normalised), not N·s/m",
    "force": "scene units (normalised), not N; negative presses into the tissue",
    "displacement": "scene units: depth divided by the clip's one fixed scale",
    "time": "s",
}


class ParityError(RuntimeError):
    """The exported file computes something else than the network it was made from."""


class _Estimator(nn.Module):
    """The part of a generator that runs at inference."""

    def __init__(self, generator: Generator) -> None:
        super().__init__()
        self.generator = generator

    def forward(self, depth: Tensor) -> Tensor:
        return self.generator.estimate(depth)


def export(generator: Generator, output: Path, size: tuple[int, int], metadata: dict[str, Any]) -> float:
    """Write encoder and parameter head with a dynamic batch, and compare the file with torch.

    Args:
        generator: trained G_AB.
        output: file to write; it appears only when it is complete and agrees with torch.
        size: height and width of the depth maps [pixels].
        metadata: JSON-able entries beside those written here (format version, input, units, program versions).

    Returns:
        Largest |θ_onnx − θ_torch| over batches of 1, 2 and 7.

    Raises:
        ParityError: the difference is over 1e-5.
    """
    estimator = _Estimator(generator).cpu().eval()
    document = {
        "format_version": FORMAT_VERSION,
        "input": {"window": generator.channels, "height": size[0], "width": size[1]},
        "units": UNITS,
        "versions": {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "onnxruntime": onnxruntime.__version__,
        },
    } | metadata
    model = _to_onnx(estimator, (generator.channels, *size))
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(document, ensure_ascii=False, sort_keys=True)})
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_name(f"{output.name}.{os.getpid()}.partial")
    try:
        onnx.save(model, partial, format="protobuf")
        difference = parity(estimator, ParameterModel(partial))
        if difference > PARITY_TOLERANCE:
            raise ParityError(
                f"the exported network differs from torch by {difference:.2g} in θ, more than "
                f"{PARITY_TOLERANCE:g}; nothing was written to {output}."
            )
        os.replace(partial, output)
    finally:
        partial.unlink(missing_ok=True)
    return difference


def parity(estimator: _Estimator, model: ParameterModel) -> float:
    """Largest difference of θ between torch and the file over batches of 1, 2 and 7."""
    random = torch.Generator().manual_seed(0)
    largest = 0.0
    for batch in PARITY_BATCHES:
        depth = torch.rand(batch, model.window, *model.input_size, generator=random)
        with torch.inference_mode():
            expected = estimator(depth).numpy()
        largest = max(largest, float(np.max(np.abs(model(depth.numpy()) - expected))))
    return largest


def _to_onnx(estimator: _Estimator, shape: tuple[int, int, int]) -> onnx.ModelProto:
    # The exporter tells of a missing torchvision, which nothing here uses, and of its dependencies' deprecations.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            estimator,
            (torch.rand(2, *shape),),
            dynamo=True,
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            input_names=[INPUT],
            output_names=[OUTPUT],
            opset_version=OPSET,
            external_data=False,
            verbose=False,
        )
    return program.model_proto
