"""Prepared clips on disk: a folder of memory-mapped .npy arrays and a clip.json, under a key of all it depends on.

They are written frame by frame: memory does not grow with a clip's length.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import re
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Generator, Mapping
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from data.depth.preset import resolve_model
from data.masks.sources import mask_model
from data.prepared import STATUSES, PreparedFrame
from data.settings import PrepareSettings
from data.source.camera import Camera, clip_camera
from data.source.layout import InputError
from physics.mesh import Mesh
from physics.provenance import code_digest

LEVELS = 65535
"""Depth is stored in 16 bits; 8-bit levels are a subset (65535 = 255·257)."""
RAGGED = {
    "vertices": (np.float32, (3,)),
    "rim": (np.bool_, ()),
    "pixels": (np.int16, (2,)),
    "triangles": (np.int32, (3,)),
    "springs": (np.int32, (2,)),
}
"""Mesh arrays, those of all frames in contact joined: type and shape of an entry."""
COUNTED = ("vertices", "triangles", "springs")
"""Columns of the offsets into them."""
COLUMNS: dict[str, tuple[type, tuple[int, ...], float]] = {
    "numbers": (np.int64, (), 0),
    "times": (np.float64, (), math.nan),
    "codes": (np.uint8, (), 0),
    "usable": (np.bool_, (), False),
    "consecutive": (np.bool_, (), False),
    "vertex": (np.int32, (), -1),
    "normal": (np.float32, (3,), math.nan),
    "tool_point": (np.float32, (3,), math.nan),
    "tissue_point": (np.float32, (3,), math.nan),
    "distance": (np.float32, (), math.nan),
    "pixel": (np.int16, (2,), -1),
    "tool_pixel": (np.int16, (2,), -1),
    "touching": (np.bool_, (), False),
    "noise": (np.float32, (), math.nan),
    "displacement": (np.float32, (3,), math.nan),
    "backward": (np.float32, (3,), math.nan),
    "rigid": (np.float32, (3,), math.nan),
    "track_start": (np.int32, (), -1),
    "track_position": (np.float32, (3,), math.nan),
}
"""Per-frame arrays (see PreparedFrame and FrameGeometry): type, shape of an entry, value that stands for none."""
HASHED_BYTES = 64 * 2**20
"""Models up to this size are known by their content, larger ones by size and time of change."""
STALE_SECONDS = 86400.0
"""Unfinished folders untouched for longer are left over from a killed process."""
NOT_STORED = (
    ("depth", "threads"),
    ("depth", "device"),
    ("geometry", "force_direction"),
    ("geometry", "min_displacement"),
)
"""Settings that a prepared clip does not depend on: where a model runs, and what samples make of the geometry."""


def cache_key(path: Path, settings: PrepareSettings) -> str:
    """Digest of a clip's files (name, size, time of change), the settings, the models and the code version.

    Raises:
        InputError: a model or a camera can't be found.
    """
    fields = dataclasses.asdict(settings)
    for group, name in NOT_STORED:
        fields[group].pop(name)
    document = {
        "files": _file_states(path),
        "settings": fields,
        "camera": repr(clip_camera(path, settings.layout)),
        "models": [_model_state(model, reading) for model, reading in require_models(settings)],
        "code": code_digest("preparation"),
    }
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8", "surrogatepass")).hexdigest()[:24]


def _file_states(path: Path) -> list[list[Any]]:
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    states = ((file, file.stat()) for file in files)
    return [[os.fspath(file.relative_to(path.parent)), state.st_size, state.st_mtime_ns] for file, state in states]


def require_models(settings: PrepareSettings) -> list[tuple[Path, str]]:
    """Depth and mask model files that the settings name, each with what says how to read it.

    Raises:
        InputError: a file or preset does not exist.
    """
    models: list[tuple[Path, str]] = []
    if settings.depth.source != "stored":
        kind = "photometric" if settings.depth.source == "auto" else settings.depth.source
        model, preset = resolve_model(kind, settings.depth.model, settings.depth.preset)
        models.append((model, preset.identity))
    segmentation = mask_model(settings.masks)
    if segmentation is not None:
        beside = segmentation.with_suffix(".yaml")
        models.append((segmentation, beside.read_text(encoding="utf-8") if isfile(beside) else ""))
    return models


def _model_state(model: Path, reading: str) -> list[Any]:
    """State of a model; opening it would cost seconds where the cache has the clip."""
    state = model.stat()
    if state.st_size > HASHED_BYTES:
        return [reading, state.st_size, state.st_mtime_ns]
    # A fresh checkout changes the time of the models that come with it, so what is small goes by its content.
    return [reading, hashlib.sha256(model.read_bytes()).hexdigest()]


class PreparedClip:
    """A prepared clip, read from the cache; its large arrays stay on disk until they are used.

    Per-frame arrays, first axis F; what they mean is said at PreparedFrame and FrameGeometry, and a frame without the
    thing holds NaN, -1 or False.
    """

    numbers: np.ndarray
    times: np.ndarray
    codes: np.ndarray
    usable: np.ndarray
    consecutive: np.ndarray
    vertex: np.ndarray
    normal: np.ndarray
    tool_point: np.ndarray
    tissue_point: np.ndarray
    distance: np.ndarray
    pixel: np.ndarray
    tool_pixel: np.ndarray
    touching: np.ndarray
    noise: np.ndarray
    displacement: np.ndarray
    backward: np.ndarray
    rigid: np.ndarray
    track_start: np.ndarray
    track_position: np.ndarray

    def __init__(self, folder: Path, path: Path) -> None:
        """
        Raises:
            OSError, ValueError, KeyError: the entry is damaged.
        """
        self.folder, self.path = folder, path
        described = json.loads((folder / "clip.json").read_text(encoding="utf-8"))
        self.name: str = described["name"]
        self.fps: float = described["fps"]
        self.scale: float = described["scale"]
        """Depth that is z = 1 [unit of the depth source]; not a number where no frame had depth."""
        self.metric: bool = described["metric"]
        """Whether `scale` is in metres."""
        self.sources: dict[str, str] = described["sources"]
        """Where `depth` and `masks` came from, in a word each."""
        self.camera = Camera(**described["camera"] | {"distortion": tuple(described["camera"]["distortion"])})
        """Intrinsics of the grid."""
        self.warnings: list[str] = described["warnings"]
        self.details = {int(index): detail for index, detail in described["details"].items()}
        """Why frames are not `ok`, or what is wrong with a contact, by index."""
        for name in COLUMNS:
            setattr(self, name, np.load(folder / f"{name}.npy"))
        self.status = [STATUSES[code] for code in self.codes]
        """Status of every frame."""
        self.contact = self.codes == STATUSES.index("ok")
        """Whether a frame is in contact, shape [F]."""
        self.labels = _mapped(folder / "labels.npy")
        """Label maps, shape [F, h, w], uint8."""
        self._levels = _mapped(folder / "depth.npy")
        self._meshes = {name: _mapped(folder / f"mesh_{name}.npy") for name in RAGGED}
        self._offsets = np.load(folder / "mesh_offsets.npy")

    def __len__(self) -> int:
        return len(self.codes)

    def __reduce__(self) -> tuple[type, tuple[Path, Path]]:
        # Worker processes map the files themselves instead of receiving the arrays.
        return PreparedClip, (self.folder, self.path)

    @property
    def counts(self) -> dict[str, int]:
        """Number of frames by status, all statuses."""
        found = Counter(self.status)
        return {status: found[status] for status in STATUSES}

    def depth(self, index: int) -> np.ndarray:
        """z of a frame, shape [h, w], float32 in [0, 1] [scene units]; 0 = invalid."""
        return (self._levels[index] / np.float32(LEVELS)).astype(np.float32)

    def mesh(self, index: int) -> Mesh:
        """Tissue mesh of a frame in contact.

        Raises:
            IndexError: the frame is not in contact.
        """
        if not self.contact[index]:
            raise IndexError(f"Frame {index} of {self.name} is {self.status[index]}; only contact has a mesh.")
        parts = {}
        for name in RAGGED:
            column = COUNTED.index(name) if name in COUNTED else COUNTED.index("vertices")
            start, stop = self._offsets[index : index + 2, column]
            parts[name] = np.array(self._meshes[name][start:stop])
        parts["pixels"] = parts["pixels"].astype(np.int32)
        return Mesh(**parts, grid_shape=self.labels.shape[1:])


def _mapped(path: Path) -> np.ndarray:
    """A memory-mapped array; an empty file can't be mapped and is read."""
    try:
        return np.load(path, mmap_mode="r")
    except ValueError:
        return np.load(path)


class NpyAppender:
    """An .npy file that grows along its first axis."""

    def __init__(self, path: Path, dtype: type, shape: tuple[int, ...]) -> None:
        """
        Args:
            path: file to write.
            dtype: type of its entries.
            shape: shape without the growing axis.
        """
        self._file = path.open("wb")
        self._dtype, self._shape = np.dtype(dtype), shape
        self.length = 0
        self._write_header()

    def extend(self, rows: np.ndarray) -> None:
        """Append rows, shape [n, *shape]."""
        rows = np.ascontiguousarray(rows, self._dtype)
        if rows.shape[1:] != self._shape:
            raise ValueError(f"expected rows of shape {self._shape}, got {rows.shape[1:]}.")
        self._file.write(rows.tobytes())
        self.length += len(rows)

    def close(self) -> None:
        """Write the final length into the header and close the file."""
        if not self._file.closed:
            # numpy leaves room in the header for the first axis to grow.
            self._file.seek(0)
            self._write_header()
            self._file.close()

    def _write_header(self) -> None:
        header = {"descr": self._dtype.str, "fortran_order": False, "shape": (self.length, *self._shape)}
        np.lib.format.write_array_header_1_0(self._file, header)


class CacheWriter:
    """Collects the frames of one clip into an unfinished folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: dict[str, list[Any]] = {name: [] for name in COLUMNS}
        self._offsets: list[tuple[int, ...]] = [(0, 0, 0)]
        self._details: dict[int, str] = {}
        self._files: dict[str, NpyAppender] = {}

    def __enter__(self) -> CacheWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        for file in self._files.values():
            file.close()

    def add(self, prepared: PreparedFrame) -> None:
        """Append the next frame."""
        levels = np.rint(prepared.depth * LEVELS).astype(np.uint16)
        self._append("depth", np.uint16, levels[None])
        self._append("labels", np.uint8, prepared.labels[None])
        if prepared.detail:
            self._details[len(self._offsets) - 1] = prepared.detail
        values = {
            "numbers": prepared.frame.number,
            "times": prepared.frame.time_s,
            "codes": STATUSES.index(prepared.status),
            "usable": prepared.has_depth,
        }
        geometry = prepared.geometry
        if geometry is not None:
            for name in RAGGED:
                self._append(f"mesh_{name}", RAGGED[name][0], getattr(geometry.mesh, name))
        for name in COLUMNS:
            value = values.get(name, getattr(prepared, name, None))
            value = getattr(geometry, name, None) if value is None else value
            self._rows[name].append(np.full(COLUMNS[name][1], COLUMNS[name][2]) if value is None else value)
        sizes = (0, 0, 0) if geometry is None else tuple(len(getattr(geometry.mesh, name)) for name in COUNTED)
        self._offsets.append(tuple(a + b for a, b in zip(self._offsets[-1], sizes, strict=True)))

    def finish(self, description: Mapping[str, Any]) -> None:
        """Write what is known only at the clip's end: see `data.clip.ClipStream.description`."""
        for name, (dtype, shape) in RAGGED.items():
            self._append(f"mesh_{name}", dtype, np.empty((0, *shape)))
        for name, (dtype, shape, _) in COLUMNS.items():
            column = np.array(self._rows[name], dtype).reshape(len(self._rows[name]), *shape)
            np.save(self.folder / f"{name}.npy", column)
        np.save(self.folder / "mesh_offsets.npy", np.array(self._offsets, np.int64))
        described = {**description, "details": self._details}
        (self.folder / "clip.json").write_text(json.dumps(described, indent=1), encoding="utf-8")

    def _append(self, name: str, dtype: type, rows: np.ndarray) -> None:
        if name not in self._files:
            self._files[name] = NpyAppender(self.folder / f"{name}.npy", dtype, rows.shape[1:])
        self._files[name].extend(rows)


class CacheEntry:
    """Where a prepared clip lies in the cache."""

    def __init__(self, cache_dir: Path, name: str, key: str) -> None:
        self.cache_dir = cache_dir
        readable = re.sub(r"[^A-Za-z0-9_-]", "_", name)
        self.folder = cache_dir / f"{readable[:40]}-{key}"

    def load(self, path: Path) -> PreparedClip | None:
        """The prepared clip, or None where there is none; a damaged entry is removed."""
        if not self.folder.is_dir():
            return None
        try:
            return PreparedClip(self.folder, path)
        except (OSError, ValueError, KeyError, TypeError):
            shutil.rmtree(self.folder, ignore_errors=True)
            return None

    @contextlib.contextmanager
    def writer(self) -> Generator[CacheWriter]:
        """A writer into a folder of its own, removed again unless it is finished.

        Raises:
            InputError: the cache can't be written (full, read-only).
        """
        try:
            self.cache_dir.mkdir(parents=True, exist_ok=True)
            remove_stale(self.cache_dir)
            folder = self.cache_dir / f".tmp-{uuid.uuid4().hex}"
            folder.mkdir()
            try:
                with CacheWriter(folder) as writer:
                    yield writer
                self._publish(folder)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError as error:
            why = error.strerror or error
            raise InputError(f"{self.cache_dir} can't be written ({why}); free space or change the cache.") from error

    def _publish(self, folder: Path) -> None:
        try:
            os.rename(folder, self.folder)
        except OSError:
            # Another process has finished the same entry first; it is the same, so ours goes.
            if not self.folder.is_dir():
                raise


def remove_stale(cache_dir: Path) -> None:
    """Remove unfinished folders that nobody has written to for a day."""
    for folder in cache_dir.glob(".tmp-*"):
        with contextlib.suppress(FileNotFoundError):  # another process may be removing it as well
            newest = max(entry.stat().st_mtime for entry in (folder, *folder.iterdir()))
            if time.time() - newest > STALE_SECONDS:
                shutil.rmtree(folder, ignore_errors=True)
