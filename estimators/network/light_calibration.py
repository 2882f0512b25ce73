"""Adds the posterior of brightness sequences to an exported contact posterior, calibrates it, makes it one graph.

    python -m estimators.network.light_calibration --model contact.onnx --light runs/light/light.pt --output plain.onnx
    python -m estimators.network.light_calibration --model plain.onnx --results runs/light/video … --output contact.onnx
    python -m estimators.network.light_calibration --model contact.onnx --one-graph --output press.onnx

The first adds what `train.py fit -c configs/light.yaml` wrote to a file of `estimators.network.calibration`. The second
calibrates such a file by results of `benchmarks.plain_video --estimator network` with it: what the drawn sequences
don't have (coders, cameras, other laws of light) shifts its means and widens its covariances, by as much as on
validation videos. Their truth is used for this and nothing else; no weight of the network changes. The third writes
what `estimators.network.causal_graph` makes of a file that ships: presses by their light, frame by frame, for programs
that have ONNX Runtime and no Python (docs/training.md).
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.common.command_line import add_listed, path_option
from palpate.common.files import file_sha256, read_beside
from palpate.data.source.layout import read_mapping
from palpate.estimators.network.calibration import RECORD, rows_in
from palpate.estimators.network.causal_graph import write_causal
from palpate.estimators.network.light_training import new_light_posterior
from palpate.models.calibration import LightCalibration
from palpate.models.calibration_fit import fit_light
from palpate.models.checkpoint import load_posterior
from palpate.models.onnx_export import add_light, calibrate_light

QUANTITIES = "stiffness", "damping_over_stiffness", "force_over_stiffness"
"""Those whose errors are counted."""


def calibration_of(model: Path, folders: Sequence[Path]) -> LightCalibration:
    """Calibration from results of plain videos.

    Args:
        model: the file with which they were made.
        folders: output folders of `benchmarks.plain_video`.

    Raises:
        ValueError: results of another file, none that can be read, or too few.
    """
    digest = file_sha256(model)
    for folder in folders:
        if read_mapping(folder / RECORD, "a record of an evaluation").get("model_sha256") != digest:
            raise ValueError(f"{folder} was not made with {model}; run benchmarks.plain_video with that file.")
    known = [row for row in rows_in(folders) if row.get("explained")]
    errors, sds = (
        np.array([[row[f"{name}_{end}"] for name in QUANTITIES] for row in known]).reshape(-1, len(QUANTITIES))
        for end in ("error", "sd")
    )
    return fit_light(errors, np.square(sds))


def main(arguments: list[str] | None = None) -> int:
    """Add, calibrate or write the graph; returns the exit status."""
    program, text = "python -m estimators.network.light_calibration", __doc__.split("\n")[0]
    parser = argparse.ArgumentParser(prog=program, description=text)
    listed = read_beside(__file__)
    add_listed(parser, listed["options"], {"path": path_option})
    add_listed(parser.add_mutually_exclusive_group(required=True), listed["what"], {"path": path_option})
    options = parser.parse_args(arguments)
    try:
        if options.light is not None:
            posterior = new_light_posterior()
            load_posterior(posterior, options.light)
            difference = add_light(options.model, options.output, posterior, file_sha256(options.light))
        elif options.one_graph:
            difference = write_causal(options.model, options.output)
        else:
            found = calibration_of(options.model, options.results)
            difference = calibrate_light(options.model, options.output, found)
            for name, values in dataclasses.asdict(found).items():
                print(f"  {name}: {np.round(values, 3).tolist()}")
    except (OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{options.output}: written; largest difference from what it should be {difference:.1e}")
    return 0


if __name__ == "__main__":
    run_door(main)
