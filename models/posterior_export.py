"""Trained contact posterior → one ONNX file, its covariance calibrated, with everything inference needs beside it.

With a generator the file holds its encoder too and takes the depth window beside the contact's vector.
"""

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
from models.onnx_export import OPSET, PARITY_BATCHES, PARITY_TOLERANCE, UNITS, ParityError
from models.onnx_session import FORMAT_VERSION, INPUT, METADATA_KEY
from models.posterior import ContactPosterior
from models.posterior_session import CONTACT, LOG_COVARIANCE, LOG_MEAN, POSTERIOR, PosteriorModel


class _Calibrated(nn.Module):
    """Mean and covariance with every standard deviation times its calibration factor."""

    scale: Tensor

    def __init__(self, network: ContactPosterior | Generator, scale: np.ndarray) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("scale", torch.as_tensor(scale, dtype=torch.float32))

    def forward(self, contact: Tensor, depth: Tensor | None = None) -> tuple[Tensor, Tensor]:
        if depth is None:
            mean, factor = self.network(contact)
        else:
            answer = self.network.answer(self.network.encode(depth), contact)
            mean, factor = answer.mean, answer.factor
        factor = factor * self.scale[:, None]
        return mean, factor @ factor.transpose(1, 2)


def export_posterior(
    network: ContactPosterior | Generator, output: Path, metadata: dict[str, Any], scale: np.ndarray | None = None
) -> float:
    """Write a contact posterior with a dynamic batch, and compare the file with torch.

    Args:
        network: trained posterior, or a generator whose head is one.
        output: file to write; it appears only when it is complete and agrees with torch.
        metadata: JSON-able entries beside those written here; must hold `input` (window, height, width).
        scale: factors of the standard deviations of (log k_s, log k_d, log |F|), shape [3], from calibration; None = 1.

    Returns:
        Largest difference of mean and covariance over batches of 1, 2 and 7.

    Raises:
        ParityError: the difference is over 1e-5.
    """
    scale = np.ones(3) if scale is None else scale
    estimator = _Calibrated(network, scale).cpu().eval()
    document = {
        "format_version": FORMAT_VERSION,
        "head": POSTERIOR,
        "units": UNITS,
        "calibration": [float(value) for value in scale],
        "versions": {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "onnxruntime": onnxruntime.__version__,
        },
    } | metadata
    size = document["input"]
    window = (size["window"], size["height"], size["width"]) if isinstance(network, Generator) else None
    model = _to_onnx(estimator, _inputs(network, window, 2))
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(document, ensure_ascii=False, sort_keys=True)})
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_name(f"{output.name}.{os.getpid()}.partial")
    try:
        onnx.save(model, partial, format="protobuf")
        difference = _parity(estimator, PosteriorModel(partial), window)
        if difference > PARITY_TOLERANCE:
            raise ParityError(
                f"the exported posterior differs from torch by {difference:.2g}, more than {PARITY_TOLERANCE:g}; "
                f"nothing was written to {output}."
            )
        os.replace(partial, output)
    finally:
        partial.unlink(missing_ok=True)
    return difference


def _inputs(
    network: ContactPosterior | Generator, window: tuple[int, int, int] | None, batch: int
) -> tuple[Tensor, ...]:
    """Random contacts [B, features], spread like the training's, and depth windows where the network takes them."""
    random = torch.Generator().manual_seed(batch)
    posterior = network.head.posterior if isinstance(network, Generator) else network
    noise = torch.randn(batch, posterior.centre.numel(), generator=random)
    contact = posterior.centre + posterior.scale * noise
    return (contact,) if window is None else (contact, torch.rand(batch, *window, generator=random))


def _parity(estimator: _Calibrated, model: PosteriorModel, window: tuple[int, int, int] | None) -> float:
    largest = 0.0
    for batch in PARITY_BATCHES:
        inputs = _inputs(estimator.network, window, batch)
        with torch.inference_mode():
            expected = estimator(*inputs)
        found = model(*(values.numpy() for values in inputs))
        for wanted, given in zip(expected, found, strict=True):
            largest = max(largest, float(np.max(np.abs(given - wanted.numpy()))))
    return largest


def _to_onnx(estimator: _Calibrated, inputs: tuple[Tensor, ...]) -> onnx.ModelProto:
    # The exporter tells of a missing torchvision, which nothing here uses, and of its dependencies' deprecations.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            estimator,
            inputs,
            dynamo=True,
            dynamic_shapes=tuple({0: torch.export.Dim("batch")} for _ in inputs),
            input_names=[CONTACT, INPUT][: len(inputs)],
            output_names=[LOG_MEAN, LOG_COVARIANCE],
            opset_version=OPSET,
            external_data=False,
            verbose=False,
        )
    return program.model_proto
