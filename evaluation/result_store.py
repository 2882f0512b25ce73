"""The output folder of a run: which folder belongs to which clip, which clips are done, and what can go wrong there."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TABLE, OVERLAY, SUMMARY, RECORD = "parameters.csv", "overlay.mp4", "summary.png", "run.json"
"""Files of a clip's folder. The record is written last: a folder that has it is complete."""
NOT_OURS = "something that is not ours"
_NAME_BYTES = 120


class OutputError(ValueError):
    """The results can't be written; the message says where, why and what to do."""


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn a file-system error met while writing into one sentence.

    Raises:
        OutputError: the folder is full, read-only, or otherwise not writable.
    """
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            problem = "the output folder is full; free some space"
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            problem = "the output folder can't be written; change its permissions"
        else:
            reason = error.strerror or str(error) or type(error).__name__
            problem = f"writing failed ({reason}); check the output folder"
        raise OutputError(f"{folder}: {problem} or choose another --output.") from error


def safe_name(name: str) -> str:
    """A clip's name as a folder name that every file system takes.

    Letters of any script stay; what file systems forbid becomes `_`; a name over 120 bytes of UTF-8 is cut and ends
    with a hash of the whole.
    """
    normal = unicodedata.normalize("NFC", name)
    clean = re.sub(r'[\x00-\x1f\x7f<>:"/\\|?*\ud800-\udfff]', "_", normal).strip(" .") or "clip"
    if len(clean.encode()) <= _NAME_BYTES:
        return clean
    mark = hashlib.sha256(normal.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return clean.encode()[: _NAME_BYTES - 9].decode("utf-8", "ignore").rstrip(" .") + "-" + mark


class ResultStore:
    """The output folder of a run: which folder belongs to which clip, and which clips are done.

    Args:
        output: the folder; made when it is not there.
        program: whose results they are; another program's are never replaced.

    Raises:
        OutputError: it can't be made or written.
    """

    def __init__(self, output: Path, program: str) -> None:
        self.output, self.program = output, program
        self._taken: dict[str, str] = {}
        if output.exists() and not output.is_dir():
            raise OutputError(f"{output}: is a file; give a folder as --output.")
        with writing(output):
            output.mkdir(parents=True, exist_ok=True)
            probe = output / f".write-test-{os.getpid()}"
            probe.write_bytes(b"")
            probe.unlink()

    def folder(self, name: str, origin: Path) -> Path:
        """Folder of the clip `name` that comes from `origin`.

        Its name, or its name with a mark when another clip's results, or anything that is not ours, are there.

        Raises:
            OutputError: both are taken.
        """
        source = str(origin.resolve())
        plain = safe_name(name)
        mark = hashlib.sha256(source.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        owners = {name: self._owner(name) for name in (plain, f"{plain}-{mark}")}
        for wanted in (source, ""):
            for name, owner in owners.items():
                if owner == wanted:
                    self._taken[name.casefold()] = source
                    return self.output / name
        raise OutputError(f"{self.output / name}: holds something else; move it away or choose another --output.")

    def is_complete(self, folder: Path, fingerprint: str, files: Iterable[str]) -> bool:
        """Whether the folder holds these files as results of exactly this input, these models and these settings."""
        record = read_record(folder)
        return record.get("fingerprint") == fingerprint and all((folder / name).is_file() for name in files)

    def _owner(self, name: str) -> str:
        """Source whose results the folder `name` holds; empty when it is free."""
        taken = self._taken.get(name.casefold())
        folder = self.output / name
        if taken is not None:
            return taken
        if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
            return ""
        record = read_record(folder)
        ours = record.get("program") == self.program
        return str(record.get("input", {}).get("path", NOT_OURS)) if ours else NOT_OURS


def read_record(folder: Path) -> dict[str, Any]:
    """The run record of a clip's folder; empty where there is none or it is damaged."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Store a run record as JSON; only numbers that JSON knows may be in it."""
    document = json.dumps(dict(record), indent=2, ensure_ascii=False, allow_nan=False)
    # File names that are not UTF-8 become \udcXX, which is JSON's own way to write them.
    (folder / RECORD).write_bytes((document + "\n").encode("utf-8", "backslashreplace"))


def partial_folder(folder: Path) -> Path:
    """Hidden folder beside the final one, in which this process gathers the results."""
    return folder.with_name(f".{folder.name}.partial-{os.getpid()}")


def publish(partial: Path, folder: Path) -> None:
    """Swap a finished folder in; earlier results leave only once the new ones are complete."""
    earlier = folder.with_name(f".{folder.name}.old-{os.getpid()}")
    if folder.exists():
        os.replace(folder, earlier)
    os.replace(partial, folder)
    shutil.rmtree(earlier, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Clear what a killed run left beside this folder, or bring its earlier results back."""
    for old in folder.parent.glob(f".{_escape(folder.name)}.old-*"):
        if folder.exists():
            shutil.rmtree(old, ignore_errors=True)
        else:
            os.replace(old, folder)
    for partial in folder.parent.glob(f".{_escape(folder.name)}.partial-*"):
        if not _is_running(partial.name.rpartition("-")[2]):
            shutil.rmtree(partial, ignore_errors=True)


def _escape(name: str) -> str:
    return re.sub(r"([*?\[])", r"[\1]", name)


def _is_running(process: str) -> bool:
    """Whether another process with this id lives."""
    try:
        os.kill(int(process), 0)
    except (ProcessLookupError, ValueError):
        return False
    except OSError:
        return True
    return int(process) != os.getpid()
