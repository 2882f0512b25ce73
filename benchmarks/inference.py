"""Where the time of inference goes: the networks alone, one contact, and every stage of `infer.py` a frame.

    python -m benchmarks.inference

The networks are exported with random weights, which cost what trained ones do. Bini 2026, section 4.3, has 1.67 ms for
encoder and head and 921 ms for the depth network, on a GPU; here all runs on the CPU. The clip is synthetic, as frames
with stored depth and annotated masks, and as a video without either (photometric depth, automatic masks). A contact is
one call of the network that ships, with what it is given and how well the simulator explains the motion, on one thread.
Last come plain videos of ten seconds with one press, from their first frame to finished results with the overlay.
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

from palpate.command.infer import main as infer
from palpate.common.command_line import described_parser
from palpate.common.tables import to_markdown
from palpate.data.contact.features import FEATURES
from palpate.data.synthetic.__main__ import main as make_clips
from palpate.data.synthetic.clip import draw_press, synthetic_clip, write_clip
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.estimators.contract import ClipInfo
from palpate.estimators.network.estimator import FULL, RATES, NetworkEstimator
from palpate.estimators.onset import ONSETS
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.evaluation.plain_video import HEIGHTS, PlainVideo
from palpate.evaluation.recovery.suites import GRID_SIZE, SUITES, suite_clip_seed
from palpate.evaluation.recovery.trial import observed_contacts
from palpate.models.generator import Generator
from palpate.models.onnx_export import export
from palpate.models.onnx_session import ParameterModel, PosteriorModel, open_model
from palpate.physics.mechanics import RECOMMENDED

Result = TypeVar("Result")

SIZE = 120, 214
"""Height and width of the networks' input."""
RUNS, FRAMES = 20, 32
NETWORKS: dict[str, dict[str, Any]] = {
    "paper.yaml": {"channels": 1},
    "recommended.yaml": {"channels": 8, "head": "posterior", "contact_features": FEATURES, "bounds": RECOMMENDED},
}
"""What differs from the generator's defaults."""
VIDEO_FRAMES, VIDEO_SEED = 250, 55
ESTIMATORS = ("network", "direct")
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
    window = generator.random((1, model.window, *SIZE), dtype=np.float32)
    if isinstance(model, PosteriorModel):
        contact = np.zeros((1, FEATURES), np.float32)
        return float(np.median([timed(model, contact, window)[1] for _ in range(RUNS)]))
    assert isinstance(model, ParameterModel)
    return float(np.median([timed(model, window)[1] for _ in range(RUNS)]))


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
        scene, motion = draw_press(SUITES["clean"].settings(index, size), suite_clip_seed("validation", 0, index))
        clip = open_synthetic(synthetic_clip(scene, motion, index), PREPARE)
        frames, info = list(clip), ClipInfo.of(clip)
        contact = estimator.as_trained(observed_contacts(frames, info)[motion.onset_frame])
        sessions = [estimator.start(info) for _ in range(RUNS)]
        whole = np.median([timed(session.estimate, contact, None)[1] for session in sessions])
        found.append((whole, 1e3 * np.median([session.seconds["network"] for session in sessions])))
    median = np.median(found, axis=0)
    return float(median[0]), float(median[1]), float(np.max(found, axis=0)[0])


def stages(clip: Path, output: Path, estimator: str, frames: int = FRAMES, rate: str = FULL) -> dict[str, float]:
    """Time by stage of `infer.py` on a clip, whose results go to `output` [ms a frame]; stages overlap.

    Raises:
        RuntimeError: it failed.
    """
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        status = infer([str(clip), "--estimator", estimator, "--rate", rate, "--output", str(output)])
    if status != 0:
        raise RuntimeError(f"infer.py ended with status {status} on {clip}.")
    record = json.loads(next(output.rglob("run.json")).read_text(encoding="utf-8"))
    return {stage: 1e3 * seconds / frames for stage, seconds in record["timings_s"].items()}


def plain_video(width: int, folder: Path) -> list[dict[str, float]]:
    """`stages` of the network on a video of VIDEO_FRAMES frames of a width [px], at each of RATES; all in a folder."""
    drawn = PlainVideo(folder, look="endoscope", width=width)  # ty: ignore[invalid-argument-type]  one of HEIGHTS
    settings = dataclasses.replace(drawn.settings, frames=VIDEO_FRAMES)
    video = write_clip(folder / f"{width}", 1, settings, VIDEO_SEED).with_suffix(".mp4")
    return [stages(video, folder / f"{rate}{width}", "network", VIDEO_FRAMES, rate) for rate in RATES]


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
    print(to_markdown(columns, rows), end="\n\n")
    make_clips(["--output", str(folder / "clips"), "--clips", "1", "--frames", str(FRAMES), "--seed", "1"])
    frames = next(path.parent for path in (folder / "clips").rglob("clip.json"))
    found = {
        (source, estimator): stages(path, folder / "results" / source / estimator, estimator)
        for source, path in (("frames", frames), ("video", frames.with_name(f"{frames.name}.mp4")))
        for estimator in ESTIMATORS
    }
    names = list(dict.fromkeys(stage for times in found.values() for stage in times))
    print(f"\nStages of infer.py on frames of 854x480, {title}\n")
    rows = ((*key, *(f"{times[name]:.1f}" if name in times else "" for name in names)) for key, times in found.items())
    print(to_markdown(("source", "estimator", *names), rows))
    print(f"\nPlain video, {VIDEO_FRAMES} frames, one press, the network that ships ({machine})\n")
    columns = ("pictures", *(f"--rate {rate}: frames a second" for rate in RATES))
    whole = ((f"{width}x{height}", plain_video(width, folder)) for width, height in HEIGHTS.items())
    rows = ((size, *(f"{1e3 / times['total']:.1f}" for times in rates)) for size, rates in whole)
    print(to_markdown(columns, rows))


if __name__ == "__main__":
    run_door(main)
