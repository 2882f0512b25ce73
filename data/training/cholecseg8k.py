"""CholecSeg8k and data sets laid out like it: its clips; prepares a data set and says what of it can be trained on.

    python -m data.cholecseg8k DIR [--depth photometric|stored|PRESET|FILE.onnx] [--masks annotation|automatic|FILE]

prints a table of the clips (videoNN/videoNN_SSSSS, 80 frames each; 854x480, 25 fps) and prepares depth and geometry for
training (training with other settings prepares its own). Exit status: 0 all clips done, 1 some failed (named, the
others complete), 2 wrong usage.
"""

import argparse
import contextlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from palpate.common.command_line import add_listed, path_option, say
from palpate.common.doors import plain
from palpate.common.files import read_beside
from palpate.data.cache import PreparedClip, require_models
from palpate.data.depth.normalise import DepthSettings
from palpate.data.settings import PrepareSettings
from palpate.data.source.discovery import discover
from palpate.data.source.layout import ClipLayout, InputError, frame_files, load_layout, read_clip_file
from palpate.data.training.preparation import prepare_all
from palpate.data.training.samples import SampleSettings, list_frames
from palpate.data.training.splits import video_of


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


def print_table(clips: Sequence[PreparedClip], console: Console) -> None:
    """Print a table of the clips: frames by status, gaps, and what training can use: frames in contact and pairs."""
    headings = ("frames", "size", "gaps", "pairs")
    numbers = (Column(heading, justify="right", no_wrap=True) for heading in headings)
    title = f"{len(clips)} clips"
    table = Table(Column("clip", no_wrap=True), *numbers, Column("by status", no_wrap=True), title=title)
    frames, pairs, contacts = 0, 0, 0
    for clip in clips:
        found, statuses = len(list_frames(clip, SampleSettings())[0]), clip.counts
        size = f"{clip.size[0]}x{clip.size[1]}"
        gaps = len(clip) - 1 - np.count_nonzero(clip.consecutive)
        by_status = "\n".join(f"{count} {status}" for status, count in statuses.most_common())
        table.add_row(Text(plain(clip.name)), str(len(clip)), size, str(gaps), str(found), by_status)
        frames, pairs, contacts = frames + len(clip), pairs + found, contacts + statuses["ok"]
    table.add_section()
    table.add_row("all", str(frames), "", "", str(pairs), f"{contacts} ok")
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prepare and print the table; returns the exit status."""
    text = "Prepare a data set's depth and geometry, and say what of it training can use."
    parser = argparse.ArgumentParser(prog="python -m data.cholecseg8k", description=text)
    add_listed(parser, read_beside(__file__), {"path": path_option})
    options = parser.parse_args(arguments)
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
    clips, failures = prepare_all(join_folders(paths, layout), settings, options.cache)
    if clips:
        print_table(clips, console)
    for path, reason in failures.items():
        say(errors, f"{path.name} failed: {reason}")
    if not any(clip.contact.any() for clip in clips) and clips:
        say(errors, "No frame is in contact, so there is nothing to train on; the table says why.")
    return 1 if failures else 0
