"""The clips of a data set, prepared one after the other with a progress bar; one bad clip does not end it."""

import contextlib
import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from palpate.common.command_line import progress_bars
from palpate.common.doors import interruptible, plain
from palpate.data.cache import PreparedClip
from palpate.data.clip import ClipStream, prepare
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.discovery import discover
from palpate.data.source.layout import ClipLayout, InputError, frame_files, read_clip_file
from palpate.data.training.splits import video_of


def prepare_all(
    found: Mapping[Path, Sequence[Path]], settings: PrepareSettings, cache_dir: Path, *, show: bool = True
) -> tuple[list[PreparedClip], dict[Path, str]]:
    """Prepare clips, or read them from the cache.

    Args:
        found: frame folders or video files, each with the folders that continue it.
        settings: settings of the preparation.
        cache_dir: folder of the cache.
        show: True = draw a progress bar on standard error.

    Returns:
        The prepared clips, and the reason for each that could not be prepared.
    """
    clips, failures = [], {}
    with progress_bars(Console(stderr=True), disable=not show) as bar:
        task = bar.add_task("preparing", total=None)

        def track(stream: ClipStream) -> Iterable[PreparedFrame]:
            return bar.track(stream, stream.source.length, task_id=task)

        for number, (path, following) in enumerate(found.items(), start=1):
            bar.reset(task, description=f"preparing {plain(path.name)} ({number}/{len(found)})")
            try:
                with interruptible():
                    clip = prepare(path, settings, cache_dir, track, following)
                bar.update(task, total=len(clip), completed=len(clip))
                clips.append(clip)
            except Exception as error:
                failures[path] = message = " ".join(str(error).split())
                if not isinstance(error, InputError):
                    logging.getLogger(__name__).debug("a clip failed", exc_info=error)
                    failures[path] = f"unexpected {type(error).__name__} ({message}); report it with the clip's files."
    return clips, failures


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

    Such folders are of one video, agree in `clip.json`, and have consecutive frame numbers: CholecSeg8k cuts videos
    every 80 frames, also during contact.

    Args:
        paths: clips that `list_clips` found.
        layout: names of the clips' files.
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
    """First and last frame number of a folder and its `clip.json` without times; None if they can't be read."""
    with contextlib.suppress(OSError, InputError):
        described = {name: value for name, value in read_clip_file(path).items() if name != "times"}
        numbers = [number for number, _ in frame_files(path, layout)]
        if numbers:
            return numbers[0], numbers[-1], described
    return None, None, None
