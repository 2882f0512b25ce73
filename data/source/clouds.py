"""Clouds of points from files: PLY, in text or binary, binary PCD, and NumPy's."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from palpate.common.files import read_file
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.table import reason

MOST_BYTES = 2**28
"""Largest file of a cloud; a million points with normals and colours are smaller [bytes]."""
MOST_HEAD = 2**14
"""Of a file, in which it says what follows [bytes]."""


def read_cloud(path: Path, shape: tuple[int, ...] = (3,)) -> np.ndarray:
    """Points of a file, by its ending: .ply, .pcd, or .npz with `points`.

    Args:
        path: the file.
        shape: of a point, or of all that is known of one.

    Returns:
        Shape [m, *shape], float64, in the file's own unit; not seen = NaN. A cloud may be all NaN, or m = 0.

    Raises:
        InputError: it can't be read, or holds points of another shape, or followed points of which none is finite.
    """
    try:
        points = np.asarray(_READERS[path.suffix.lower()](read_file(path, MOST_BYTES)), np.float64)
        if points.shape[1:] != shape or (len(shape) > 1 and not np.isfinite(points).any()):
            raise ValueError(f"its points have shape {points.shape}, not {('m', *shape)}, or none is finite")
    except Exception as error:  # those of the libraries on broken content have nothing in common
        why = reason(error).rstrip(".")
        said = f"can't be read as points ({why}); give a PLY, binary PCD or NPZ file of x, y, z"
        raise InputError(f"{printable(path)} {said}.") from error
    return points


def _ply(content: bytes) -> np.ndarray:
    from trimesh.exchange.ply import load_ply  # takes a second

    empty = re.search(rb"\nelement vertex 0\s", content[:MOST_HEAD])  # of which load_ply reads no vertices
    return np.empty((0, 3)) if empty else load_ply(io.BytesIO(content))["vertices"]


def _pcd(content: bytes) -> np.ndarray:
    found = re.search(rb"(?:^|\n)DATA binary\r?\n", content[:MOST_HEAD])
    if found is None:
        raise ValueError("it has no line DATA binary")
    lines = content[: found.start()].decode().splitlines()
    head, stored = {line.split()[0]: line.split()[1:] for line in lines if line.split()}, content[found.end() :]
    columns, counts = [head["FIELDS"].index(axis) for axis in "xyz"], [int(count) for count in head["COUNT"]]
    kinds = map("<{}{}".format, map(str.lower, head["TYPE"]), head["SIZE"])
    layout = [(str(at), *each) for at, each in enumerate(zip(kinds, counts, strict=True))]
    rows: np.ndarray = np.frombuffer(stored, np.dtype(layout), int(head["POINTS"][0]))
    return np.stack([rows[str(column)].reshape(-1) for column in columns], axis=1)


def _npz(content: bytes) -> np.ndarray:
    return np.load(io.BytesIO(content), allow_pickle=False)["points"]


_READERS = {".ply": _ply, ".pcd": _pcd, ".npz": _npz}
