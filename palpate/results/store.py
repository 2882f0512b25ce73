"""The output folder of a run: which folder belongs to which clip, which clips are done, and what can go wrong there."""

import errno
import glob
import hashlib
import json
import os
import re
import shutil
import tempfile
import unicodedata
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palpate.common.files import as_json, file_sha256, read_file
from palpate.common.output import ForeignFile, is_unchanged
from palpate.common.settings import fits

TABLE, OVERLAY, RECORD = "parameters.csv", "overlay.mp4", "run.json"
INTERACTIONS, FIT, FIELDS = "interactions.csv", "fit.png", "fields.npz"
CALIBRATED, REPORT, RESULTS = "calibrated.csv", "forces.json", "results.json"
"""Files of a clip's folder. The record is written last: with it a folder is complete."""
PAGES = "index.html", "page.html"
"""Page of a batch in its folder, and of a clip in that clip's; listed as this program's by `palpate.common.output`."""
BAGS = {"ros1": "forces.bag", "ros2": "forces.mcap"}
"""Bags of --bag there, by the version of ROS."""
MARKER = ".unfinished-results"
"""Mark that tells a hidden folder of ours from a user's."""
PROGRAM = "infer.py"
"""Value of `program` in run.json; another program's results are never replaced."""


class OutputError(ValueError):
    """The results can't be written; the message says where, why and what to do."""


@contextmanager
def writing(folder: Path) -> Generator[None]:
    """Turn a file-system error met while writing into one sentence.

    Raises:
        OutputError: the folder is full, read-only, otherwise not writable, or a user's file is in the way.
    """
    try:
        yield
    except ForeignFile as error:
        raise OutputError(str(error)) from error
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            problem = "the output folder is full; free some space"
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            problem = "the output folder can't be written; change its permissions"
        else:
            reason = error.strerror or str(error) or type(error).__name__
            problem = f"writing failed ({reason}); check the output folder"
        raise OutputError(f"{folder}: {problem} or choose another --output.") from error


def make_output(output: Path) -> None:
    """Make an output folder where there is none.

    Raises:
        OutputError: a file is in its place, or it can't be made.
    """
    with writing(output):
        if output.exists() and not output.is_dir():
            raise OutputError(f"{output}: is a file; give a folder as --output.")
        output.mkdir(parents=True, exist_ok=True)


def safe_name(name: str) -> str:
    """Return a clip's name as a folder name that every file system takes.

    Letters of any script stay; what file systems forbid becomes `_`; a name over 120 bytes of UTF-8 is cut and ends
    with a hash of the whole.
    """
    normal = unicodedata.normalize("NFC", name)
    clean = re.sub(r'[\x00-\x1f\x7f<>:"/\\|?*\ud800-\udfff]', "_", normal).strip(" .") or "clip"
    if len(clean.encode()) <= 120:
        return clean
    return clean.encode()[:111].decode("utf-8", "ignore").rstrip(" .") + "-" + _mark(normal)


def _mark(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:8]


class ResultStore:
    """The output folder of a run: which folder belongs to which clip, and which clips are done.

    Args:
        output: the folder; made when it is not there.

    Raises:
        OutputError: it can't be made or written.
    """

    def __init__(self, output: Path) -> None:
        self.output = output
        self._taken: dict[str, str] = {}
        make_output(output)
        with writing(output):
            tempfile.TemporaryFile(dir=output).close()

    def folder(self, name: str, origin: Path) -> Path:
        """Return the folder of the clip `name` that comes from `origin`.

        Its name, or its name with a mark when another clip's results, or anything that is not ours, are there.

        Raises:
            OutputError: both are taken, or a killed run's results can't be moved to their place.
        """
        source = str(origin.resolve())
        plain = safe_name(name)
        names = (plain, f"{plain}-{_mark(source)}")
        with writing(self.output):
            for name in names:
                if name.casefold() not in self._taken:
                    settle(self.output / name)
        owners = {name: self._owner(name) for name in names}
        for wanted in (source, ""):
            for name, owner in owners.items():
                if owner == wanted:
                    self._taken[name.casefold()] = source
                    return self.output / name
        raise OutputError(f"{self.output / name}: holds something else; move it away or choose another --output.")

    def _owner(self, name: str) -> str | None:
        """Return the source whose results the folder `name` holds; empty when it is free, None when it holds something
        else."""
        folder = self.output / name
        if name.casefold() in self._taken:
            return self._taken[name.casefold()]
        if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
            return ""
        return _source(folder)


def is_up_to_date(folder: Path, fingerprint: str, files: Iterable[str], *, overwrite: bool) -> bool:
    """Return whether a clip's folder holds these files as results of exactly this already; False where they are to be
    replaced.

    Args:
        folder: of a clip, as `ResultStore.folder` gave it.
        fingerprint: of the results to come.
        files: names of the results to come.
        overwrite: whether the user asked to replace earlier ones.

    Raises:
        OutputError: results made otherwise are there and `overwrite` is not given, or one of the files was changed.
    """
    record = read_record(folder)
    same = record.get("fingerprint") == fingerprint
    if same and not overwrite and all(_is_as_recorded(folder / name) for name in {*files, *own_files(folder)}):
        return True
    if record and not same and not overwrite:
        problem = f"{folder}: holds results of other settings, of another model or version, or of frames that"
        raise OutputError(f"{problem} have changed since; --overwrite replaces them, or choose another --output.")
    _require_untouched(folder, files)
    return False


def read_record(folder: Path) -> dict[str, Any]:
    """Return the run record of a clip's folder; empty where there is none, it is damaged or not one of this
    program's."""
    try:
        record = json.loads(read_file(folder / RECORD))
    except (OSError, ValueError, RecursionError):
        return {}
    kinds = {"fingerprint": str, "input": dict, "files": dict, "statuses": dict, "contacts": dict}
    return record if fits(record, kinds) and record.get("program") == PROGRAM else {}


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Store a run record, and the hashes of the files that lie next to it, as JSON."""
    names = (name for name in sorted(os.listdir(folder)) if name not in (MARKER, RECORD))
    files = {name: file_sha256(folder / name) for name in names if (folder / name).is_file()}
    document = as_json({**record, "files": files}, indent=2, ensure_ascii=False)
    # File names that are not UTF-8 become \udcXX, which is JSON's own way to write them.
    (folder / RECORD).write_bytes((document + "\n").encode("utf-8", "backslashreplace"))


def own_files(folder: Path) -> list[str]:
    """Return names of the files that the folder's record says this program wrote, its own last; none without a
    record."""
    files = read_record(folder).get("files", {})
    return [*(name for name in files if os.path.basename(name) == name), RECORD] if files else []


def partial_folder(folder: Path) -> Path:
    """Make the hidden folder next to the final one in which this process gathers the results."""
    partial = folder.with_name(f".{folder.name}.partial-{os.getpid()}")
    partial.mkdir()
    (partial / MARKER).touch()
    return partial


def publish(partial: Path, folder: Path) -> None:
    """Move finished results to their place: a new folder whole, else file by file; a user's files there stay.

    Earlier results that have no successor are removed. The record goes last, and what is cut off in between
    is finished by `settle`.

    Raises:
        OutputError: a file there has one of our names but is not as this program wrote it.
    """
    if not read_record(folder):
        os.replace(partial, folder)
        (folder / MARKER).unlink()
        return
    written = own_files(partial)
    new = [name for name in written if (partial / name).exists()]
    _require_untouched(folder, new)
    for name in own_files(folder):
        if name not in written and _is_as_recorded(folder / name):
            (folder / name).unlink()
    for name in new:
        os.replace(partial / name, folder / name)
    shutil.rmtree(partial)


def settle(folder: Path) -> None:
    """Clear what this process or a killed one left next to this folder; what it had finished is moved to its place.

    Raises:
        OutputError: see `publish`.
    """
    for partial in folder.parent.glob(f".{glob.escape(folder.name)}.partial-*"):
        if not (partial / MARKER).is_file() or _is_running(partial.name.rpartition("-")[2]):
            continue
        if own_files(partial) and (not folder.exists() or _source(partial) == _source(folder)):
            publish(partial, folder)
        else:
            shutil.rmtree(partial)


def _source(folder: Path) -> str | None:
    """Return the input of our results in a folder; None where there are none."""
    return read_record(folder).get("input", {}).get("path")


def _is_as_recorded(path: Path) -> bool:
    """Return whether a file is as the record next to it has it."""
    if path.name == RECORD:
        return path.is_file()
    return is_unchanged(path, [read_record(path.parent).get("files", {}).get(path.name)])


def _require_untouched(folder: Path, names: Iterable[str]) -> None:
    """Raise an OutputError where a file of these names is neither missing, empty, nor as the folder's record has it."""
    for path in (folder / name for name in names):
        lost = not os.path.lexists(path) or (path.is_file() and path.stat().st_size == 0)
        if not lost and not _is_as_recorded(path):
            raise OutputError(f"{path}: is not as this program wrote it; move it away or choose another --output.")


def _is_running(process: str) -> bool:
    """Return whether another process with this id lives."""
    try:
        os.kill(int(process), 0)
    except (ProcessLookupError, ValueError, OverflowError):
        return False
    except OSError:
        return True
    return int(process) != os.getpid()
