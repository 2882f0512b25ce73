"""Automatic masks against outlines that people drew, a row a source.

    python -m benchmarks.instruments --data DIR [--network FILE.onnx] [--output DIR]

A source is a folder below DIR of pictures NAME.png or .jpg with NAME_tool.png beside them (255 = instrument, 127 = not
known), or a clip in CholecSeg8k's or our own layout. Folders below `free` have trained the network that ships and are
left out. Pictures are compared at 384×224. table.csv has a row a source:

pictures, IoU, below 0.05    pictures with an instrument, their mean IoU, and the share with an IoU below 0.05
stray pixels, above 100      mean number of pixels farther than 4 px from an instrument; share of pictures with over 100
tips                         share of outlines' free ends, farthest from where they enter, within 16 px of one found
tool-free, tool found there  pictures without an instrument, and those in which one is found
ms a frame                   median time
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from rich.console import Console

from benchmarks.harness import csv_of, show
from palpate.common.command_line import say
from palpate.common.doors import run_door
from palpate.common.options import options
from palpate.data.contact.tips import tool_tips
from palpate.data.labels import TOOL
from palpate.data.masks.annotation import read_class_mask
from palpate.data.masks.automatic import WEIGHTS, AutomaticMasks
from palpate.data.masks.request import MaskClasses
from palpate.data.source.frames import Frame
from palpate.data.source.images import read_image
from palpate.data.source.layout import IMAGE_SUFFIXES, InputError
from palpate.data.tracks.following import lit_field
from palpate.results.store import OutputError, make_output

SIZE = 384, 224
"""Width and height at which pictures are compared."""
NEAR = 16.0
"""Free ends that are found lie no farther from drawn ones [px]."""


@dataclass(frozen=True)
class Instruments:
    """Options of the benchmark."""

    data: Path
    """folder of sources"""
    network: Path = WEIGHTS
    """the network; by default the one that ships"""
    output: Path = Path("runs/instruments")
    """folder of table.csv"""


def sources(folder: Path) -> dict[str, list[tuple[Path, Path]]]:
    """Pictures with their masks by source.

    Raises:
        InputError: there are none.
    """
    found: dict[str, list[tuple[Path, Path]]] = {}
    for mask in sorted(folder.rglob("*.png")):
        name, parts = mask.stem, mask.relative_to(folder).parts
        stem = next((name.removesuffix(end) for end in ("_tool", "_color_mask") if name.endswith(end)), None)
        if stem is None or "free" in parts:
            continue
        picture = next((file for end in IMAGE_SUFFIXES if (file := mask.with_name(stem + end)).is_file()), None)
        if picture is not None:
            found.setdefault("/".join(parts[:-1]), []).append((picture, mask))
    if not found:
        raise InputError(f"{folder} holds no pictures with masks NAME_tool.png; give a folder of such folders.")
    return found


def instrument(mask: Path, size: tuple[int, int]) -> np.ndarray:
    """Labels of a mask: 1 = instrument, 0 = none, 2 = not known, uint8 [H, W]."""
    if not mask.stem.endswith("_tool"):
        classes = MaskClasses(tool=("grasper", "l-hook electrocautery"), tissue=("gallbladder",))
        return (read_class_mask(mask, size, classes) == TOOL).astype(np.uint8)
    stored = read_image(mask, cv2.IMREAD_GRAYSCALE)
    return np.where(stored == 255, 1, np.where(stored > 0, 2, 0)).astype(np.uint8)


def end_points(tool: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """Places (column, row) of the points of instruments that are farthest from where they enter, shape [N, 2]."""
    ends = [part.mean(axis=0) for part in tool_tips(tool, lit, 2.0, 20)]
    return np.array(ends).reshape(-1, 2)


def measured(network: Path, pictures: Sequence[tuple[Path, Path]]) -> Iterator[dict[str, float]]:
    """Measures of the pictures of one source; each is masked by itself."""
    masks = AutomaticMasks(network, threads=1)
    for number, (picture, mask) in enumerate(pictures):
        masks.reset()
        frame = Frame(number, number, number / 25, read_image(picture))
        began = time.perf_counter()
        labels = masks(frame)
        seconds = time.perf_counter() - began
        lit = cv2.resize(lit_field(frame.picture).astype(np.uint8), SIZE, interpolation=cv2.INTER_NEAREST) > 0
        pair = (labels == TOOL).astype(np.uint8), instrument(mask, labels.shape)
        found, true = (cv2.resize(each, SIZE, interpolation=cv2.INTER_NEAREST) for each in pair)
        known, tool = true != 2, true == 1
        found = (found > 0) & known
        # Pixels farther than four from an instrument count as stray.
        near = cv2.dilate((true > 0).astype(np.uint8), np.ones((9, 9))) > 0
        union = (found | tool).sum()
        row = {"seconds": seconds, "stray": float((found & ~near).sum())}
        if tool.sum() < 20:
            yield row | {"free": 1.0, "false": float(found.sum() > 60)}
        else:
            apart = np.linalg.norm(end_points(tool, lit)[:, None] - end_points(found, lit), axis=-1)
            hit = apart.min(axis=1, initial=np.inf) <= NEAR
            yield row | {"iou": float((found & tool).sum() / union), "ends": len(hit), "ends_found": hit.sum()}


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a source, and their mean."""
    rows = rows.reindex(columns=["source", "seconds", "stray", "free", "false", "iou", "ends", "ends_found"])
    parts = rows.groupby("source", sort=False)
    summed = pd.DataFrame(
        {
            "pictures": parts.iou.count(),
            "IoU": parts.iou.mean(),
            "below 0.05": parts.iou.apply(lambda iou: (iou < 0.05).sum() / max(iou.count(), 1)),
            "stray pixels": parts.stray.mean(),
            "above 100": parts.stray.apply(lambda stray: (stray > 100).mean()),
            "tips": parts.ends_found.sum() / parts.ends.sum(),
            "tool-free": parts.free.sum(),
            "tool found there": parts.false.sum(),
            "ms a frame": 1e3 * parts.seconds.median(),
        }
    )
    counts = ["pictures", "tool-free", "tool found there"]
    summed.loc["all"] = summed.agg({name: "sum" if name in counts else "mean" for name in summed})
    return summed.reset_index()


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all sources and write the table; returns the exit status."""
    asked: Instruments = options(Instruments, arguments, "benchmarks.instruments", __doc__)
    cv2.setNumThreads(1)
    try:
        make_output(asked.output)
        rows = [
            {"source": source} | row
            for source, pictures in sources(asked.data).items()
            for row in measured(asked.network, pictures)
        ]
        found = table(pd.DataFrame(rows))
        (asked.output / "table.csv").write_text(csv_of(found), encoding="utf-8")
    except (InputError, OutputError) as error:
        say(Console(stderr=True), str(error), "red")
        return 1
    show(found)
    return 0


if __name__ == "__main__":
    run_door(main)
