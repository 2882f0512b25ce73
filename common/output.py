"""Which files this program may replace: those that are still as it wrote them; any other is a user's and stays.

A hidden list in every folder tells them by their hashes.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from palpate.common.files import as_json, file_sha256, read_file, replacing

LIST = ".written-by-palpate.json"
"""Of what this program wrote in its folder: two hashes by name, the earlier file's and the one that took its place."""


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
        if os.path.lexists(path) and (path.is_symlink() or not _is_listed(path)):
            raise ForeignFile(path)


@contextmanager
def replacing_own(path: Path) -> Generator[Path]:
    """As `common.files.replacing`, of a file that is not there yet or still as this program wrote it.

    Raises:
        ForeignFile: see `require_own`.
    """
    require_own(path)
    with replacing(path) as partial:
        yield partial
        require_own(path)  # writing may have taken long
        files = _list_of(path.parent)
        # Both are noted before the files change places: an interruption in between leaves one of them.
        files[path.name] = [*_digests(path), *_digests(partial)]
        with replacing(path.parent / LIST) as listed:
            listed.write_text(as_json({"program": "palpate", "files": files}, indent=1) + "\n", encoding="utf-8")


def _is_listed(path: Path) -> bool:
    """Whether a file is as the list beside it has it; one that has no entry, whatever its size, is not read."""
    found = _list_of(path.parent).get(path.name)
    return isinstance(found, list) and any(digest in found for digest in _digests(path))


def _digests(path: Path) -> list[str]:
    """Hash of a file; none where there is no file."""
    return [file_sha256(path)] if path.is_file() else []


def _list_of(folder: Path) -> dict[str, list[str]]:
    """What this program wrote into a folder."""
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
