"""What inference takes: the networks alone, and plain videos from end to end.

    python -m benchmarks.inference

The networks are exported with random weights, which cost what trained ones do. Bini 2026, section 4.3, has 1.67 ms for
encoder and head and 921 ms for the depth network, on a GPU; here all runs on the CPU. Plain
videos of ten seconds with one press are timed from their first frame to finished results with the overlay; of any
clip, `timings_s` of its `run.json` says where the time went.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import json
import os
import platform
import timeit
from contextlib import redirect_stderr, redirect_stdout
from datetime import date
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import torch

from benchmarks.harness import show
from palpate.cli.infer import main as infer
from palpate.common.options import parse
from palpate.data.contact.features import FEATURES
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.models.generator import Generator
from palpate.models.onnx_export import export
from palpate.models.onnx_session import open_model
from palpate.physics.mechanics import RECOMMENDED

SIZE = 120, 214
"""Height and width of the networks' input."""
RUNS = 20
NETWORKS: dict[str, dict[str, Any]] = {
    "paper.yaml": {"channels": 1},
    "recommended.yaml": {"channels": 8, "head": "posterior", "contact_features": FEATURES, "bounds": RECOMMENDED},
}
"""What differs from the generator's defaults."""
HEIGHTS = {854: 480, 1280: 720}
"""Heights of pictures by their width [px]."""
VIDEO_FRAMES, VIDEO_SEED = 250, 55
RATES = ("full", "fast")
"""Values of --rate."""


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
    return 1e3 * float(np.median(timeit.repeat(lambda: model.run(given), number=1, repeat=RUNS)))


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
    settings = SceneSettings(width=width, height=HEIGHTS[width], frames=VIDEO_FRAMES)
    video = write_clip(folder / f"{width}", 1, settings, VIDEO_SEED).with_suffix(".mp4")
    return [frames_a_second(video, folder / f"{rate}{width}", rate) for rate in RATES]


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; returns the exit status."""
    parse((), arguments, "benchmarks.inference", __doc__)
    with TemporaryDirectory() as folder:
        _measure(Path(folder))
    return 0


def _measure(folder: Path) -> None:
    machine = f"{os.cpu_count()} cores {platform.machine()}, {date.today()}"
    title = f"ms a frame ({machine}; the paper: 1.67 for encoder and head, 921 for depth, on a GPU)"
    print(f"Encoder and head, {SIZE[1]}x{SIZE[0]}, {title}\n")
    files = {name: exported(name, folder) for name in NETWORKS}
    rows = ([name, *(f"{encoder_and_head(file, each):.1f}" for each in (1, None))] for name, file in files.items())
    show(pd.DataFrame(rows, columns=("configuration", "1 thread", "all threads")))
    print(f"\nPlain video, {VIDEO_FRAMES} frames, one press, the network that ships ({machine})\n")
    columns = ("pictures", *(f"--rate {rate}: frames a second" for rate in RATES))
    whole = ((f"{width}x{height}", plain_video(width, folder)) for width, height in HEIGHTS.items())
    rows = ((size, *(f"{rate:.1f}" for rate in rates)) for size, rates in whole)
    show(pd.DataFrame(rows, columns=columns))


if __name__ == "__main__":
    run_door(main)
