"""What inference takes: the networks alone, one contact, and plain videos from end to end.

    python -m benchmarks.inference

The networks are exported with random weights, which cost what trained ones do. Bini 2026, section 4.3, has 1.67 ms for
encoder and head and 921 ms for the depth network, on a GPU; here all runs on the CPU. A contact is one call of the
network that ships, with what it is given and how well the simulator explains the motion, on one thread. Last come plain
videos of ten seconds with one press, from their first frame to finished results with the overlay; of any clip,
`timings_s` of its `run.json` says where the time went.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import dataclasses
import itertools
import json
import os
import platform
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from datetime import date
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
import torch

from benchmarks.plain_video import HEIGHTS, PlainVideo
from benchmarks.recovery.suites import GRID_SIZE, SUITES, suite_clip_seed
from benchmarks.recovery.trial import observed_contacts
from palpate.command.infer import main as infer
from palpate.common.command_line import described_parser
from palpate.common.tables import to_markdown
from palpate.data.contact.features import FEATURES
from palpate.data.synthetic.clip import draw_truth, synthetic_clip, write_clip
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.estimators.contract import ClipInfo
from palpate.estimators.network.estimator import RATES, NetworkEstimator
from palpate.estimators.onset import ONSETS
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.models.generator import Generator
from palpate.models.onnx_export import export
from palpate.models.onnx_session import open_model
from palpate.physics.mechanics import RECOMMENDED

Result = TypeVar("Result")

SIZE = 120, 214
"""Height and width of the networks' input."""
RUNS = 20
NETWORKS: dict[str, dict[str, Any]] = {
    "paper.yaml": {"channels": 1},
    "recommended.yaml": {"channels": 8, "head": "posterior", "contact_features": FEATURES, "bounds": RECOMMENDED},
}
"""What differs from the generator's defaults."""
VIDEO_FRAMES, VIDEO_SEED = 250, 55
CONTACTS = 9
"""Contacts that are timed, a third of them in each regime."""
SIZES = (GRID_SIZE, (854, 480))
"""Width and height of their pictures [px]."""


def timed(work: Callable[..., Result], *arguments: object) -> tuple[Result, float]:
    """What a call returns, and how long it took [ms]."""
    start = time.perf_counter()
    result = work(*arguments)
    return result, 1e3 * (time.perf_counter() - start)


def exported(name: str, folder: Path) -> Path:
    """Write the ONNX file of a configuration's encoder and head, with random weights, into a folder."""
    settings = NETWORKS[name]
    torch.manual_seed(0)
    file = folder / f"{Path(name).stem}.onnx"
    size = {"window": settings["channels"], "height": SIZE[0], "width": SIZE[1]}
    export(Generator(**settings), file, {"input": size})
    return file


def encoder_and_head(file: Path, threads: int | None) -> float:
    """Median time of one frame [ms]."""
    model, generator = open_model(file, threads), np.random.default_rng(0)
    given = {name: generator.random((1, *shape), dtype=np.float32) for name, shape in model.inputs.items()}
    return float(np.median([timed(model.run, given)[1] for _ in range(RUNS)]))


def one_contact(size: tuple[int, int], onset: str) -> tuple[float, float, float]:
    """Times of a contact observed whole [ms]: median of all, of it the vector and the network, and the longest of all.

    Args:
        size: width and height of the pictures [px].
        onset: one of `estimators.onset.ONSETS`.
    """
    estimator = open_estimator(EstimatorOptions(onset=onset, threads=1))
    assert isinstance(estimator, NetworkEstimator)
    found = []
    for index in range(CONTACTS):
        scene, motion = draw_truth(SUITES["clean"].settings(index, size), suite_clip_seed("validation", 0, index))
        clip = open_synthetic(synthetic_clip(scene, motion, index), PREPARE)
        frames, info = list(clip), ClipInfo.of(clip)
        contact = estimator.as_trained(observed_contacts(frames, info)[motion.onset_frame])
        sessions = [estimator.start(info) for _ in range(RUNS)]
        whole = np.median([timed(session.estimate, contact, None)[1] for session in sessions])
        found.append((whole, 1e3 * np.median([session.seconds["network"] for session in sessions])))
    median = np.median(found, axis=0)
    return float(median[0]), float(median[1]), float(np.max(found, axis=0)[0])


def frames_a_second(video: Path, output: Path, rate: str) -> float:
    """How many frames of a video of VIDEO_FRAMES `infer.py` finishes a second at a rate; results go to `output`.

    Raises:
        RuntimeError: it failed.
    """
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        status = infer([str(video), "--estimator", "network", "--rate", rate, "--output", str(output)])
    if status != 0:
        raise RuntimeError(f"infer.py ended with status {status} on {video}.")
    record = json.loads(next(output.rglob("run.json")).read_text(encoding="utf-8"))
    return VIDEO_FRAMES / record["timings_s"]["total"]


def plain_video(width: int, folder: Path) -> list[float]:
    """`frames_a_second` of a drawn video of a width [px], at each of RATES; all in a folder."""
    drawn = PlainVideo(folder, look="endoscope", width=width)  # ty: ignore[invalid-argument-type]  one of HEIGHTS
    settings = dataclasses.replace(drawn.settings, frames=VIDEO_FRAMES)
    video = write_clip(folder / f"{width}", 1, settings, VIDEO_SEED).with_suffix(".mp4")
    return [frames_a_second(video, folder / f"{rate}{width}", rate) for rate in RATES]


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; returns the exit status."""
    described_parser("python -m benchmarks.inference", __doc__, "0 done; 1 failed; 2 wrong usage").parse_args(arguments)
    with TemporaryDirectory() as folder:
        _measure(Path(folder))
    return 0


def _measure(folder: Path) -> None:
    machine = f"{os.cpu_count()} cores {platform.machine()}, {date.today()}"
    title = f"ms a frame ({machine}; the paper: 1.67 for encoder and head, 921 for depth, on a GPU)"
    print(f"Encoder and head, {SIZE[1]}x{SIZE[0]}, {title}\n")
    files = {name: exported(name, folder) for name in NETWORKS}
    rows = ([name, *(f"{encoder_and_head(file, each):.1f}" for each in (1, None))] for name, file in files.items())
    print(to_markdown(("configuration", "1 thread", "all threads"), rows))
    print("\nOne contact by the network that ships, 1 thread [ms]\n")
    columns = ("pictures", "--onset", "median", "of it vector and network", "longest")
    cases = itertools.product(SIZES, ONSETS)
    rows = ((f"{size}", onset, *(f"{t:.1f}" for t in one_contact(size, onset))) for size, onset in cases)
    print(to_markdown(columns, rows))
    print(f"\nPlain video, {VIDEO_FRAMES} frames, one press, the network that ships ({machine})\n")
    columns = ("pictures", *(f"--rate {rate}: frames a second" for rate in RATES))
    whole = ((f"{width}x{height}", plain_video(width, folder)) for width, height in HEIGHTS.items())
    rows = ((size, *(f"{rate:.1f}" for rate in rates)) for size, rates in whole)
    print(to_markdown(columns, rows))


if __name__ == "__main__":
    run_door(main)
