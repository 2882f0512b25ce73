"""Trained contact posterior → one ONNX file, its covariance calibrated, with everything inference needs beside it.

With a generator the file holds its encoder too and takes the depth window beside the contact's vector.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.calibration import Calibration, Widths
from models.generator import Generator
from models.onnx_file import PARITY_BATCHES, write_onnx
from models.onnx_session import INPUT
from models.posterior import ContactPosterior
from models.posterior_session import CONTACT, DECISIVE, LOG_COVARIANCE, LOG_MEAN, POSTERIOR, PosteriorModel


class _Widened(nn.Module):
    """Factors of a posterior's standard deviations."""

    scale: Tensor
    power: Tensor
    noise: Tensor

    def __init__(self, widths: Widths) -> None:
        super().__init__()
        for name in ("scale", "power", "noise"):
            self.register_buffer(name, torch.tensor(getattr(widths, name), dtype=torch.float32))

    def forward(self, log_sd: Tensor, log_noise: Tensor) -> Tensor:
        """Shape [B, 3], of standard deviations [B, 3] and σ [B, 1], both in logarithms."""
        return self.scale * torch.exp((self.power - 1) * log_sd + self.noise * log_noise)


class _Calibrated(nn.Module):
    """Mean, calibrated covariance, and the expected bound, by which verdicts are given."""

    def __init__(self, network: ContactPosterior | Generator, calibration: Calibration) -> None:
        super().__init__()
        self.network, self.noise_features = network, list(calibration.noise_features)
        self.known, self.loaded = list(calibration.known_features), list(calibration.loaded_features)
        self.whole, self.pressed = _Widened(calibration.whole), _Widened(calibration.pressed)

    def forward(self, contact: Tensor, depth: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        if depth is None:
            mean, factor = self.network(contact)
        else:
            answer = self.network.answer(self.network.encode(depth), contact)
            mean, factor = answer.mean, answer.factor
        log_sd = 0.5 * torch.log(factor.square().sum(dim=2))
        log_noise = torch.zeros_like(log_sd[:, :1])
        if self.noise_features:
            log_noise = contact[:, self.noise_features].sum(dim=1, keepdim=True)
        widened = self.whole(log_sd, log_noise)
        if self.known:
            known, loaded = (contact[:, places].sum(dim=1, keepdim=True) for places in (self.known, self.loaded))
            released = known - loaded > 0.5
            widened = torch.where(released, widened, self.pressed(log_sd, log_noise))
        return (
            mean,
            _covariance(factor * widened[:, :, None]),
            _covariance(_posterior(self.network).expected_bound_factor(contact)),
        )


def _posterior(network: ContactPosterior | Generator) -> ContactPosterior:
    return network.head.posterior if isinstance(network, Generator) else network


def _covariance(factor: Tensor) -> Tensor:
    """L·Lᵀ of factors L, shape [B, 3, 3]."""
    return factor @ factor.transpose(1, 2)


def export_posterior(
    network: ContactPosterior | Generator,
    output: Path,
    metadata: dict[str, Any],
    calibration: Calibration | None = None,
) -> float:
    """Write a contact posterior with a dynamic batch, and compare the file with torch.

    Args:
        network: trained posterior, or a generator whose head is one.
        output: file to write; it appears only when it is complete and agrees with torch.
        metadata: JSON-able entries beside those written here; must hold `input` (window, height, width).
        calibration: of the standard deviations; None leaves them as they are.

    Returns:
        Largest difference of the outputs over batches of 1, 2 and 7; of the expected bound's covariance, which is large
        where nothing is known, relative to numbers above 1.

    Raises:
        ParityError: the difference is over 1e-5.
    """
    calibration = Calibration() if calibration is None else calibration
    estimator = _Calibrated(network, calibration).cpu().eval()
    document = {"head": POSTERIOR, "calibration": calibration.document()} | metadata
    size = document["input"]
    window = (size["window"], size["height"], size["width"]) if isinstance(network, Generator) else None
    example = dict(zip((CONTACT, INPUT), _inputs(network, window, 2), strict=False))
    return write_onnx(
        estimator,
        example,
        [LOG_MEAN, LOG_COVARIANCE, DECISIVE],
        document,
        output,
        lambda path: _parity(estimator, PosteriorModel(path), window),
    )


def _inputs(
    network: ContactPosterior | Generator, window: tuple[int, int, int] | None, batch: int
) -> tuple[Tensor, ...]:
    """Random contacts [B, features], spread like the training's, and depth windows where the network takes them."""
    random = torch.Generator().manual_seed(batch)
    posterior = _posterior(network)
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
        sizes = 1, 1, np.maximum(np.abs(expected[2].numpy()), 1)
        for wanted, given, size in zip(expected, found, sizes, strict=True):
            largest = max(largest, float(np.max(np.abs(given - wanted.numpy()) / size)))
    return largest
