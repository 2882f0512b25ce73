"""A network and what inference must know of it → one ONNX file that appears only when it agrees with torch."""

from __future__ import annotations

import json
import logging
import os
import platform
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from models.onnx_session import FORMAT_VERSION, METADATA_KEY

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


def write_onnx(
    network: nn.Module,
    inputs: dict[str, Tensor],
    outputs: Sequence[str],
    metadata: dict[str, Any],
    output: Path,
    parity: Callable[[Path], float],
) -> float:
    """Write a network with a dynamic batch.

    Args:
        network: on the CPU and in evaluation mode.
        inputs: an example of every argument by its name in the file, first dimension the batch (2 at least).
        outputs: names of what it returns.
        metadata: JSON-able entries beside format version, units and program versions.
        output: file to write; it appears only when it is complete and agrees with torch.
        parity: path of a file → its largest difference from the network.

    Returns:
        That difference.

    Raises:
        ParityError: it is over PARITY_TOLERANCE.
    """
    document = {
        "format_version": FORMAT_VERSION,
        "units": UNITS,
        "versions": {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "onnxruntime": onnxruntime.__version__,
        },
    } | metadata
    model = _to_onnx(network, inputs, outputs)
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(document, ensure_ascii=False, sort_keys=True)})
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_name(f"{output.name}.{os.getpid()}.partial")
    try:
        onnx.save(model, partial, format="protobuf")
        difference = parity(partial)
        if difference > PARITY_TOLERANCE:
            raise ParityError(
                f"the exported network differs from torch by {difference:.2g} in its outputs, more than "
                f"{PARITY_TOLERANCE:g}; nothing was written to {output}."
            )
        os.replace(partial, output)
    finally:
        partial.unlink(missing_ok=True)
    return difference


def _to_onnx(network: nn.Module, inputs: dict[str, Tensor], outputs: Sequence[str]) -> onnx.ModelProto:
    # The exporter tells of a missing torchvision, which nothing here uses, and of its dependencies' deprecations.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            tuple(inputs.values()),
            dynamo=True,
            dynamic_shapes=tuple({0: torch.export.Dim("batch")} for _ in inputs),
            input_names=list(inputs),
            output_names=list(outputs),
            opset_version=OPSET,
            external_data=False,
            verbose=False,
        )
    return _without_traces(program.model_proto)


def _without_traces(model: onnx.ModelProto) -> onnx.ModelProto:
    """Drop the exporter's notes: they hold stack traces with the paths of the machine that exported."""
    graph = model.graph
    for item in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del item.metadata_props[:]
    return model
