"""Export of a trained contact posterior for `infer.py`, and calibration of its intervals on validation clips.

    python -m palpate.estimators.network.calibration --weights runs/contact/posterior.pt \
        --output runs/contact/uncalibrated.onnx
    python -m palpate.estimators.network.calibration --model runs/contact/uncalibrated.onnx \
        --output models/weights/contact.onnx --validation runs/contact/validation runs/contact/fine \
        --pressed runs/contact/pressed --between runs/contact/between

The first exports the posterior that `train.py fit -c configs/contact.yaml` wrote. The second calibrates any exported
posterior, also one that `train.py export` wrote, by results of the benchmark with that file.

`models.calibration_fit` fits the widths once for whole contacts, once for contacts before their release (--pressed),
and once for unknown instants (--between). The truth
of validation clips is used for this and nothing else; no weight of the network changes.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from palpate.common.files import file_sha256, read_file
from palpate.common.options import options
from palpate.data.contact.features import FEATURES, FRAME_RATE, KNOWN, LOADED, LOG_NOISE, REFERENCE_SPACING, SLOTS
from palpate.data.contact.interaction import PRESS
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES, WITHIN
from palpate.data.masks.request import MaskClasses
from palpate.data.settings import PREPROCESSING_VERSION
from palpate.data.source.layout import read_mapping
from palpate.data.synthetic.source import PREPARE
from palpate.estimators.network.fits import MECHANICS, SCENES
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.models.calibration import Calibration, Widths
from palpate.models.calibration_fit import fit_widths
from palpate.models.checkpoint import load_posterior
from palpate.models.onnx_export import calibrate, export
from palpate.models.onnx_session import PosteriorModel
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import RECOMMENDED


def widths_of(rows: Sequence[Mapping[str, Any]]) -> Widths:
    """Return widths with which the network's intervals have the right coverage, over all suites together.

    Args:
        rows: results of `benchmarks.recovery`.

    Raises:
        ValueError: too few results.
    """
    rows = [row for row in rows if (row["estimator"], row["status"]) == ("network", "ok")]
    rows = [row for row in rows if row.get("covariance") is not None]
    estimates, truths = (np.log(np.abs([row[name] for row in rows])).reshape(-1, 3) for name in ("estimate", "theta"))
    covariances = np.array([row["covariance"] for row in rows]).reshape(-1, 3, 3)
    deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    return fit_widths(estimates, truths, deviations, np.log([row["noise"] / REFERENCE_SPACING for row in rows]))


def check_record(folder: Path, model_sha256: str, seen: str | None, onset: str = STAMP) -> None:
    """Refuse results that don't belong to the calibration.

    Args:
        folder: output folder of the benchmark.
        model_sha256: hash of the file that is calibrated.
        seen: required value of the benchmark's option --seen.
        onset: required value of the benchmark's option --onset.

    Raises:
        ValueError: no record, another split than validation, other frames, or another file.
    """
    record = read_mapping(folder / "run.json", "a record of the benchmark")
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


def results_of(folders: Sequence[Path], model_sha256: str, seen: str | None, onset: str = STAMP) -> list[dict]:
    """Return results in some folders, each checked by `check_record`, whose arguments these are.

    Raises:
        ValueError: as `check_record` does, or results can't be read.
    """
    rows = []
    for folder in folders:
        check_record(folder, model_sha256, seen, onset)
        results = folder / "results.jsonl"
        try:
            rows += map(json.loads, read_file(results, 2**27).splitlines())
        except (OSError, ValueError, RecursionError) as error:
            raise ValueError(f"{results} holds no results; run the evaluation into {folder} anew.") from error
    return rows


def metadata(weights: Path) -> dict[str, object]:
    """Return the metadata for inference: how clips are prepared, the simulator and the admissible box.

    Args:
        weights: file of the network's weights.
    """
    settings = {"bounds": RECOMMENDED, "mechanics": MECHANICS, "geometry": PREPARE.geometry, "classes": MaskClasses()}
    pressed = [round(seconds * SCENES.fps) / SCENES.fps for seconds in SCENES.press_seconds]
    contact = {"features": FEATURES + SEQUENCE_FEATURES, "slots": SLOTS, "frame_rate": FRAME_RATE}
    motions = "simulated contacts (palpate.estimators.network.training)"
    return {
        **{name: dataclasses.asdict(values) for name, values in settings.items()},
        "input": {"window": 1, "height": PREPARE.geometry.height, "width": PREPARE.geometry.width},
        "contact": contact | {"press_seconds": pressed},
        **{"observation": "trajectory", "preprocessing_version": PREPROCESSING_VERSION, "masks": "auto"},
        "depth": dataclasses.asdict(PREPARE.depth) | {"source": "auto"},
        "training": {"motions": motions, "weights_sha256": file_sha256(weights)},
    }


@dataclass(frozen=True)
class Calibrated:
    """Weights to export, or a model to calibrate."""

    output: Path
    """ONNX file to write"""
    weights: Path | None = None
    """posterior.pt of configs/contact.yaml, to export"""
    model: Path | None = None
    """exported posterior, to calibrate"""
    validation: tuple[Path, ...] = ()
    """results of benchmarks.recovery --split validation with that file"""
    pressed: tuple[Path, ...] = ()
    """results of benchmarks.recovery with --seen press"""
    between: tuple[Path, ...] = ()
    """results of benchmarks.recovery with --suite late-onset --onset between"""

    def __post_init__(self) -> None:
        """Raise a ValueError where options don't belong together."""
        results = self.validation, self.pressed, self.between
        whole = not any(results) if self.model is None else all(results)
        if (self.model is None) == (self.weights is None) or not whole:
            raise ValueError("give --weights alone, or --model with --validation, --pressed and --between.")


def calibration_of(asked: Any) -> Calibration:
    """Return the calibration from the results of the benchmark.

    Raises:
        ModelFileError: the file is no exported posterior.
        ValueError: the results belong to something else, or are too few.
    """
    model = PosteriorModel(asked.model)
    whole = widths_of(results_of(asked.validation, model.sha256, None))
    pressed = widths_of(results_of(asked.pressed, model.sha256, PRESS))
    between = widths_of(results_of(asked.between, model.sha256, None, BETWEEN))
    return Calibration(whole, pressed, between, LOG_NOISE, KNOWN, LOADED, (FEATURES + WITHIN,))


def main(arguments: list[str] | None = None) -> int:
    """Export or calibrate; returns the exit status."""
    asked: Any = options(Calibrated, arguments, "palpate.estimators.network.calibration", __doc__)
    try:
        if asked.model is not None:
            calibration = calibration_of(asked)
            difference = calibrate(asked.model, asked.output, calibration)
        else:
            calibration = None
            posterior = ContactPosterior(FEATURES + SEQUENCE_FEATURES, torch.tensor(RECOMMENDED.log_box))
            load_posterior(posterior, asked.weights)
            difference = export(posterior, asked.output, metadata(asked.weights))
    except (OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{asked.output}: written; largest difference from torch {difference:.1e}")
    for name in ("whole", "pressed", "between") if calibration is not None else ():
        for field, values in dataclasses.asdict(getattr(calibration, name)).items():
            print(f"  {name} {field}: {np.round(values, 3).tolist()}")
    return 0


if __name__ == "__main__":
    run_door(main)
