"""A prepared clip in memory, with what samples are made of: the twin of `data.clip_cache.PreparedClip`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from data.cache_writer import COLUMNS, LEVELS
from data.prepared import STATUSES, PreparedFrame
from physics.mesh import Mesh


class CollectedClip:
    """Prepared frames of a short clip; attributes as of `PreparedClip`, arrays with frames first."""

    numbers: np.ndarray
    times: np.ndarray
    usable: np.ndarray
    consecutive: np.ndarray
    vertex: np.ndarray
    normal: np.ndarray
    noise: np.ndarray
    displacement: np.ndarray
    backward: np.ndarray
    rigid: np.ndarray
    track_start: np.ndarray
    track_position: np.ndarray

    def __init__(self, name: str, fps: float, frames: Iterable[PreparedFrame], *, onsets_only: bool = False) -> None:
        """Collect frames; their pictures and full-size labels are dropped.

        Args:
            name: of the clip.
            fps: frames a second.
            frames: the clip's frames.
            onsets_only: keep no depth, and the mesh only of the frame where a run of contact begins, which is all that
                fitting the runs needs: a minute of contact has a gigabyte of meshes.
        """
        self.name, self.fps = name, fps
        self._depths: list[np.ndarray] = []
        self._meshes: list[Mesh | None] = []
        self.details: dict[int, str] = {}
        """Why frames are not `ok`, or what is wrong with a contact, by index."""
        rows: dict[str, list] = {column: [] for column in COLUMNS}
        for prepared in frames:
            geometry = prepared.geometry
            kept = geometry is not None and (not onsets_only or prepared.track_start == prepared.frame.index)
            self._meshes.append(geometry.mesh if kept else None)
            if prepared.detail:
                self.details[len(self._meshes) - 1] = prepared.detail
            if not onsets_only:
                self._depths.append(np.rint(prepared.depth * LEVELS).astype(np.uint16))
            given = {
                "numbers": prepared.frame.number,
                "times": prepared.frame.time_s,
                "codes": STATUSES.index(prepared.status),
                "usable": prepared.has_depth,
            }
            for column, (_, shape, missing) in COLUMNS.items():
                value = given.get(column, getattr(prepared, column, None))
                value = getattr(geometry, column, None) if value is None else value
                rows[column].append(np.full(shape, missing) if value is None else value)
        for column, (dtype, shape, _) in COLUMNS.items():
            setattr(self, column, np.array(rows[column], dtype).reshape(len(self._meshes), *shape))
        self.status = [STATUSES[code] for code in self.codes]
        self.contact = self.codes == STATUSES.index("ok")

    def __len__(self) -> int:
        return len(self._meshes)

    def depth(self, index: int) -> np.ndarray:
        """z of a frame, shape [h, w], float32 in [0, 1] [scene units]; 0 = invalid."""
        return (self._depths[index] / np.float32(LEVELS)).astype(np.float32)

    def mesh(self, index: int) -> Mesh:
        """Tissue mesh of a frame in contact.

        Raises:
            IndexError: the frame is not in contact, or its mesh wasn't kept.
        """
        mesh = self._meshes[index]
        if mesh is None:
            raise IndexError(f"Frame {index} of {self.name} is {self.status[index]} and has no mesh here.")
        return mesh
