"""Scores the automatic masks against the annotation of clips: tool IoU, frames found, false positives, time.

    python -m benchmarks.automatic_masks CLIP... [--layout LAYOUT.yaml]

A frame whose annotation holds no tool counts as a false positive where any tool pixel is reported.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from palpate.benchmarks.shared import command_line, machine, print_table, timed
from palpate.data.masks.automatic import TOOL, AutomaticMasks
from palpate.data.masks.sources import AnnotationMasks, MaskClasses, MaskError
from palpate.data.source.frames import discover, open_source
from palpate.data.source.layout import ClipLayout, InputError, load_layout

COLUMNS = ("clip", "found", "IoU, all", "IoU, found", "precision, found", "false positives", "ms a frame")


def scores(path: Path, layout: ClipLayout) -> Iterator[tuple[float, ...]]:
    """Tool pixels of a clip's frames, annotated, reported and both, and the time of each [ms].

    Frames without annotation are left out.
    """
    annotation, automatic = AnnotationMasks(layout, MaskClasses(), path), AutomaticMasks()
    for frame in open_source(path, layout):
        if frame.image is None:
            continue
        labels, milliseconds = timed(automatic, frame)
        try:
            annotated, reported = annotation(frame) == TOOL, labels == TOOL
        except MaskError:
            continue
        yield annotated.sum(), reported.sum(), (annotated & reported).sum(), milliseconds


def summary(name: str, frames: Iterable[tuple[float, ...]]) -> list[str]:
    """Row of a clip: found frames with tool, IoU over all and over found ones, precision, false positives, time."""
    annotated, reported, both, milliseconds = np.reshape(list(frames), (-1, 4)).T
    tool, reports = annotated > 0, reported > 0
    found = tool & reports
    iou = both[tool] / (annotated + reported - both)[tool]

    def mean(values: np.ndarray) -> str:
        return f"{values.mean():.2f}" if len(values) else "-"

    return [
        name,
        f"{found.sum()} of {tool.sum()}",
        mean(iou),
        mean(iou[found[tool]]),
        mean(both[found] / reported[found]),
        f"{(reports & ~tool).sum()} of {(~tool).sum()}",
        f"{np.median(milliseconds):.0f}",
    ]


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = command_line(__doc__)
    parser.add_argument("clips", nargs="+", type=Path, help="frame folders, or folders of those")
    parser.add_argument("--layout", type=Path, help="layout file (default: CholecSeg8k)")
    options = parser.parse_args(arguments)
    print(f"{machine()}\n")
    try:
        layout = load_layout(options.layout) if options.layout else ClipLayout()
        clips = filter(Path.is_dir, discover(options.clips, layout))  # videos have no annotation
        print_table(COLUMNS, (summary(clip.name, scores(clip, layout)) for clip in clips))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    run_door(main)
