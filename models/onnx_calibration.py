"""Calibration of an exported posterior: its standard deviations get the right coverage, within the file itself.

It works for any exported posterior, however it was trained: nothing but the file is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from palpate.models.calibration import LOG_DAMPING, Calibration, Widths
from palpate.models.onnx_export import to_onnx, write
from palpate.models.onnx_session import CONTACT, INPUT, LOG_COVARIANCE, LOG_MEAN, PosteriorModel

NAME_PREFIX = "calibration/"
"""Prefix of the names of nodes that calibration adds to a file."""
UNCALIBRATED = f"{NAME_PREFIX}own"
"""Name within a calibrated file of the network's own covariance."""
PARITY_BATCH = 7
"""Samples on which the calibrated file is compared with torch."""


class Widening(nn.Module):
    """Calibrates the standard deviations of covariances, by the contacts' vectors and the means."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__()
        self.calibration = calibration

    def forward(self, contact: Tensor, mean: Tensor, covariance: Tensor) -> Tensor:
        """Vectors [B, features], a network's means [B, 3] and covariances [B, 3, 3] → calibrated covariances."""
        settings, log_sd = self.calibration, 0.5 * torch.log(covariance.diagonal(dim1=1, dim2=2))
        known = log_sd, _sum_of(contact, settings.noise_features), mean @ torch.tensor(LOG_DAMPING)[:, None]
        widened = _widened(settings.whole, *known)
        if settings.known_features:
            released = _sum_of(contact, settings.known_features) - _sum_of(contact, settings.loaded_features) > 0.5
            widened = torch.where(released, widened, _widened(settings.pressed, *known))
        if settings.within_features:
            unknown = _sum_of(contact, settings.within_features) > 0
            between = torch.maximum(widened, _widened(settings.between, *known))
            widened = torch.where(unknown, between, widened)
        return covariance * (widened[:, :, None] * widened[:, None, :])


def calibrate(source: Path, output: Path, calibration: Calibration) -> float:
    """Write an exported posterior with calibrated covariances.

    Args:
        source: file that `models.onnx_export.export` wrote.
        output: file to write; it appears only when it is complete and agrees with torch.
        calibration: widths of its standard deviations.

    Returns:
        Largest difference of the covariances from torch's.

    Raises:
        ModelFileError: the file is no exported posterior.
        ValueError: the file is calibrated already.
        ForeignFile: another file than an exported network is at `output`.
        ParityError: the difference is over 1e-5.
    """
    plain = PosteriorModel(source)
    if plain.calibrated:
        raise ValueError(f"{source} is calibrated already; give the file that was exported from the training.")
    random = torch.Generator().manual_seed(0)
    inputs = {name: torch.rand(PARITY_BATCH, *shape, generator=random) for name, shape in plain.inputs.items()}
    contact, widening = inputs[CONTACT], Widening(calibration).eval()
    mean, own, _ = (torch.from_numpy(values).float() for values in plain(contact.numpy(), _numpy(inputs.get(INPUT))))
    model = onnx.load(source)
    _append(model.graph, to_onnx(widening, {CONTACT: contact, LOG_MEAN: mean, "own": own}, (LOG_COVARIANCE,)))

    def difference_of(path: Path) -> float:
        found = torch.from_numpy(PosteriorModel(path)(contact.numpy(), _numpy(inputs.get(INPUT)))[1])
        return float((found - widening(contact, mean, own)).abs().max())

    return write(model, plain.metadata | {"calibration": asdict(calibration)}, output, difference_of)


def _append(graph: onnx.GraphProto, widening: onnx.ModelProto) -> None:
    """Append a graph from (contact, mean, own) to the covariance to a graph whose covariance is then called own."""
    for node in graph.node:
        for names in (node.input, node.output):
            names[:] = [UNCALIBRATED if name == LOG_COVARIANCE else name for name in names]
    added = onnx.compose.add_prefix(widening, NAME_PREFIX).graph
    outer = {f"{NAME_PREFIX}{name}": name for name in (CONTACT, LOG_MEAN, LOG_COVARIANCE)}
    for node in added.node:
        for names in (node.input, node.output):
            names[:] = [outer.get(name, name) for name in names]
    graph.node.extend(added.node)
    graph.initializer.extend(added.initializer)


def _numpy(values: Tensor | None):
    return None if values is None else values.numpy()


def _sum_of(contact: Tensor, features: Sequence[int]) -> Tensor:
    """Sum of some of a contact's features, 0 where there are none, shape [B, 1]."""
    return contact[:, list(features)].sum(dim=1, keepdim=True)


def _widened(widths: Widths, log_sd: Tensor, log_noise: Tensor, log_damping: Tensor) -> Tensor:
    """Factors [B, 3] of standard deviations [B, 3], from these, σ and damping ratios [B, 1], all in logarithms."""
    scale, power, noise, damping, bend = (
        torch.tensor(values) for values in (widths.scale, widths.power, widths.noise, widths.damping, widths.bend)
    )
    lowest, highest = widths.middle_range
    distance = torch.clamp(log_noise, lowest, highest) - (lowest + highest) / 2
    return scale * torch.exp((power - 1) * log_sd + noise * log_noise + damping * log_damping + bend * distance**2)
