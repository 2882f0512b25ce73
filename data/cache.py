"""Prepared clips on disk: a folder with one file a frame and one for the clip, under a key of all its inputs.

Clips are written frame by frame, so that memory does not grow with their length.
"""

import contextlib
import dataclasses
import json
import math
import os
import re
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from os.path import isdir, isfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from palpate.common.files import all_below, as_json, digest_of, file_sha256
from palpate.common.output import LIST, list_folder, require_own_folder
from palpate.common.provenance import code_digest
from palpate.data.depth.normalise import BUILT_IN
from palpate.data.depth.preset import resolve_model
from palpate.data.masks.sources import mask_source_file
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import clip_camera
from palpate.data.source.layout import InputError, right_beside
from palpate.data.source.lerobot import file_of, span_of
from palpate.physics.mesh import Mesh


def cache_key(path: Path, settings: PrepareSettings, following: Iterable[Path] = ()) -> str:
    """Digest of a clip's files (name, size, time of change), the settings, the models and the code version.

    Args:
        path: frame folder or video file.
        settings: settings of the preparation.
        following: frame folders that continue the first one.

    Raises:
        InputError: a model or a camera can't be found.
    """
    fields = dataclasses.asdict(settings)
    # A prepared clip does not depend on where a model runs, nor on the force's direction of samples.
    for group, name in (("depth", "threads"), ("depth", "device"), ("geometry", "force_direction")):
        fields[group].pop(name)
    beside = filter(None, (right_beside(each, settings.layout) for each in (path, *following)))
    # By their states: opening the models would cost seconds even where the cache has the clip.
    models = ((model.stat(), reading) for model, reading in require_models(settings))
    document = {
        "span": span_of(path),
        "files": [state for each in (path, *following, *beside) for state in _file_states(each)],
        "settings": fields,
        "camera": repr(clip_camera(path, settings.layout)),
        "models": [[reading, state.st_size, state.st_mtime_ns] for state, reading in models],
        "code": code_digest("preparation"),
    }
    return digest_of(document)[:24]


def _file_states(path: Path) -> list[list[Any]]:
    """Name, size and time of change of a clip's files."""
    path = file_of(path)
    files = [file for file in all_below(path) if file.is_file()] if path.is_dir() else [path]
    states = ((file, file.stat()) for file in files)
    return [[os.fspath(file.relative_to(path.parent)), state.st_size, state.st_mtime_ns] for file, state in states]


def require_models(settings: PrepareSettings) -> list[tuple[Path, str]]:
    """Depth and mask model files that the settings name, each with the digest of its conventions.

    Raises:
        InputError: a file or preset does not exist.
    """
    models: list[tuple[Path, str]] = []
    if settings.depth.source not in ("auto", *BUILT_IN):
        model, preset = resolve_model(settings.depth.source, settings.depth.model, settings.depth.preset)
        models.append((model, preset.identity))
    segmentation = mask_source_file(settings.masks)
    if segmentation is not None:
        settings_file = segmentation.with_suffix(".yaml")
        reading = digest_of(_file_states(segmentation)) if segmentation.is_dir() else ""
        models.append((segmentation, file_sha256(settings_file) if isfile(settings_file) else reading))
    return models


@dataclass(eq=False)
class PreparedClip:
    """A prepared clip, read from the cache; depth and meshes stay on disk until they are used.

    Arrays without a description have an entry a frame (first axis F) of the field of that name in PreparedFrame or
    FrameGeometry. A frame without a value holds NaN or -1.
    """

    folder: Path
    """The clip's entry in the cache."""
    path: Path
    """Path of the clip itself."""
    name: str
    """Name of the clip."""
    sources: dict[str, str]
    """Sources of `depth` and `masks`, a word each."""
    size: tuple[int, int]
    """Width and height of its pictures [px]."""
    status: np.ndarray
    contact: np.ndarray
    """Mask of frames in contact, shape [F]."""
    out_of_contact: np.ndarray
    """Mask of frames known to be out of contact, shape [F]."""
    times: np.ndarray
    """Time stamps of the frames, shape [F] [s]."""
    usable: np.ndarray
    """Mask of frames with depth, shape [F]."""
    consecutive: np.ndarray
    vertex: np.ndarray
    normal: np.ndarray
    noise: np.ndarray
    displacement: np.ndarray
    backward: np.ndarray
    rigid: np.ndarray
    track_start: np.ndarray
    track_position: np.ndarray

    def __len__(self) -> int:
        return len(self.status)

    @property
    def counts(self) -> Counter[str]:
        """Number of frames by status."""
        return Counter(self.status.tolist())

    def depth(self, index: int) -> np.ndarray:
        """z of a frame, shape [h, w], float32 in [0, 1] [scene units]; 0 = invalid."""
        with np.load(_frame_file(self.folder, index)) as stored:
            return stored["depth"]

    def labels(self, index: int) -> np.ndarray:
        """Label map of a frame on the grid, shape [h, w], uint8."""
        with np.load(_frame_file(self.folder, index)) as stored:
            return stored["labels"]

    def frame(self, index: int, whole: bool) -> Any:
        """Values of a frame for a contact, named as in `PreparedFrame`; depth and labels are None unless `whole`."""
        depth, labels = (self.depth(index), self.labels(index)) if whole else (None, None)
        same = {name: getattr(self, name)[index] for name in ("out_of_contact", "consecutive", "track_position")}
        known = {"time_s": float(self.times[index]), "in_contact": bool(self.contact[index]), "skipped": ()}
        return SimpleNamespace(**same, **known, depth=depth, labels=labels)

    def mesh(self, index: int) -> Mesh:
        """Tissue mesh of a frame in contact.

        Raises:
            IndexError: the frame is not in contact.
        """
        if not self.contact[index]:
            raise IndexError(f"Frame {index} of {self.name} is {self.status[index]}; only contact has a mesh.")
        with np.load(_frame_file(self.folder, index)) as stored:
            parts: dict[str, Any] = {field.name: stored[field.name] for field in dataclasses.fields(Mesh)}
        parts["grid_shape"] = tuple(parts["grid_shape"].tolist())
        return Mesh(**parts)


class CacheEntry:
    """Place of a prepared clip in the cache."""

    def __init__(self, cache_dir: Path, name: str, key: str) -> None:
        self.cache_dir, self.name = cache_dir, name
        readable = re.sub(r"[^A-Za-z0-9_-]", "_", name)
        self.folder = cache_dir / f"{readable[:40]}-{key}"

    def load(self, path: Path) -> PreparedClip | None:
        """The prepared clip, or None where there is none; a damaged entry is removed."""
        if not isdir(self.folder):  # no entry, or a name that is too long for any folder
            return None
        with contextlib.suppress(OSError):  # a file is missing, or damaged
            require_own_folder(self.folder)
            with np.load(self.folder / "clip.npz") as stored:
                columns = dict(stored)
            sources, (width, height) = json.loads(str(columns.pop("sources"))), columns.pop("size").tolist()
            clip = PreparedClip(self.folder, path, self.name, sources, (width, height), **columns)
            if all(isfile(_frame_file(self.folder, index)) for index in range(len(clip))):
                return clip
        _remove(self.folder)
        return None

    def write(self, frames: Iterable[PreparedFrame], sources: dict[str, str], size: tuple[int, int]) -> None:
        """Write a clip's frames into a folder of its own, which takes its place once they are complete.

        Args:
            frames: all frames of the clip, in order.
            sources, size: fields of `PreparedClip`.

        Raises:
            InputError: the cache can't be written (full, read-only), or something else is in the clip's place.
        """
        columns: dict[str, Any] = defaultdict(list)
        try:
            self.cache_dir.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix=".tmp-", dir=self.cache_dir) as temporary:
                folder = Path(temporary, self.folder.name)
                folder.mkdir()
                for index, prepared in enumerate(frames):
                    mesh = {} if prepared.geometry is None else vars(prepared.geometry.mesh)
                    np.savez(_frame_file(folder, index), depth=prepared.depth, labels=prepared.labels, **mesh)
                    for name, value in _row(prepared).items():
                        columns[name].append(value)
                np.savez(folder / "clip.npz", sources=as_json(sources), size=size, **columns)
                list_folder(folder)
                try:
                    os.rename(folder, self.folder)
                except OSError as error:
                    # Another process may have finished the same entry first; the two are equal, so this one is dropped.
                    if not (self.folder / "clip.npz").is_file():
                        if not os.path.lexists(self.folder):
                            raise
                        problem = "holds files of something else; move it away or change the cache"
                        raise InputError(f"{self.folder} {problem}.") from error
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"{self.cache_dir} can't be written ({reason}); change the cache.") from error


def _remove(folder: Path) -> None:
    """Remove an entry's files, and the folder if nothing else is in it."""
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            own = re.fullmatch(rf"(clip|\d+)\.npz|{re.escape(LIST)}", path.name)
            if own and (path.is_symlink() or not path.is_dir()):
                path.unlink()
        folder.rmdir()


def _frame_file(folder: Path, index: int) -> Path:
    """Path of a frame's file in an entry."""
    return folder / f"{index}.npz"


def _row(prepared: PreparedFrame) -> dict[str, Any]:
    """Values of a frame other than depth, labels and mesh, by the names of PreparedClip's arrays."""
    geometry = prepared.geometry
    same = ("status", "out_of_contact", "consecutive", "displacement", "backward", "rigid", "track_start")
    return {name: getattr(prepared, name) for name in (*same, "track_position")} | {
        "contact": prepared.in_contact,
        "times": prepared.frame.time_s,
        "usable": prepared.has_depth,
        "vertex": -1 if geometry is None else geometry.vertex,
        "normal": np.full(3, np.nan) if geometry is None else geometry.normal,
        "noise": math.nan if geometry is None else geometry.noise,
    }
