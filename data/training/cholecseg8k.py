"""CholecSeg8k and data sets laid out like it: its clips; checks a data set and prepares it.

    python -m data.cholecseg8k DIR [--depth photometric|stored|PRESET|FILE.onnx] [--masks annotation|automatic|FILE]

prints a table of the clips (videoNN/videoNN_SSSSS, 80 frames each; 854x480, 25 fps) and prepares depth and geometry for
training (training with other settings prepares its own). Exit status: 0 all clips done, 1 some failed (named, the
others complete), 2 wrong usage.
"""

import argparse
import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from palpate.common.command_line import path_option, say
from palpate.common.doors import plain
from palpate.data.cache import PreparedClip, require_models
from palpate.data.depth.normalise import DepthSettings
from palpate.data.labels import MaskError
from palpate.data.masks.class_table import CLASSES
from palpate.data.masks.sources import MaskClasses, color_distance, mask_file, read_mask
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame, discover, open_source
from palpate.data.source.layout import ClipLayout, InputError, frame_files, load_layout, read_clip_file
from palpate.data.training.preparation import prepare_all
from palpate.data.training.samples import SampleSettings, list_frames
from palpate.data.training.splits import video_of

UNLABELLED_COLORS = ((255, 255, 255), (0, 0, 0))
"""Colours of no class that masks hold nevertheless: of the 1-px border, and of unlabelled pixels."""
MOST_SHOWN_PROBLEMS = 5
"""Largest number of problems of a clip that are printed."""


def list_clips(root: Path | str, layout: ClipLayout) -> list[Path]:
    """Frame folders at any depth under `root`, in natural order; where there are none, the video files.

    A synthetic clip has a video next to its folder: the two are one clip.

    Raises:
        InputError: no such folder, or no clip in it.
    """
    found = discover([Path(root)], layout)
    folders = [path for path in found if path.is_dir()]
    return folders or found


def join_folders(paths: Iterable[Path], layout: ClipLayout) -> dict[Path, tuple[Path, ...]]:
    """Clips by their first folder, each with the folders that continue it.

    Such folders are of one video, agree in `clip.json`, and their frame numbers are consecutive: CholecSeg8k cuts a
    video every 80 frames, and contact does not end there.

    Args:
        paths: what `list_clips` found.
        layout: how the clips' files are named.
    """
    clips: dict[Path, tuple[Path, ...]] = {}
    first, end = Path(), (None, None)
    for path in paths:
        begin, last, described = _extent(path, layout)
        if begin is not None and end == (begin - 1, described) and video_of(path) == video_of(first):
            clips[first] += (path,)
        else:
            first, clips[path] = path, ()
        end = last, described
    return clips


def _extent(path: Path, layout: ClipLayout) -> tuple[int | None, int | None, dict[str, Any] | None]:
    """First and last frame number of a folder and its `clip.json` without times; None each where they can't be read."""
    with contextlib.suppress(OSError, InputError):
        described = {name: value for name, value in read_clip_file(path).items() if name != "times"}
        numbers = [number for number, _ in frame_files(path, layout)]
        if numbers:
            return numbers[0], numbers[-1], described
    return None, None, None


@dataclass(frozen=True)
class ClipCheck:
    """Result of reading a clip's files."""

    size: tuple[int, int]
    """(width, height) of its pictures [px]."""
    unknown_share: float
    """Share of mask pixels whose colour or value belongs to no class."""
    problems: list[str]
    """Problems of the clip, one sentence each."""


def check_clip(
    path: Path, layout: ClipLayout, classes: MaskClasses, *, masks: bool = True, following: Sequence[Path] = ()
) -> ClipCheck:
    """Read every frame and mask of a clip and list what is wrong.

    Args:
        path: frame folder or video file.
        layout: how its files are named.
        classes: settings with the tolerance of the masks' colours.
        masks: whether annotation masks are expected.
        following: frame folders that continue the first one.

    Raises:
        InputError: the clip can't be opened.
    """
    source = open_source(path, layout, following)
    shares, problems = [], []
    for frame in source:
        if frame.image is None:
            problems.append(f"Frame {frame.number}: {frame.error}")
        elif masks and frame.path is not None and layout.mask_patterns:
            try:
                shares.append(_unknown_share(frame, layout, classes))
            except MaskError as error:
                problems.append(str(error))
    return ClipCheck(source.size, float(np.mean(shares)) if shares else 0.0, problems + source.warnings)


def _unknown_share(frame: Frame, layout: ClipLayout, classes: MaskClasses) -> float:
    """Share of the pixels of a frame's mask that belong to no class and no border."""
    file, pattern = mask_file(layout, frame)
    mask = read_mask(file, frame.picture.shape[:2])
    if pattern == layout.label_mask:
        known = np.isin(mask, layout.tool_values + layout.tissue_values)
    elif mask.ndim == 2:
        known = np.isin(mask, [entry.grey for entry in CLASSES.values()] + [color[0] for color in UNLABELLED_COLORS])
    else:
        # A mask has few colours, so only those are compared. They are packed into one number each, since sorting rows
        # of three is ten times slower.
        packed, place = np.unique(mask @ np.array([1 << 16, 1 << 8, 1], np.uint32), return_inverse=True)
        found = np.stack((packed >> 16, packed >> 8 & 255, packed & 255), axis=1).astype(np.uint8)
        colors = [entry.color for entry in CLASSES.values()] + list(UNLABELLED_COLORS)
        distance = np.min([color_distance(found[None], color)[0] for color in colors], axis=0)
        known = (distance <= classes.tolerance)[place]
    return float(1 - known.mean())


def print_table(clips: Sequence[PreparedClip], checks: dict[Path, ClipCheck], console: Console) -> None:
    """Print a table of the clips: frames, problems, and what training can use: frames in contact (`ok`) and pairs."""
    headings = ("frames", "size", "gaps", "no class", "pairs")
    numbers = (Column(heading, justify="right", no_wrap=True) for heading in headings)
    title = f"{len(clips)} clips"
    table = Table(Column("clip", no_wrap=True), *numbers, Column("by status", no_wrap=True), title=title)
    frames, pairs, contacts = 0, 0, 0
    for clip in clips:
        check, found, statuses = checks[clip.path], len(list_frames(clip, SampleSettings())[0]), clip.counts
        size, share = f"{check.size[0]}x{check.size[1]}", f"{check.unknown_share:.2%}"
        gaps = len(clip) - 1 - np.count_nonzero(clip.consecutive)
        by_status = "\n".join(f"{count} {status}" for status, count in statuses.most_common())
        table.add_row(Text(plain(clip.name)), str(len(clip)), size, str(gaps), share, str(found), by_status)
        frames, pairs, contacts = frames + len(clip), pairs + found, contacts + statuses["ok"]
    table.add_section()
    table.add_row("all", str(frames), "", "", "", str(pairs), f"{contacts} ok")
    console.print(table)


def _parser() -> argparse.ArgumentParser:
    text = "Check a data set and prepare its depth and geometry."
    parser = argparse.ArgumentParser(prog="python -m data.cholecseg8k", description=text)
    parser.add_argument("root", type=path_option, metavar="DIR", help="folder of the data set, or of one clip")
    parser.add_argument("--depth", default="auto", help="auto, stored, a preset's name, or an .onnx file (%(default)s)")
    parser.add_argument("--depth-model", metavar="FILE", help="ONNX file of the preset")
    masks = "auto, annotation, automatic, or a file: an .onnx model or outlines in .yaml (%(default)s)"
    parser.add_argument("--masks", default="auto", help=masks)
    parser.add_argument("--layout", type=path_option, metavar="FILE", help="YAML file that names a clip's files")
    parser.add_argument("--cache", type=path_option, default=Path("runs/cache"), help="of results (%(default)s)")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Check and prepare; returns the exit status."""
    options = _parser().parse_args(arguments)
    console, errors = Console(), Console(stderr=True)

    try:
        layout = ClipLayout() if options.layout is None else load_layout(options.layout)
        depth = DepthSettings(source=options.depth, model=options.depth_model)
        settings = PrepareSettings(depth=depth, masks=options.masks, layout=layout)
        require_models(settings)
        paths = list_clips(options.root, layout)
    except ValueError as error:
        say(errors, str(error))
        return 2
    checks: dict[Path, ClipCheck] = {}
    failures: dict[Path, str] = {}
    annotated = options.masks in ("auto", "annotation")
    found = join_folders(paths, layout)
    for path, following in found.items():
        try:
            checks[path] = check_clip(path, layout, settings.classes, masks=annotated, following=following)
        except InputError as error:
            failures[path] = str(error)
    clips, failed = prepare_all({path: found[path] for path in checks}, settings, options.cache)
    failures |= failed
    if clips:
        print_table(clips, checks, console)
    for clip in clips:
        problems = checks[clip.path].problems
        for problem in problems[:MOST_SHOWN_PROBLEMS]:
            say(errors, f"{clip.name}: {problem}")
        if len(problems) > MOST_SHOWN_PROBLEMS:
            say(errors, f"{clip.name}: and {len(problems) - MOST_SHOWN_PROBLEMS} more such.")
    for path, reason in failures.items():
        say(errors, f"{path.name} failed: {reason}")
    if not any(clip.contact.any() for clip in clips) and clips:
        say(errors, "No frame is in contact, so there is nothing to train on; the table says why.")
    return 1 if failures else 0
