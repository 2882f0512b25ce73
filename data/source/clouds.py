"""Clouds of points from files: PLY, in text or binary, and NumPy's."""

import io
import re
from pathlib import Path

import numpy as np

from palpate.common.files import read_file
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.table import reason


def read_cloud(path: Path, shape: tuple[int, ...] = (3,)) -> np.ndarray:
    """Points of a file, by its ending: .ply, or .npz with `points`.

    Args:
        path: the file.
        shape: shape of a point, or of all its numbers.

    Returns:
        Shape [m, *shape], float64, in the file's own unit; not seen = NaN. A cloud may be all NaN, or m = 0.

    Raises:
        InputError: it can't be read, or holds points of another shape, or tracked points of which none is finite.
    """
    try:
        # Largest file of a cloud; a million points with normals and colours are smaller [bytes].
        read = {".ply": _ply, ".npz": _npz}[path.suffix.lower()]
        points = np.asarray(read(read_file(path, 2**28)), np.float64)
        if points.shape[1:] != shape or (len(shape) > 1 and not np.isfinite(points).any()):
            raise ValueError(f"its points have shape {points.shape}, not {('m', *shape)}, or none is finite")
    except Exception as error:  # those of the libraries on broken content have nothing in common
        problem = f"can't be read as points ({reason(error).rstrip('.')})"
        raise InputError(f"{printable(path)} {problem}; give a PLY or NPZ file of x, y, z.") from error
    return points


def _ply(content: bytes) -> np.ndarray:
    from trimesh.exchange.ply import load_ply  # takes a second

    # Part of a file in which it says what follows [bytes].
    empty = re.search(rb"\nelement vertex 0\s", content[: 2**14])  # of which load_ply reads no vertices
    return np.empty((0, 3)) if empty else load_ply(io.BytesIO(content))["vertices"]


def _npz(content: bytes) -> np.ndarray:
    return np.load(io.BytesIO(content), allow_pickle=False)["points"]
