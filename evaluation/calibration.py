"""From a trained contact posterior to the model that `infer.py` uses: calibrated on validation clips and exported.

    python -m evaluation.calibration --weights runs/contact/posterior.pt --output models/weights/contact.onnx \
        [--validation runs/contact/validation]

Errors are taken to have standard deviations scale · sd^power · σ^noise, with sd the network's own and σ the
observation's; the exponents are the likeliest ones for normal errors, the scale is then set so that the 90 % intervals
hold the truth in 90 % of the validation results (conformal prediction, Vovk's quantile, with a normalised score). Both
come from the same results and several suites observe the same clips, so the guarantee is not exact. Without
--validation nothing is changed. Truth of validation clips serves this and nothing else; no weight of the network
changes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize

from data.clip import PREPROCESSING_VERSION
from data.contact_features import FEATURES, FRAME_RATE, LOG_NOISE, REFERENCE_SPACING, SLOTS
from data.masks import MaskClasses
from estimators.contact_fits import BOUNDS, MECHANICS, SCENES
from estimators.estimate import NINETY
from evaluation.recovery import OK, PREPARE, Recovery
from evaluation.recovery_store import RECORD, RESULTS, read_results
from evaluation.run_record import sha256_of
from models.calibration import Calibration
from models.posterior import ContactPosterior
from models.posterior_export import export_posterior

LEVEL = 0.9
"""Share of truths that the calibrated intervals hold."""
LEAST_SPREAD = 1e-6
"""Of a column of logarithms that can have a coefficient."""
LEAST_CLIPS = 100
"""Fewer validation estimates say too little about a 90 % quantile."""


def fit_calibration(errors: np.ndarray, deviations: np.ndarray, noise: np.ndarray) -> Calibration:
    """What makes the 90 % intervals hold 90 % of the truths, and narrow ones as often as wide ones.

    Args:
        errors: estimated minus true log θ, shape [n, 3].
        deviations: standard deviations that the network gave, shape [n, 3].
        noise: σ of each observation over REFERENCE_SPACING, shape [n].

    Raises:
        ValueError: fewer than 100 estimates.
    """
    if len(errors) < LEAST_CLIPS:
        raise ValueError(f"{len(errors)} validation estimates; calibration needs {LEAST_CLIPS} or more.")
    scales, powers, exponents = [], [], []
    for error, deviation in zip(errors.T, deviations.T, strict=True):
        known = np.stack([np.log(deviation), np.log(noise)], axis=1)
        power, exponent = fit_widths(error, known)
        powers.append(power)
        exponents.append(exponent)
        scales.append(conformal_scale(error, np.exp(known @ (power, exponent))))
    decisive = [conformal_scale(*pair) for pair in zip(errors.T, deviations.T, strict=True)]
    triples = (tuple(map(float, values)) for values in (scales, powers, exponents))
    return Calibration(*triples, noise_features=LOG_NOISE, decisive=tuple(map(float, decisive)))


def fit_widths(errors: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Likeliest coefficients b of normal errors with standard deviations exp(a + known·b), shape [D]; a is free.

    Args:
        errors: shape [n].
        known: shape [n, D]; a column without spread gets a coefficient of 0.
    """
    spread = known.std(axis=0)
    used = spread > LEAST_SPREAD
    columns = np.column_stack([np.ones(len(errors)), (known[:, used] - known[:, used].mean(axis=0)) / spread[used]])

    def loss(coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        logs = columns @ coefficients
        squares = np.square(errors) * np.exp(-2 * logs)
        return float((logs + squares / 2).mean()), columns.T @ (1 - squares) / len(errors)

    start = np.zeros(columns.shape[1])
    start[0] = np.log(np.sqrt(np.square(errors).mean()))
    found = np.zeros(known.shape[1])
    found[used] = minimize(loss, start, jac=True, method="BFGS").x[1:] / spread[used]
    return found


def conformal_scale(errors: np.ndarray, deviations: np.ndarray) -> float:
    """Factor of standard deviations [n] that makes the 90 % intervals hold 90 % of errors [n]."""
    count = len(errors)
    rank = min(math.ceil((count + 1) * LEVEL), count)
    return float(np.sort(np.abs(errors) / deviations)[rank - 1] / NINETY)


def calibration_from(rows: Sequence[Recovery]) -> Calibration:
    """Calibration by the network's validation results, all suites together.

    Raises:
        ValueError: too few of them.
    """
    used = [row for row in rows if row.estimator == "network" and row.status == OK and row.covariance is not None]
    errors = np.array([np.log(np.abs(row.estimate)) - np.log(np.abs(row.theta)) for row in used])
    deviations = np.array([np.sqrt(np.diag(row.covariance)) for row in used])
    noise = np.array([row.noise / REFERENCE_SPACING for row in used])
    return fit_calibration(errors.reshape(-1, 3), deviations.reshape(-1, 3), noise)


def check_record(folder: Path) -> None:
    """Refuse results that say nothing about what `infer.py` meets at a contact's end.

    Raises:
        OSError, ValueError: no record, another split than validation, or frames left out.
    """
    record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    if record["split"] != "validation":
        raise ValueError(f"{folder} holds the {record['split']} split; run the benchmark with --split validation.")
    if record["seen"] is not None:
        raise ValueError(f"{folder} was made with --seen {record['seen']}; run the benchmark without it.")


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
    calibration = Calibration()
    try:
        posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box))
        posterior.load_state_dict(torch.load(options.weights, map_location="cpu", weights_only=True))
        if options.validation is not None:
            check_record(options.validation)
            calibration = calibration_from(read_results(options.validation / RESULTS))
        difference = export_posterior(posterior, options.output, metadata(options.weights), calibration)
    except (OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{options.output}: written; largest difference from torch {difference:.1e}")
    for name, values in calibration.document().items():
        print(f"  {name}: {np.round(values, 3).tolist()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
