"""The search for clips: video files, bags, folders of frames, and folders of those."""

import re
from os.path import isdir
from pathlib import Path

from palpate.data.source.bags import is_bag
from palpate.data.source.images import printable
from palpate.data.source.layout import IMAGE_SUFFIXES, ClipLayout, InputError, folders_beside, frame_files, list_folder
from palpate.data.source.lerobot import episodes_in, file_of

MOST_FOLDERS = 5_000
"""Largest number of folders that a search for clips opens, at a millisecond each; large data sets have hundreds."""


def discover(inputs: list[Path], layout: ClipLayout) -> list[Path]:
    """Clips under the given paths, in natural order within each: video files, bags, frame folders, folders of those.

    Raises:
        InputError: a path does not exist, can't be listed, or holds no clip, or episodes without distinct names.
    """
    clips: dict[Path, None] = {}
    for given in map(Path, inputs):
        try:
            file_of(given).stat()
            found = _search(given, layout) if given.is_dir() else [given]
        except OSError as error:
            raise InputError(f"{printable(given)} can't be opened ({error.strerror}); check the path.") from error
        if not given.is_dir() and given.suffix.lower() in IMAGE_SUFFIXES:
            raise InputError(f"{printable(given)} is a single image; give the folder of the clip's frames.")
        if not found:
            raise InputError(f"{printable(given)} holds no video, bag or folder of frames; give one that does.")
        clips |= {each: None for path in found for each in ([path / name for name in episodes_in(path)] or [path])}
    return list(clips)


def _search(top: Path, layout: ClipLayout) -> list[Path]:
    """Clips in a folder and below, in natural order.

    Raises:
        InputError: there are more folders than `MOST_FOLDERS`.
        OSError: the folder can't be listed.
    """
    kinds = "mp4|m4v|mov|qt|3gp|3g2|avi|divx|mkv|webm|mpe?g|m2v|m?ts|m2ts|vob|mxf|flv|f4v|wmv|asf|ogv|ogm|dv|y4m"
    video = re.compile(rf"\.({kinds})", re.IGNORECASE)
    found: list[Path] = []
    visited: set[tuple[int, int]] = set()  # links may lead in circles
    left = [top]
    while left:
        folder = left.pop()
        try:
            if not folder.is_dir():
                found.append(folder)
                continue
            state = folder.stat()
            place = state.st_dev, state.st_ino
            # A folder of this project's results, whose overlay video is no input.
            if place in visited or (folder / "run.json").is_file():
                continue
            visited.add(place)
            if len(visited) > MOST_FOLDERS:
                problem = f"holds more than {MOST_FOLDERS} folders, links followed; give those of the clips"
                raise InputError(f"{printable(top)} {problem}.")
            if is_bag(folder) or frame_files(folder, layout):
                found.append(folder)
                continue
            entries = [entry for entry in list_folder(folder) if not entry.name.startswith(".")]
            companions = folders_beside(folder)
            others = [entry for entry in entries if entry not in companions] if companions else []
            if any(video.fullmatch(e.suffix) or (isdir(e) and frame_files(e, layout)) for e in others):
                entries = others
        except OSError:
            if folder == top:
                raise
            found.append(folder)  # opening it fails later, and the other clips go on
            continue
        left += reversed([e for e in entries if isdir(e) or video.fullmatch(e.suffix) or is_bag(e)])
    return found
