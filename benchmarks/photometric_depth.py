"""How good photometric depth is: against stored stereo depth and against synthetic truth, and what it costs.

    python -m benchmarks.photometric_depth [--sequence FOLDER]

prints the table of docs/reports/depth.md. Nothing is fitted but one scale a clip.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from palpate.benchmarks.shared import command_line, machine, print_table, timed
from palpate.data.depth.normalise import DepthSettings, open_depth
from palpate.data.labels import TISSUE, TOOL
from palpate.data.masks.sources import MaskClasses, open_masks
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout, load_layout
from palpate.data.synthetic.clip import clip_seed, write_clip
from palpate.data.synthetic.settings import SceneSettings

FAR_MULTIPLE = 3.0
"""Stored depth beyond this multiple of a frame's median is a mismatch of the stereo network, as in data.depth."""
LAYOUT = Path("configs/layouts/recover_tissue.yaml")
CLIPS, FRAMES = 4, 20
"""Synthetic clips, and frames of each."""
COLUMNS = ("clip", "frames", "rank, tissue", "error, tissue", "flicker", "rank, scene", "error, scene", "ms a frame")


def agreement(pairs: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float, float]:
    """Photometric against stored depth of a clip's frames, shapes [P].

    Returns:
        Spearman correlation within a frame, mean over the frames; median of |ratio/median ratio − 1| over all pixels,
        which is what is left after one scale for the clip; standard deviation over the frames of log(median ratio).
    """
    ratios = [estimate / truth for estimate, truth in pairs]
    together = np.concatenate(ratios)
    rank = np.mean([spearmanr(estimate, truth).statistic for estimate, truth in pairs])
    error = np.median(np.abs(together / np.median(together) - 1))
    return float(rank), float(error), float(np.std([np.log(np.median(ratio)) for ratio in ratios]))


def row(name: str, path: Path, layout: ClipLayout) -> list[str]:
    """One line of the table: tissue alone, then everything but the tool; every third row and column of the pictures."""
    source = open_source(path, layout)
    stored = open_depth(DepthSettings(source="stored"), layout, source)
    photometric = open_depth(DepthSettings(source="photometric", threads=1), layout, source)
    masks = open_masks("annotation", layout, MaskClasses(), path)
    tissue, scene, times = [], [], []
    for frame in source:
        found, milliseconds = timed(photometric, frame)
        estimate, truth, labels = (each[::3, ::3] for each in (found, stored(frame), masks(frame)))
        known = (truth > 0) & (estimate > 0) & (truth < FAR_MULTIPLE * np.median(truth[truth > 0]))
        for pairs, counts in ((tissue, labels == TISSUE), (scene, labels != TOOL)):
            pairs.append((estimate[known & counts], truth[known & counts]))
        times.append(milliseconds)
    rank, error, flicker = agreement(tissue)
    cells = [name, str(len(times)), f"{rank:.2f}", f"{error:.1%}", f"{flicker:.2%}"]
    rank, error, _ = agreement(scene)
    return [*cells, f"{rank:.2f}", f"{error:.1%}", f"{np.median(times):.0f}"]


def rows(sequence: Path | None) -> Iterator[list[str]]:
    """The real clip, where there is one, then the synthetic ones."""
    if sequence is not None:
        yield row(sequence.name, sequence, load_layout(LAYOUT))
    with tempfile.TemporaryDirectory() as folder:
        for index in range(CLIPS):
            clip = write_clip(Path(folder), index + 1, SceneSettings(frames=FRAMES), clip_seed(0, index))
            yield row(f"synthetic {index + 1}", clip, ClipLayout())


def main() -> None:
    """Print the table."""
    parser = command_line(__doc__)
    parser.add_argument("--sequence", type=Path, help=f"real clip with stored depth and masks as in {LAYOUT}")
    print(f"{machine()}\n")
    print_table(COLUMNS, rows(parser.parse_args().sequence))


if __name__ == "__main__":
    run_door(main)
