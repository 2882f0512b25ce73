"""Scores the automatic masks against the annotation of clips: tool IoU, frames found, false positives, time.

    python -m benchmarks.automatic_masks CLIP... [--layout LAYOUT.yaml] [--output scores.csv]

A frame whose annotation holds no tool counts as a false positive where any tool pixel is reported.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from data.masks.automatic import TOOL, AutomaticMasks
from data.masks.sources import AnnotationMasks, MaskClasses, MaskError
from data.source.frames import discover, open_source
from data.source.layout import ClipLayout, InputError, load_layout
from evaluation.tables import to_csv
from physics.files import replacing

COLUMNS = ("clip", "frame", "annotated_px", "reported_px", "iou", "precision", "recall", "milliseconds")


@dataclass
class Scores:
    """Counts of one clip, frame by frame."""

    name: str
    rows: list[dict[str, float | str]] = field(default_factory=list)

    def add(self, number: int, annotated: np.ndarray, reported: np.ndarray, seconds: float) -> None:
        """Compare two tool masks [H, W] of a frame."""
        both, either = int((annotated & reported).sum()), int((annotated | reported).sum())
        truth, found = int(annotated.sum()), int(reported.sum())
        values = (both / either if either else 1.0, both / found if found else 1.0, both / truth if truth else 1.0)
        row = (self.name, number, truth, found, *(round(value, 4) for value in values), round(1000 * seconds, 1))
        self.rows.append(dict(zip(COLUMNS, row, strict=True)))

    def summary(self) -> str:
        """One Markdown table row: frames with tool, found, IoU over all and over found ones, false positives, time."""
        tool = [row for row in self.rows if row["annotated_px"]]
        hit = [row for row in tool if row["reported_px"]]
        empty = [row for row in self.rows if not row["annotated_px"]]
        false = sum(bool(row["reported_px"]) for row in empty)

        def mean(rows: list[dict], key: str) -> str:
            return f"{np.mean([row[key] for row in rows]):.2f}" if rows else "-"

        cells = (
            self.name,
            f"{len(hit)} of {len(tool)}",
            mean(tool, "iou"),
            mean(hit, "iou"),
            mean(hit, "precision"),
            f"{false} of {len(empty)}",
            f"{np.median([row['milliseconds'] for row in self.rows]):.0f}",
        )
        return "| " + " | ".join(cells) + " |"


HEADER = (
    "| clip | found | IoU, all | IoU, found | precision, found | false positives | ms a frame |\n"
    "| --- | --- | --- | --- | --- | --- | --- |"
)


def score_clip(path: Path, layout: ClipLayout) -> Scores:
    """Run the automatic mode over a clip and compare it with the annotation; frames without a mask are left out."""
    source, annotation, automatic = (
        open_source(path, layout),
        AnnotationMasks(layout, MaskClasses(), path),
        AutomaticMasks(),
    )
    scores = Scores(source.name)
    for frame in source:
        if frame.image is None:
            continue
        started = time.perf_counter()
        reported = automatic(frame) == TOOL
        seconds = time.perf_counter() - started
        try:
            annotated = annotation(frame) == TOOL
        except MaskError:
            continue
        scores.add(frame.number, annotated, reported, seconds)
    return scores


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.automatic_masks", description=__doc__.split("\n")[0])
    parser.add_argument("clips", nargs="+", type=Path, help="frame folders, or folders of those")
    parser.add_argument("--layout", type=Path, help="layout file (default: CholecSeg8k)")
    parser.add_argument("--output", type=Path, help="CSV file with one row a frame")
    options = parser.parse_args(arguments)
    opencv = version("opencv-python-headless")
    print(f"{platform.machine()}, {os.cpu_count()} cores, OpenCV {opencv}, {time.strftime('%Y-%m-%d')}\n")
    print(HEADER)
    try:
        layout = load_layout(options.layout) if options.layout else ClipLayout()
        results = []
        for clip in filter(Path.is_dir, discover(options.clips, layout)):  # videos have no annotation
            results.append(score_clip(clip, layout))
            print(results[-1].summary(), flush=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.output:
        rows = [row for scores in results for row in scores.rows]
        with replacing(options.output) as partial:
            partial.write_text(to_csv(rows, COLUMNS), encoding="utf-8")
        print(f"\nper frame: {options.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
