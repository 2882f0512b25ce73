"""Prepares the clips of a data set one after the other, with a progress bar; one bad clip does not end it."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.console import Console

from palpate.common.command_line import progress_bars
from palpate.common.doors import interruptible, plain
from palpate.data.cache import PreparedClip
from palpate.data.clip import ClipStream, prepare
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.layout import InputError


def prepare_all(
    found: Mapping[Path, Sequence[Path]], settings: PrepareSettings, cache_dir: Path, *, show: bool = True
) -> tuple[list[PreparedClip], dict[Path, str]]:
    """Prepare clips, or read them from the cache.

    Args:
        found: frame folders or video files, each with the folders that continue it.
        settings: how to prepare them.
        cache_dir: folder of the cache.
        show: whether to draw a progress bar on standard error.

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
