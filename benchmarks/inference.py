"""Time of inference: the networks alone, and whole videos with wall clock, processor time by stage and peak memory.

    python -m benchmarks.inference --against HEAD~1

The networks are exported with random weights, which cost as much as trained ones. Bini 2026, section 4.3, has 1.67 ms
for encoder and head and 921 ms for the depth network on a GPU. Here all runs on the CPU. The synthetic videos last ten
seconds, with an instrument in view in all frames: a press, then a pull, before a camera that turns slightly.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import json
import os
import platform
import subprocess
import sys
import timeit
from collections.abc import Generator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pandas as pd
import torch

from benchmarks.harness import show
from palpate.common.options import option, options
from palpate.data.contact.features import FEATURES
from palpate.data.source.video import Video
from palpate.data.synthetic.clip import draw_truth, observe
from palpate.data.synthetic.settings import SceneSettings
from palpate.models.generator import Generator as Network
from palpate.models.onnx_export import export
from palpate.models.onnx_session import open_model
from palpate.physics.mechanics import RECOMMENDED

ROOT = Path(__file__).resolve().parents[1]
SIZE = 120, 214
"""Height and width of the networks' input."""
NETWORKS: dict[str, dict[str, Any]] = {
    "paper.yaml": {"channels": 1},
    "recommended.yaml": {"channels": 8, "head": "posterior", "contact_features": FEATURES, "bounds": RECOMMENDED},
}
"""Differences from the generator's defaults."""


@dataclass(frozen=True)
class Timings:
    """Videos and networks to time."""

    videos: tuple[Path, ...] = option((), positional=True, metavar="VIDEO")
    """videos in place of the synthetic ones and the networks"""
    against: str | None = option(None, metavar="REVISION")
    """another commit that takes turns with this checkout"""


def exported(name: str, folder: Path) -> Path:
    """Write the ONNX file of a configuration's encoder and head, with random weights, into a folder."""
    settings = NETWORKS[name]
    torch.manual_seed(0)
    file = folder / f"{Path(name).stem}.onnx"
    size = {"window": settings["channels"], "height": SIZE[0], "width": SIZE[1]}
    export(Network(**settings), file, {"input": size})
    return file


def encoder_and_head(file: Path, threads: int | None) -> float:
    """Median time of one frame [ms]."""
    model, generator = open_model(file, threads), np.random.default_rng(0)
    given = {name: generator.random((1, *shape), dtype=np.float32) for name, shape in model.inputs.items()}
    return 1e3 * float(np.median(timeit.repeat(lambda: model.run(given), number=1, repeat=20)))


def synthetic_videos(folder: Path) -> list[Path]:
    """Write a press and then a pull as a video of each of two sizes, the first as it is drawn, into a folder."""
    sizes, seed = ((854, 480), (1280, 720)), 55
    press = SceneSettings(frames=75, onset_fraction=(0.2, 0.2), press_seconds=(2.0, 2.0), profile="hold")
    pull = SceneSettings(frames=175, onset_fraction=(0.1, 0.1), action="grip")
    files = [folder / "{}x{}.mp4".format(*size) for size in sizes]
    with ExitStack() as stack:
        videos = [stack.enter_context(closing(Video(*given, 25, crf=18))) for given in zip(files, sizes, strict=True)]
        for scene in (press, pull):
            for image, *_ in observe(*draw_truth(replace(scene, turning_deg=0.5), seed), seed):
                for video, size in zip(videos, sizes, strict=True):
                    video.write(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC))
    return files


def timed(root: Path, video: Path, output: Path) -> dict[str, Any]:
    """Run `infer.py` of a checkout; return its total time, and then the seconds of its stages.

    Raises:
        RuntimeError: it failed.
    """
    program = [sys.executable, str(root / "infer.py"), str(video), "--output", str(output), "--overwrite"]
    silent = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    _, status, used = os.wait4(os.posix_spawn(sys.executable, program, os.environ, file_actions=silent), 0)
    if status != 0:
        raise RuntimeError(f"infer.py ended with status {os.waitstatus_to_exitcode(status)} on {video}.")
    record = json.loads(next(output.rglob("run.json")).read_text(encoding="utf-8"))
    seconds = record["timings_s"]
    rate, processor = record["input"]["frames"] / seconds.pop("total"), used.ru_utime + used.ru_stime
    return {"frames/s": rate, "processor [s]": processor, "peak memory [MB]": used.ru_maxrss / 1024} | seconds


@contextmanager
def checkout(revision: str) -> Generator[Path]:
    """A commit's files in a temporary folder."""
    with TemporaryDirectory() as folder:
        worktree = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*worktree, "add", "--quiet", "--detach", folder, revision], check=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run([*worktree, "remove", "--force", folder], check=True)


def compared(video: Path, against: str | None, folder: Path) -> pd.DataFrame:
    """Table of what a video takes here and, turn by turn, in another commit, with their ratio."""
    with ExitStack() as stack:
        roots = {"here": ROOT}
        if against is not None:
            roots[against] = stack.enter_context(checkout(against))
        for _ in range(2):  # the first turn compiles
            found = {name: timed(root, video, folder / video.stem / root.name) for name, root in roots.items()}
    frame = pd.DataFrame(found).rename_axis(video.stem).reset_index()
    return frame if against is None else frame.assign(ratio=frame["here"] / frame[against])


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; returns the exit status."""
    asked: Timings = options(Timings, arguments, "benchmarks.inference", __doc__)
    machine = f"{os.cpu_count()} cores {platform.machine()}, {date.today()}"
    with TemporaryDirectory() as name:
        folder, videos = Path(name), asked.videos
        if not videos:
            title = f"ms a frame ({machine}; the paper: 1.67 for encoder and head, 921 for depth, on a GPU)"
            print(f"Encoder and head, {SIZE[1]}x{SIZE[0]}, {title}\n")
            files = {name: exported(name, folder) for name in NETWORKS}
            rows = [(name, *(encoder_and_head(file, threads) for threads in (1, None))) for name, file in files.items()]
            show(pd.DataFrame(rows, columns=("configuration", "1 thread", "all threads")))
            videos = synthetic_videos(folder)
        print(f"\nVideos, and the seconds of their stages, which overlap ({machine})\n")
        for video in videos:
            show(compared(video, asked.against, folder))
    return 0


if __name__ == "__main__":
    run_door(main)
