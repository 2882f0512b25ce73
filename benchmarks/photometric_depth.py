"""How good photometric depth is: against stored stereo depth and against synthetic truth, and what it costs.

`python -m benchmarks.photometric_depth [--sequence FOLDER]` prints the
tables of docs/depth.md. Nothing is fitted but one scale a clip.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from data.depth.normalise import DepthSettings, open_depth
from data.masks.sources import MaskClasses, open_masks
from data.source.frames import Frame, FrameSource, open_source
from data.source.layout import ClipLayout, load_layout
from data.synthetic.clip import clip_seed, write_clip
from data.synthetic.settings import SceneSettings

FAR_MULTIPLE = 3.0
"""Stored depth beyond this multiple of a frame's median is a mismatch of the stereo network, as in data.depth."""
TISSUE, TOOL = 1, 2
LAYOUT = Path("configs/layouts/recover_tissue.yaml")
CLIPS, FRAMES = 4, 20
"""Synthetic clips, and frames of each."""


@dataclass(frozen=True)
class Agreement:
    """Photometric depth of one clip against its stored depth."""

    rank: float
    """Spearman correlation within a frame, mean over the frames."""
    error: float
    """Median of |ratio/median ratio − 1| over the clip's pixels: what is left after one scale for the clip."""
    flicker: float
    """Standard deviation over the frames of log(median ratio of the frame)."""


def pairs(source: FrameSource, layout: ClipLayout, *, tissue_only: bool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Photometric and stored depth of the pixels that count, a frame at a time (every third row and column)."""
    stored = open_depth(DepthSettings(source="stored"), layout, source)
    photometric = open_depth(DepthSettings(source="photometric"), layout, source)
    masks = open_masks("annotation", layout, MaskClasses(), source.path)
    for frame in source:
        labels, truth, estimate = masks(frame), stored(frame), photometric(frame)
        counts = (labels == TISSUE) if tissue_only else (labels != TOOL)
        counts = counts & (truth > 0) & (estimate > 0)
        counts &= truth < FAR_MULTIPLE * np.median(truth[truth > 0])
        chosen = np.zeros_like(counts)
        chosen[::3, ::3] = counts[::3, ::3]
        yield estimate[chosen].astype(np.float64), truth[chosen].astype(np.float64)


def agreement(source: FrameSource, layout: ClipLayout, *, tissue_only: bool) -> Agreement:
    """Compare the two depths of one clip."""
    ranks, ratios = [], []
    for estimate, truth in pairs(source, layout, tissue_only=tissue_only):
        ranks.append(spearmanr(estimate, truth).statistic)
        ratios.append(estimate / truth)
    together = np.concatenate(ratios)
    error = np.median(np.abs(together / np.median(together) - 1))
    flicker = np.std([np.log(np.median(ratio)) for ratio in ratios])
    return Agreement(float(np.mean(ranks)), float(error), float(flicker))


def row(name: str, source: FrameSource, layout: ClipLayout) -> str:
    """One line of the table: tissue alone, then everything but the tool."""
    tissue, scene = (agreement(source, layout, tissue_only=only) for only in (True, False))
    return (
        f"| {name} | {source.length} | {tissue.rank:.2f} | {tissue.error:.1%} | {tissue.flicker:.2%} "
        f"| {scene.rank:.2f} | {scene.error:.1%} |"
    )


def milliseconds(threads: int, repeats: int = 40) -> float:
    """Median time of a 854x480 frame, preprocessing and enlarging included [ms]."""
    picture = np.random.default_rng(0).integers(30, 220, (480, 854, 3), np.uint8)
    frame = Frame(0, 0, 0.0, picture)
    source = _Still(picture)
    depth = open_depth(DepthSettings(source="photometric", threads=threads), ClipLayout(), source)
    times = []
    for _ in range(repeats + 3):
        started = time.perf_counter()
        depth(frame)
        times.append(time.perf_counter() - started)
    return 1000 * float(np.median(times[3:]))


class _Still(FrameSource):
    """A clip of one picture."""

    def __init__(self, picture: np.ndarray) -> None:
        self.name, self.path, self.fps, self.length, self.warnings = "still", Path("still"), 25.0, 1, []
        self.size, self._picture = (picture.shape[1], picture.shape[0]), picture

    def __iter__(self) -> Iterator[Frame]:
        yield Frame(0, 0, 0.0, self._picture)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.photometric_depth", description=main.__doc__)
    parser.add_argument("--sequence", type=Path, help=f"real clip with stored depth and masks as in {LAYOUT}")
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} CPU cores\n")
    print("| clip | frames | rank, tissue | error, tissue | flicker | rank, scene | error, scene |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    if arguments.sequence is not None:
        layout = load_layout(LAYOUT)
        source = open_source(arguments.sequence, layout)
        print(row(source.name, source, layout), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for index in range(CLIPS):
            clip = write_clip(Path(folder), index + 1, SceneSettings(frames=FRAMES), clip_seed(0, index))
            layout = ClipLayout()
            print(row(f"synthetic {index + 1}", open_source(clip, layout), layout), flush=True)
    print("\n| threads | ms a frame of 854x480 |\n| --- | --- |")
    for threads in (1, 2):
        print(f"| {threads} | {milliseconds(threads):.1f} |")


if __name__ == "__main__":
    main()
