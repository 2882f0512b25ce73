"""Clouds of points from files: PLY and PCD, in text or binary, and NumPy's."""

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


def read_cloud(path: Path) -> np.ndarray:
    """Points of a file, by its ending: .ply, .pcd, or .npz with `points` or a single array.

    Points that are not finite, as sensors write them where they see nothing, are left out.

    Returns:
        Shape [m, 3], float64, in the file's own unit.

    Raises:
        InputError: it can't be read, or holds no point.
    """
    give = "give a PLY, PCD (text or binary) or NPZ file of x, y, z"
    try:
        content = read_file(path, MOST_BYTES)
        points = np.asarray(_READERS[path.suffix.lower()](content), np.float64)
        points = points[np.isfinite(points).all(axis=1)] if points.ndim == 2 else points
    except ImportError as error:
        raise InputError(f"{printable(path)} is a PLY file, which needs meshio; install 'palpate[robot]'.") from error
    except Exception as error:  # those of the libraries on broken content have nothing in common
        raise InputError(
            f"{printable(path)} can't be read as a cloud ({reason(error).rstrip('.')}); {give}."
        ) from error
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"{printable(path)} holds no cloud but {points.shape} numbers; {give}.")
    return points


def _ply(content: bytes) -> np.ndarray:
    from meshio.ply._ply import read_buffer

    count = re.search(rb"element\s+vertex\s+(\d+)", content[:MOST_HEAD])
    if count is None or int(count[1]) > len(content):  # memory is taken for as many
        raise ValueError("no vertices, or more than the file has bytes for")
    return read_buffer(io.BytesIO(content)).points


def _pcd(content: bytes) -> np.ndarray:
    found = re.search(rb"(?:^|\n)DATA (\w+)\r?\n", content[:MOST_HEAD])
    if found is None or found[1] not in (b"ascii", b"binary"):
        raise ValueError("it is compressed or has no line DATA")
    lines = content[: found.start()].decode().splitlines()
    head = {words[0]: words[1:] for line in lines if (words := line.split())}
    stored, fields = io.BytesIO(content[found.end() :]), head["FIELDS"]
    counts = [int(count) for count in head.get("COUNT", ["1"] * len(fields))]
    starts = np.cumsum([0, *counts])
    if found[1] == b"ascii":
        return np.loadtxt(stored, usecols=[int(starts[fields.index(axis)]) for axis in "xyz"], ndmin=2)
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(head["TYPE"], head["SIZE"], strict=True)]
    layout = np.dtype([(f"{at}", *each) for at, each in enumerate(zip(kinds, counts, strict=True))])
    rows: np.ndarray = np.frombuffer(stored.getvalue(), layout, int(head["POINTS"][0]))
    return np.stack([rows[str(fields.index(axis))].reshape(-1) for axis in "xyz"], axis=1)


def _npz(content: bytes) -> np.ndarray:
    found = np.load(io.BytesIO(content), allow_pickle=False)
    return found["points" if len(found.files) != 1 else found.files[0]]


_READERS = {".ply": _ply, ".pcd": _pcd, ".npz": _npz}
