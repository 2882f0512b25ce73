"""Trained contact posterior → one ONNX file, its covariance calibrated, with everything inference needs beside it."""

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

from models.onnx_export import OPSET, PARITY_BATCHES, PARITY_TOLERANCE, UNITS, ParityError
from models.onnx_session import FORMAT_VERSION, METADATA_KEY
from models.posterior import ContactPosterior
from models.posterior_session import CONTACT, LOG_COVARIANCE, LOG_MEAN, POSTERIOR, PosteriorModel


class _Calibrated(nn.Module):
    """Mean and covariance with every standard deviation times its calibration factor."""

    scale: Tensor

    def __init__(self, posterior: ContactPosterior, scale: np.ndarray) -> None:
        super().__init__()
        self.posterior = posterior
        self.register_buffer("scale", torch.as_tensor(scale, dtype=torch.float32))

    def forward(self, contact: Tensor) -> tuple[Tensor, Tensor]:
        mean, factor = self.posterior(contact)
        factor = factor * self.scale[:, None]
        return mean, factor @ factor.transpose(1, 2)


def export_posterior(posterior: ContactPosterior, output: Path, metadata: dict[str, Any], scale: np.ndarray) -> float:
    """Write a contact posterior with a dynamic batch, and compare the file with torch.

    Args:
        posterior: trained network.
        output: file to write; it appears only when it is complete and agrees with torch.
        metadata: JSON-able entries beside those written here; must hold `input` (window, height, width).
        scale: factors of the standard deviations of (log k_s, log k_d, log |F|), shape [3], from calibration.

    Returns:
        Largest difference of mean and covariance over batches of 1, 2 and 7.

    Raises:
        ParityError: the difference is over 1e-5.
    """
    network = _Calibrated(posterior, scale).cpu().eval()
    features = posterior.centre.numel()
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
    model = _to_onnx(network, features)
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(document, ensure_ascii=False, sort_keys=True)})
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_name(f"{output.name}.{os.getpid()}.partial")
    try:
        onnx.save(model, partial, format="protobuf")
        difference = _parity(network, PosteriorModel(partial))
        if difference > PARITY_TOLERANCE:
            raise ParityError(
                f"the exported posterior differs from torch by {difference:.2g}, more than {PARITY_TOLERANCE:g}; "
                f"nothing was written to {output}."
            )
        os.replace(partial, output)
    finally:
        partial.unlink(missing_ok=True)
    return difference


def _parity(network: _Calibrated, model: PosteriorModel) -> float:
    random = torch.Generator().manual_seed(0)
    largest = 0.0
    for batch in PARITY_BATCHES:
        noise = torch.randn(batch, model.features, generator=random)
        contact = network.posterior.centre + network.posterior.scale * noise
        with torch.inference_mode():
            expected = network(contact)
        for wanted, given in zip(expected, model(contact.numpy()), strict=True):
            largest = max(largest, float(np.max(np.abs(given - wanted.numpy()))))
    return largest


def _to_onnx(network: _Calibrated, features: int) -> onnx.ModelProto:
    # The exporter tells of a missing torchvision, which nothing here uses, and of its dependencies' deprecations.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            (torch.randn(2, features),),
            dynamo=True,
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            input_names=[CONTACT],
            output_names=[LOG_MEAN, LOG_COVARIANCE],
            opset_version=OPSET,
            external_data=False,
            verbose=False,
        )
    return program.model_proto
