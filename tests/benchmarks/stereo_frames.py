"""What a frame of `--depth stereo` takes at 740×540, the reading of its right picture included.

    python -m tests.benchmarks.stereo_frames

Pairs of a curved surface are drawn and stored as JPEG. Next to it stand the reading of a right picture alone, and
OpenCV's semi-global matching of the same pair at full size, over the same disparities and without any check.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import os
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import cv2
import numpy as np
import yaml

from palpate.common.options import options, require_within
from palpate.common.tables import to_markdown
from palpate.data.depth.stereo import BLOCK
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout
from tests.data.depth.test_stereo import BASELINE, CURVED, FOCAL, LEFT, opened, pair

DRAWN = 8
"""Pairs that differ; they are gone through again and again."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    frames: int = 48
    """That are timed."""

    def __post_init__(self) -> None:
        require_within(self, frames=(1, 10_000))


def milliseconds(work: Callable[..., object], *arguments: object) -> float:
    """How long a call takes [ms]."""
    begun = time.perf_counter()
    work(*arguments)
    return 1e3 * (time.perf_counter() - begun)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    chosen, spent = options(Options, arguments, "tests.benchmarks.stereo_frames", __doc__), []
    with tempfile.TemporaryDirectory() as name:
        clip = Path(name) / "clip"
        for seed in range(DRAWN):
            for side, picture in zip(("left", "right"), pair(CURVED, seed), strict=True):
                (clip / side).mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(clip / side / f"{seed}.jpg"), picture)
        (clip / "camera.yaml").write_text(yaml.safe_dump(LEFT | {"baseline": BASELINE}))
        depth, source, _ = opened(
            clip, ClipLayout("left/{number}.jpg", right="right/{number}.jpg", camera="camera.yaml")
        )
        frames = list(source)
        rights = [clip / "right" / f"{frame.number}.jpg" for frame in frames]
        pairs = [(frame.picture, read_image(right)) for frame, right in zip(frames, rights, strict=True)]
        grey = [[cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in both] for both in pairs]
        most = 16 * int(np.ceil(FOCAL * BASELINE / CURVED.min() / 16))
        matcher = cv2.StereoSGBM.create(0, most, BLOCK, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
        for index in range(chosen.frames):
            at = index % DRAWN
            spent.append(
                (
                    milliseconds(depth, frames[at]),
                    milliseconds(read_image, rights[at]),
                    milliseconds(matcher.compute, *grey[at]),
                )
            )
    fastest, median = np.min(spent, axis=0), np.median(spent, axis=0)
    names = "a frame of --depth stereo", "reading its right picture alone", "OpenCV's matching at full size"
    rows = [(n, f"{a:.1f}", f"{b:.1f}", f"{b / median[0]:.2f}") for n, a, b in zip(names, fastest, median, strict=True)]
    size = "x".join(map(str, CURVED.shape[::-1]))
    print(f"{size}, {chosen.frames} frames [ms] ({os.cpu_count()} cores {platform.machine()}, {date.today()})\n")
    print(to_markdown(("", "fastest", "median", "over a frame's median"), rows))
    return 0


if __name__ == "__main__":
    run_door(main)
