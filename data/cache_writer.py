"""Writes a prepared clip frame by frame into a folder of .npy arrays; memory does not grow with the clip's length."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data.prepared import STATUSES, PreparedFrame

if TYPE_CHECKING:
    from data.clip import ClipStream

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
        self._offsets = [(0, 0, 0)]
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

    def finish(self, stream: ClipStream) -> None:
        """Write what is known only at the clip's end."""
        for name, (dtype, shape) in RAGGED.items():
            self._append(f"mesh_{name}", dtype, np.empty((0, *shape)))
        for name, (dtype, shape, _) in COLUMNS.items():
            column = np.array(self._rows[name], dtype).reshape(len(self._rows[name]), *shape)
            np.save(self.folder / f"{name}.npy", column)
        np.save(self.folder / "mesh_offsets.npy", np.array(self._offsets, np.int64))
        described = {
            "name": stream.source.name,
            "fps": stream.source.fps,
            "scale": stream.scale,
            "metric": stream.metric,
            "sources": stream.sources,
            "camera": dataclasses.asdict(stream.camera),
            "warnings": stream.source.warnings,
            "details": self._details,
        }
        (self.folder / "clip.json").write_text(json.dumps(described, indent=1), encoding="utf-8")

    def _append(self, name: str, dtype: type, rows: np.ndarray) -> None:
        if name not in self._files:
            self._files[name] = NpyAppender(self.folder / f"{name}.npy", dtype, rows.shape[1:])
        self._files[name].extend(rows)
