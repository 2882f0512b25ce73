"""What the benchmark compares: the estimators that users run, and what a constant says."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from palpate.estimators.contract import Estimator
from palpate.estimators.estimate import Estimate
from palpate.estimators.open import FEM, OF_THETA, EstimatorOptions, open_estimator
from palpate.models.onnx_session import ModelFileError, PosteriorModel

CONSTANT, DIRECT = "constant", "direct"
"""What ignores its input, and the estimator that fits grips."""
NAMES = (*sorted(OF_THETA), CONSTANT)
"""Estimators in the order of tables."""
GRID = (120, 214)
"""Height and width of the clips' depth [px]."""
Candidate = EstimatorOptions | Estimate
"""An estimator, or what one says that ignores its input."""


@functools.cache
def opened(options: EstimatorOptions) -> Estimator:
    """The estimator, opened once a process.

    Raises:
        ModelFileError: its network can't be used.
    """
    found = open_estimator(options)
    model = getattr(found, "model", None)
    if model is not None and getattr(model, "takes_depth", True) and model.input_size != GRID:
        height, width = model.input_size
        raise ModelFileError(
            f"{model.path} takes depth of {width}x{height} pixels and the benchmark's has {GRID[1]}x{GRID[0]}; "
            "export a network that was trained at that size."
        )
    return found


def describe(options: EstimatorOptions) -> dict[str, Any]:
    """What its estimates depend on, for the run's record.

    Raises:
        ModelFileError: its network can't be used.
    """
    # A slab is told of every clip how thick its tissue is, so no estimator can be opened for all.
    solid = options.name == "direct" and options.model == Path(FEM)
    model = None if solid else getattr(opened(options), "model", None)
    posterior = model if isinstance(model, PosteriorModel) else None
    told = {"fits": FEM} if solid else {}
    return told | {
        "model_sha256": "" if model is None else model.sha256,
        "weights_sha256": "" if posterior is None else posterior.metadata.get("training", {}).get("weights_sha256", ""),
        "calibrated": None if posterior is None else posterior.calibrated,
        "noise": options.noise,
        "observation": options.observation,
        "seen": options.horizon,
        "onset": options.onset,
    }
