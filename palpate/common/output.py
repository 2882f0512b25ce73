"""Files that this program may replace: those that are still as it wrote them; any other is a user's and stays.

A hidden list in every folder holds their hashes. Results of a clip have theirs in their record, `results/store.py`.
"""

import errno
import json
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from palpate.common.files import all_below, as_json, file_sha256, read_file, replacing

LIST = ".written-by-palpate.json"
"""File list of what this program wrote in its folder: two hashes by name, the earlier file's and the one that took its
place."""


class ForeignFile(FileExistsError):
    """A file that this program did not write, or that was changed since, is where it would write; a sentence."""

    def __init__(self, path: Path) -> None:
        super().__init__(errno.EEXIST, "is not as this program wrote it", str(path))

    def __str__(self) -> str:
        return f"{self.filename} is not as this program wrote it; move it away or choose another place."


def require_own(*paths: Path) -> None:
    """Refuse to write where a user's file is.

    Raises:
        ForeignFile: something is there that is not as this program wrote it.
    """
    for path in paths:
        if os.path.lexists(path) and (path.is_symlink() or not is_own(path)):
            raise ForeignFile(path)


@contextmanager
def replacing_own(path: Path) -> Generator[Path]:
    """Replace a file that is not there yet or still as this program wrote it; see `palpate.common.files.replacing`.

    Raises:
        ForeignFile: see `require_own`.
    """
    require_own(path)
    with replacing(path) as partial:
        yield partial
        require_own(path)  # writing may have taken long
        files = _list_of(path.parent)
        # Both are noted before the files change places: an interruption in between leaves one of them.
        files[path.name] = [*dict.fromkeys([*_digests(path), *_digests(partial)])]
        _write_list(path.parent, files)


def write_own(path: Path, content: str | bytes) -> None:
    """Write a file, text as UTF-8, as `replacing_own` does; raises its ForeignFile."""
    with replacing_own(path) as partial:
        partial.write_bytes(content.encode("utf-8", "replace") if isinstance(content, str) else content)


def list_folder(folder: Path) -> None:
    """List all that is in a folder and below as written by this program, by relative names."""
    _write_list(folder, {name: [digest] for name, digest in _content(folder).items()})


def require_own_folder(folder: Path) -> None:
    """Refuse to replace a folder that holds anything that `list_folder` has not listed, or that was changed since.

    Raises:
        ForeignFile: there is such a file or link, or the folder has no list.
    """
    if not os.path.lexists(folder):
        return
    listed = {} if folder.is_symlink() else _list_of(folder)
    if not listed:
        raise ForeignFile(folder)
    for name, digest in _content(folder).items():
        if name != LIST and digest not in listed.get(name, ()):
            raise ForeignFile(folder / name)


def _content(folder: Path) -> dict[str, str]:
    """Return the hash of every file in a folder and below, by its relative name; empty for links, empty folders and the
    like."""
    content = {}
    for path in all_below(folder):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not path.is_symlink():
            state = path.stat()
            # Larger files are recognised by size and time of change.
            huge = state.st_size > 2**28
            content[name] = f"{state.st_size} bytes, {state.st_mtime_ns}" if huge else file_sha256(path)
        elif path.is_symlink() or not path.is_dir() or not any(path.iterdir()):
            content[name] = ""
    return content


def is_own(path: Path) -> bool:
    """Return whether a file is as its folder's list has it; one that has no entry, whatever its size, is not read."""
    return is_unchanged(path, _list_of(path.parent).get(path.name))


def is_unchanged(path: Path, digests: object) -> bool:
    """Return whether a file has one of these hashes; without any, it is not read."""
    return isinstance(digests, list) and any(digest in digests for digest in _digests(path))


def _digests(path: Path) -> list[str]:
    """Return the hash of a file; none where there is no file."""
    return [file_sha256(path)] if path.is_file() else []


def _write_list(folder: Path, files: dict[str, list[str]]) -> None:
    with replacing(folder / LIST) as listed:
        listed.write_text(as_json({"program": "palpate", "files": files}, indent=1) + "\n", encoding="utf-8")


def _list_of(folder: Path) -> dict[str, list[str]]:
    """Return files that this program wrote into a folder."""
    path = folder / LIST
    if not os.path.lexists(path):
        return {}
    try:
        listed = json.loads(read_file(path))
        if listed["program"] == "palpate" and isinstance(listed["files"], dict):
            return listed["files"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    raise ForeignFile(path)
