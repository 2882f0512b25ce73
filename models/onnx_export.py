"""Trained network → one ONNX file with all metadata for inference; it appears only when it agrees with torch.

A generator's file has the encoder and the parameter head, a contact posterior's file the posterior and the covariance
of its expected bound. A posterior that is a generator's head takes the depth window in addition to the contact's
vector. `calibrate` gives the standard deviations of any exported posterior the right coverage within the file itself.
"""

import logging
import platform
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from palpate.common.files import as_json
from palpate.common.output import replacing_own
from palpate.models.calibration import LOG_DAMPING, Calibration, Widths
from palpate.models.generator import Generator, ParameterHead
from palpate.models.onnx_session import (
    CONTACT,
    EXPECTED_BOUND,
    FORMAT_VERSION,
    INPUT,
    LOG_COVARIANCE,
    LOG_MEAN,
    METADATA_KEY,
    POSTERIOR,
    ExportedModel,
    ModelFileError,
    ParameterModel,
    PosteriorModel,
)
from palpate.models.posterior import ContactPosterior

PARITY_TOLERANCE = 1e-5
"""Largest difference from torch."""


class ParityError(RuntimeError):
    """Error: the exported file gives other numbers than its network."""


class _Parameters(nn.Module):
    """Part of a generator that runs at inference."""

    kind = ParameterModel

    def __init__(self, generator: Generator) -> None:
        super().__init__()
        self.generator = generator

    def examples(self, batch: int, window: tuple[int, int, int]) -> dict[str, Tensor]:
        """Random inputs by their names in the file; `window` is the shape of one depth window."""
        return {INPUT: torch.rand(batch, *window, generator=torch.Generator().manual_seed(batch))}

    def forward(self, depth: Tensor) -> tuple[Tensor]:
        return (self.generator.estimate(depth),)


class _Posterior(nn.Module):
    """Mean and covariance of the posterior, and the covariance of the expected bound, by which verdicts are given."""

    kind = PosteriorModel

    def __init__(self, network: ContactPosterior | Generator) -> None:
        super().__init__()
        self.network = network

    @property
    def posterior(self) -> ContactPosterior:
        """The network, or its head."""
        return self.network.posterior if isinstance(self.network, Generator) else self.network

    def examples(self, batch: int, window: tuple[int, int, int]) -> dict[str, Tensor]:
        """Random inputs by their names in the file: contacts are spread like those of the training."""
        random, centre = torch.Generator().manual_seed(batch), self.posterior.centre
        contact = centre + self.posterior.scale * torch.randn(batch, len(centre), generator=random)
        depth = {INPUT: torch.rand(batch, *window, generator=random)} if isinstance(self.network, Generator) else {}
        return {CONTACT: contact} | depth

    def forward(self, contact: Tensor, depth: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        if isinstance(self.network, Generator) and depth is not None:
            mean, factor = self.network.head(self.network.encode(depth), contact)
        else:
            mean, factor = self.network(contact)
        bound = self.posterior.expected_bound_factor(contact)
        return mean, factor @ factor.transpose(1, 2), bound @ bound.transpose(1, 2)


def export(network: Generator | ContactPosterior, output: Path, metadata: dict[str, Any]) -> float:
    """Write encoder and parameter head, or a contact posterior, with a dynamic batch, and compare the file with torch.

    Args:
        network: trained G_AB, or a posterior alone.
        output: file to write; it appears only when it is complete and agrees with torch.
        metadata: JSON-able entries in addition to format version, kind, units and program versions, `input` (window,
            height, width) among them.

    Returns:
        Largest difference of the outputs over batches of 1, 2 and 7; that of the expected bound's covariance is
        relative where numbers are above 1.

    Raises:
        ForeignFile: `output` is not as this program wrote it.
        ParityError: the difference is over 1e-5.
    """
    versions = {package.__name__: package.__version__ for package in (torch, onnx, onnxruntime)}
    units = {
        "stiffness": "scene units (normalised), not N/m",
        "damping": "scene units (normalised), not N·s/m",
        "force": "scene units (normalised), not N; negative presses into the tissue",
        "displacement": "scene units: depth divided by the clip's one fixed scale",
        "time": "s",
    }
    document: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "units": units,
        "versions": {"python": platform.python_version(), **versions},
    }
    if isinstance(network, Generator) and isinstance(network.head, ParameterHead):
        exported = _Parameters(network)
    else:
        exported = _Posterior(network)
        document |= {"head": POSTERIOR, "calibration": asdict(Calibration())}
    exported.cpu().eval()
    window = tuple(metadata["input"][name] for name in ("window", "height", "width"))
    model = to_onnx(exported, exported.examples(2, window), exported.kind.outputs)
    return write(model, document | metadata, output, lambda partial: parity(exported, exported.kind(partial), window))


def write(
    model: onnx.ModelProto,
    document: dict[str, Any],
    output: Path,
    difference_of: Callable[[Path], float],
    tolerance: float | None = None,
) -> float:
    """Write a graph with its metadata to a file that appears only when it is complete and agrees with torch.

    Args:
        model: graph.
        document: metadata.
        output: file to write.
        difference_of: the file's largest difference from torch, which is returned.
        tolerance: largest difference that is allowed; None = PARITY_TOLERANCE.

    Raises:
        ForeignFile, ParityError: as in `export`, or its numbers are not finite.
    """
    most = PARITY_TOLERANCE if tolerance is None else tolerance
    onnx.helper.set_model_props(model, {METADATA_KEY: as_json(document, ensure_ascii=False, sort_keys=True)})
    output.parent.mkdir(parents=True, exist_ok=True)
    with replacing_own(output) as partial:
        onnx.save(model, partial, format="protobuf")
        try:
            difference = difference_of(partial)
        except ModelFileError as error:
            raise ParityError(str(error).replace(str(partial), str(output))) from error
        if not difference <= most:  # or it is no number
            problem = f"the exported network differs from torch by {difference:.2g} in its outputs, more than {most:g};"
            raise ParityError(f"{problem} nothing was written to {output}.")
    return difference


def parity(network: _Parameters | _Posterior, model: ExportedModel, window: tuple[int, int, int]) -> float:
    """Largest difference between torch and the file over batches of 1, 2 and 7."""
    largest = 0.0
    for batch in (1, 2, 7):
        inputs = network.examples(batch, window)
        with torch.inference_mode():
            expected = [values.numpy() for values in network(*inputs.values())]
        found = model.run({name: values.numpy() for name, values in inputs.items()})
        for name, wanted, computed in zip(model.outputs, expected, found, strict=True):
            size = np.maximum(np.abs(wanted), 1) if name == EXPECTED_BOUND else 1
            largest = max(largest, float(np.max(np.abs(computed - wanted) / size)))
    return largest


def to_onnx(network: nn.Module, inputs: dict[str, Tensor], outputs: Sequence[str]) -> onnx.ModelProto:
    """A network as a graph with a dynamic batch, from examples of its inputs by their names."""
    # The exporter warns of a missing torchvision, which nothing here uses, and of its dependencies' deprecations.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        how: dict[str, Any] = {"dynamo": True, "opset_version": 18, "external_data": False, "verbose": False}
        names: dict[str, Any] = {"input_names": list(inputs), "output_names": list(outputs)}
        shapes = tuple({0: torch.export.Dim("batch")} for _ in inputs)
        program = torch.onnx.export(network, tuple(inputs.values()), dynamic_shapes=shapes, **names, **how)
    model = program.model_proto  # ty: ignore[missing-union-attribute]  none only without dynamo
    # The exporter's notes hold stack traces with the paths of the machine that exported.
    graph = model.graph
    for item in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del item.metadata_props[:]
    return model


class Widening(nn.Module):
    """Calibration of the standard deviations of covariances, by the contacts' vectors and the means."""

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
        ForeignFile: `output` is not as this program wrote it.
        ParityError: the difference is over 1e-5.
    """
    plain = PosteriorModel(source)
    if plain.calibrated:
        raise ValueError(f"{source} is calibrated already; give the file that was exported from the training.")
    random = torch.Generator().manual_seed(0)
    # Samples on which the calibrated file is compared with torch.
    inputs = {name: torch.rand(7, *shape, generator=random) for name, shape in plain.inputs.items()}
    contact, widening = inputs[CONTACT], Widening(calibration).eval()
    given = [inputs[name].numpy() for name in (CONTACT, INPUT) if name in inputs]
    mean, own, _ = (torch.from_numpy(values).float() for values in plain(*given))
    model = onnx.load(source)
    # The network's own covariance gets another name, and that of the added nodes its name.
    prefix = "calibration/"
    uncalibrated = f"{prefix}own"
    for node in model.graph.node:
        for names in (node.input, node.output):
            names[:] = [uncalibrated if name == LOG_COVARIANCE else name for name in names]
    added = to_onnx(widening, {CONTACT: contact, LOG_MEAN: mean, uncalibrated: own}, (LOG_COVARIANCE,))
    added = onnx.compose.add_prefix(added, prefix, rename_inputs=False, rename_outputs=False)
    model.graph.node.extend(added.graph.node)
    model.graph.initializer.extend(added.graph.initializer)

    def difference_of(path: Path) -> float:
        found = torch.from_numpy(PosteriorModel(path)(*given)[1])
        return float((found - widening(contact, mean, own)).abs().max())

    return write(model, plain.metadata | {"calibration": asdict(calibration)}, output, difference_of)


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
