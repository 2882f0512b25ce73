"""From a trained contact posterior to the model that `infer.py` uses: calibrated on validation clips and exported.

    python -m evaluation.calibration --weights runs/contact/posterior.pt --output models/weights/contact.onnx \
        [--validation runs/contact/validation]

Split-conformal: a parameter's standard deviation is multiplied by the factor that lets its 90 % intervals hold the
truth in 90 % of the validation results (Vovk's quantile, exact for one suite; several observe the same clips, so their
results are alike). Without --validation the factors are 1. Truth of validation clips serves this and nothing else; no
weight of the network changes.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from data.clip import PREPROCESSING_VERSION
from data.contact_features import FEATURES, FRAME_RATE, SLOTS
from data.masks import MaskClasses
from estimators.contact_fits import BOUNDS, MECHANICS, SCENES
from estimators.estimate import NINETY
from evaluation.recovery import OK, PREPARE, Recovery
from evaluation.recovery_store import RESULTS, read_results
from evaluation.run_record import sha256_of
from models.posterior import ContactPosterior
from models.posterior_export import export_posterior

LEVEL = 0.9
"""Share of truths that the calibrated intervals hold."""
LEAST_CLIPS = 100
"""Fewer validation clips say too little about a 90 % quantile."""


def conformal_scale(errors: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """Factors of the standard deviations that make the 90 % intervals hold 90 % of the truths.

    Args:
        errors: estimated minus true log θ, shape [n, 3].
        deviations: standard deviations that the network gave, shape [n, 3].

    Returns:
        Shape [3].

    Raises:
        ValueError: fewer than 100 clips.
    """
    count = len(errors)
    if count < LEAST_CLIPS:
        raise ValueError(f"{count} validation estimates; calibration needs {LEAST_CLIPS} or more.")
    rank = min(math.ceil((count + 1) * LEVEL), count)
    scores = np.sort(np.abs(errors) / deviations, axis=0)
    return scores[rank - 1] / NINETY


def scale_from(rows: Sequence[Recovery]) -> np.ndarray:
    """Factors from the network's validation results, all suites together."""
    used = [row for row in rows if row.estimator == "network" and row.status == OK and row.covariance is not None]
    errors = np.array([np.log(np.abs(row.estimate)) - np.log(np.abs(row.theta)) for row in used])
    deviations = np.array([np.sqrt(np.diag(row.covariance)) for row in used])
    return conformal_scale(errors.reshape(-1, 3), deviations.reshape(-1, 3))


def metadata(weights: Path) -> dict[str, object]:
    """What inference needs beside the network: how clips are prepared, the simulator and the admissible box."""
    geometry = dataclasses.asdict(PREPARE.geometry)
    depth = dataclasses.asdict(PREPARE.depth) | {"source": "auto"}
    pressed = [round(seconds * SCENES.fps) / SCENES.fps for seconds in SCENES.press_seconds]
    return {
        "input": {"window": 1, "height": geometry["height"], "width": geometry["width"]},
        "contact": {"features": FEATURES, "slots": SLOTS, "frame_rate": FRAME_RATE, "press_seconds": pressed},
        "observation": "trajectory",
        "preprocessing_version": PREPROCESSING_VERSION,
        "bounds": dataclasses.asdict(BOUNDS),
        "mechanics": dataclasses.asdict(MECHANICS),
        "geometry": geometry,
        "depth": depth,
        "masks": "auto",
        "classes": dataclasses.asdict(MaskClasses()),
        "training": {
            "motions": "simulated contacts (estimators.contact_training)",
            "weights_sha256": sha256_of(weights),
        },
    }


def main(arguments: list[str] | None = None) -> int:
    """Calibrate and export; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.calibration", description=__doc__.split("\n")[0])
    parser.add_argument("--weights", type=Path, required=True, help="posterior.pt of estimators.contact_training")
    parser.add_argument("--output", type=Path, required=True, help="ONNX file to write")
    parser.add_argument("--validation", type=Path, help="results of evaluation.benchmark --split validation")
    options = parser.parse_args(arguments)
    scale = np.ones(3)
    try:
        posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box))
        posterior.load_state_dict(torch.load(options.weights, map_location="cpu", weights_only=True))
        if options.validation is not None:
            scale = scale_from(read_results(options.validation / RESULTS))
        difference = export_posterior(posterior, options.output, metadata(options.weights), scale)
    except (OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{options.output}: written; factors of the standard deviations {np.round(scale, 3).tolist()}; largest "
          f"difference from torch {difference:.1e}")  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
