"""Trained generator → one ONNX file: encoder and parameter head, with everything inference needs in its metadata."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.generator import Generator
from models.onnx_file import PARITY_BATCHES, write_onnx
from models.onnx_session import INPUT, OUTPUT, ParameterModel


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
    example = {INPUT: torch.rand(2, generator.channels, *size)}
    document = {"input": {"window": generator.channels, "height": size[0], "width": size[1]}} | metadata
    return write_onnx(
        estimator, example, [OUTPUT], document, output, lambda path: parity(estimator, ParameterModel(path))
    )


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
