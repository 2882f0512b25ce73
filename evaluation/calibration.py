"""From a trained contact posterior to the model that `infer.py` uses: exported, and calibrated on validation clips.

    python -m evaluation.calibration --weights runs/contact/posterior.pt --output runs/contact/uncalibrated.onnx
    python -m evaluation.calibration --model runs/contact/uncalibrated.onnx --output models/weights/contact.onnx \
        --validation runs/contact/validation runs/contact/fine --pressed runs/contact/pressed \
        [--between runs/contact/between]

The first exports what `estimators.network.training` wrote. The second calibrates any exported posterior, also one that
`train.py export` wrote, by results of the benchmark with that file.

Errors are taken to have standard deviations scale · sd^power · σ^noise · (k_d/√k_s)^damping, with sd the network's own,
σ the observation's as it is told it, and the damping ratio as it estimates it, and a factor that is quadratic in log σ
(`models.calibration.Widths`); the coefficients are the likeliest ones for normal errors, the
scale is then set so that the 90 % intervals hold the truth in 90 % of the validation results (conformal prediction,
Vovk's quantile, with a normalised score). Both come from the same results and several suites observe the same clips, so
the guarantee is not exact. It is done once for whole contacts, once for those whose release has not been seen
(--pressed), and for a network that is told how well the instants are known, once for those whose aren't (--between).
Truth of validation clips serves this and nothing else; no weight of the network changes.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize

from data.command_line import path_option
from data.contact.features import FEATURES, FRAME_RATE, KNOWN, LOADED, LOG_NOISE, REFERENCE_SPACING, SLOTS
from data.contact.film_features import FILM_FEATURES, WITHIN
from data.contact.interaction import PRESS
from data.masks.sources import MaskClasses
from data.settings import PREPROCESSING_VERSION
from data.source.layout import read_mapping
from estimators.estimate import NINETY
from estimators.network.fits import BOUNDS, MECHANICS, SCENES
from estimators.onset import BETWEEN, STAMP
from evaluation.recovery.evaluate import OK, PREPARE, Recovery
from evaluation.recovery.store import RECORD, RESULTS, read_results
from models.calibration import LOG_DAMPING, Calibration, Widths
from models.checkpoint import load_posterior, posterior_features
from models.onnx_calibration import calibrate
from models.onnx_export import export
from models.onnx_session import CONTACT, PosteriorModel
from models.posterior import ContactPosterior
from results.record import sha256_of

LEVEL = 0.9
"""Share of truths that the calibrated intervals hold."""
LEAST_SPREAD = 0.1
"""Of a column of logarithms that can have a coefficient; the noise of one suite has none."""
MIDDLE = 0.05, 0.95
"""Quantiles of log σ between which widths may bend."""
LEAST_CLIPS = 100
"""Fewer validation estimates say too little about a 90 % quantile."""


def fit_widths_of(rows: Sequence[Recovery]) -> Widths:
    """What makes the 90 % intervals hold 90 % of the truths, narrow ones as often as wide ones, all suites together.

    Raises:
        ValueError: too few results.
    """
    rows = [row for row in rows if row.estimator == "network" and row.status == OK and row.covariance is not None]
    if len(rows) < LEAST_CLIPS:
        raise ValueError(f"{len(rows)} validation estimates; calibration needs {LEAST_CLIPS} or more.")
    estimates, truths = (np.log(np.abs([getattr(row, name) for row in rows])) for name in ("estimate", "theta"))
    deviations = np.sqrt(np.diagonal([row.covariance for row in rows], axis1=1, axis2=2))
    noise = np.log([row.noise / REFERENCE_SPACING for row in rows])
    lowest, highest = (float(end) for end in np.quantile(noise, MIDDLE))
    distance = np.clip(noise, lowest, highest) - (lowest + highest) / 2
    found = []
    for error, deviation in zip((estimates - truths).T, deviations.T, strict=True):
        known = np.stack([np.log(deviation), noise, estimates @ LOG_DAMPING, distance**2], axis=1)
        exponents = fit_exponents(error, known)
        found.append((conformal_scale(error, np.exp(known @ exponents)), *exponents))
    columns = (tuple(map(float, values)) for values in zip(*found, strict=True))
    return Widths(*columns, middle_range=(lowest, highest))  # ty: ignore[invalid-argument-type]  three each


def fit_exponents(errors: np.ndarray, known: np.ndarray) -> np.ndarray:
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


def check_record(folder: Path, model_sha256: str, seen: str | None, onset: str = STAMP) -> None:
    """Refuse results that are of something else than what is to be calibrated.

    Args:
        folder: of the benchmark.
        model_sha256: of the file that is calibrated.
        seen: how much of the contacts must have been seen.
        onset: what the network must have been told of the instants.

    Raises:
        ValueError: no record, another split than validation, other frames, or another file.
    """
    record = read_mapping(folder / RECORD, "a record of the benchmark")
    for name, value in {"split": "validation", "seen": seen}.items():
        if record.get(name) != value:
            remedy = f"with --{name} {value}" if value else f"without --{name}"
            raise ValueError(f"{folder} has {name} {record.get(name)}; run the benchmark {remedy}.")
    network = record.get("estimator network")
    network = network if isinstance(network, dict) else {}
    made = network.get("onset", STAMP)
    if made != onset:
        raise ValueError(f"{folder} was made with --onset {made}; run the benchmark with --onset {onset}.")
    if network.get("model_sha256") != model_sha256:
        raise ValueError(f"{folder} is of another network than the one to calibrate; run the benchmark with that file.")


def results_of(folders: Sequence[Path], model_sha256: str, seen: str | None, onset: str = STAMP) -> list[Recovery]:
    """What some folders hold, refused as by `check_record`."""
    for folder in folders:
        check_record(folder, model_sha256, seen, onset)
    return [row for folder in folders for row in read_results(folder / RESULTS)]


def metadata(weights: Path, features: int) -> dict[str, object]:
    """What inference needs beside the network: how clips are prepared, the simulator and the admissible box.

    Args:
        weights: of the network.
        features: length of the vector that it is told.
    """
    geometry = dataclasses.asdict(PREPARE.geometry)
    depth = dataclasses.asdict(PREPARE.depth) | {"source": "auto"}
    pressed = [round(seconds * SCENES.fps) / SCENES.fps for seconds in SCENES.press_seconds]
    return {
        "input": {"window": 1, "height": geometry["height"], "width": geometry["width"]},
        "contact": {"features": features, "slots": SLOTS, "frame_rate": FRAME_RATE, "press_seconds": pressed},
        "observation": "trajectory",
        "preprocessing_version": PREPROCESSING_VERSION,
        "bounds": dataclasses.asdict(BOUNDS),
        "mechanics": dataclasses.asdict(MECHANICS),
        "geometry": geometry,
        "depth": depth,
        "masks": "auto",
        "classes": dataclasses.asdict(MaskClasses()),
        "training": {
            "motions": "simulated contacts (estimators.network.training)",
            "weights_sha256": sha256_of(weights),
        },
    }


def calibration_of(options: argparse.Namespace) -> Calibration:
    """What the results of the benchmark say.

    Raises:
        ModelFileError: the file is no exported posterior.
        ValueError: results of something else, or too few.
    """
    model = PosteriorModel(options.model)
    whole = fit_widths_of(results_of(options.validation, model.sha256, None))
    pressed = fit_widths_of(results_of(options.pressed, model.sha256, PRESS))
    found = Calibration(
        whole=whole, pressed=pressed, noise_features=LOG_NOISE, known_features=KNOWN, loaded_features=LOADED
    )
    if options.between is None:
        return found
    if model.inputs[CONTACT] != (FEATURES + FILM_FEATURES,):
        raise ValueError(f"{options.model} is told nothing of the instants; leave --between out.")
    between = fit_widths_of(results_of(options.between, model.sha256, None, BETWEEN))
    return dataclasses.replace(found, between=between, within_features=(FEATURES + WITHIN,))


def main(arguments: list[str] | None = None) -> int:
    """Export or calibrate; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.calibration", description=__doc__.split("\n")[0])
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--weights", type=path_option, help="posterior.pt of estimators.network.training, to export")
    source.add_argument("--model", type=path_option, metavar="FILE", help="exported posterior, to calibrate")
    parser.add_argument("--output", type=path_option, required=True, help="ONNX file to write")
    text = "results of evaluation.benchmark --split validation with that file"
    for name, more in (
        ("--validation", ""),
        ("--pressed", f" --seen {PRESS}"),
        ("--between", " --suite late-onset --onset between"),
    ):
        parser.add_argument(name, type=path_option, nargs="+", metavar="DIR", help=text + more)
    options = parser.parse_args(arguments)
    results = options.validation, options.pressed
    if options.model is not None and None in results:
        parser.error("give --validation and --pressed beside --model.")
    if options.weights is not None and (*results, options.between) != (None, None, None):
        parser.error("give --model beside results; --weights are exported as they are.")
    try:
        if options.model is not None:
            calibration = calibration_of(options)
            difference = calibrate(options.model, options.output, calibration)
        else:
            calibration, features = None, posterior_features(options.weights)
            posterior = ContactPosterior(features, torch.tensor(BOUNDS.log_box))
            load_posterior(posterior, options.weights)
            difference = export(posterior, options.output, metadata(options.weights, features))
    except (OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{options.output}: written; largest difference from torch {difference:.1e}")
    for name in ("whole", "pressed", "between") if calibration is not None else ():
        for field, values in dataclasses.asdict(getattr(calibration, name)).items():
            print(f"  {name} {field}: {np.round(values, 3).tolist()}")
    return 0


if __name__ == "__main__":
    run_door(main)
