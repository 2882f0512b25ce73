"""Files that appear complete or not at all, reading that neither waits nor goes on for ever, JSON, and our own YAML."""

import errno
import hashlib
import json
import math
import os
import stat
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml


def read_file(path: Path, most: int = 2**24) -> bytes:
    """Return the content of a file.

    Args:
        most: bytes; a larger file is not read. Those that describe something are smaller, an hour's time stamps are.

    Raises:
        OSError: it can't be read, is larger, or is a pipe, which would be waited for, or a device, which has no end.
    """
    state = _require_file(path)
    if stat.S_ISREG(state.st_mode) and state.st_size > most:
        raise OSError(errno.EFBIG, f"larger than {most // 1024} kB", str(path))
    return path.read_bytes()


def read_beside(module: str) -> Any:
    """Return the content of the YAML file next to a module, whose `__file__` is given, of the same name."""
    text = Path(module).with_suffix(".yaml").read_text(encoding="utf-8")
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # the former, where it is, in a tenth of it


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content, which is never in memory as a whole.

    Raises:
        OSError: it can't be read, or is a pipe or a device.
    """
    _require_file(path)
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def as_json(value: object, **layout: Any) -> str:
    """Return a value as JSON: every document and every line of JSON that this program writes.

    JSON has no word for what isn't finite (RFC 8259, section 6): such numbers are null. Arrays are lists.

    Args:
        value: what `json.dumps` takes, arrays and their numbers among it.
        layout: `indent`, `sort_keys`, `ensure_ascii` of `json.dumps`.
    """
    return json.dumps(_finite(value), allow_nan=False, **layout)


def _finite(value: Any) -> Any:
    """Return a value with None in place of numbers that aren't finite, and with lists in place of arrays."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def digest_of(value: object) -> str:
    """Return the SHA-256 of a value of JSON's kinds, as hexadecimal text; numbers that aren't finite differ from None
    in it."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _require_file(path: Path) -> os.stat_result:
    state = path.stat()
    if not (stat.S_ISREG(state.st_mode) or stat.S_ISDIR(state.st_mode)):
        raise OSError(errno.EINVAL, "no file but a pipe or a device", str(path))
    return state


def all_below(folder: Path) -> list[Path]:
    """Return files in a folder and below, sorted.

    Links to folders are not followed. A folder that can't be listed, or whose path is too long to be opened, is as if
    empty.
    """
    found, left = [], [folder]
    while left:
        with suppress(OSError), os.scandir(left.pop()) as entries:
            for entry in entries:
                path = Path(entry.path)
                if os.path.lexists(path):
                    found.append(path)
                    left += [path] if entry.is_dir(follow_symlinks=False) else []
    return sorted(found)


@contextmanager
def replacing(path: Path) -> Generator[Path]:
    """A name next to a file to write its content under; it takes the file's place when all went well.

    Whatever goes wrong, an earlier file stays as it was and nothing of the new one remains.
    """
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
