"""A body's closed surface, and how far from it places are: a grid of signed distances."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
SIZES = (2e-3, 2.0)
"""Longest side of a body [m]."""
MOST_VOXELS = 2_000_000


def measure(path: Path, unit: str, radius: float) -> dict[str, Any]:
    """Signed distances from a closed surface on a grid that goes on two radii of the tip beyond its box.

    Close to the surface they are those from the tangent plane, of second order in the step. What lies behind openings
    narrower than four steps counts as body.

    Args:
        path: of the surface, whose lengths are in `unit`.
        unit: one of `UNITS`.
        radius: of the tip [m].

    Returns:
        low, the grid's first place, shape [3] [m]; step [m], a third of a radius or more; and values, negative within,
        shape [X, Y, Z] [m].

    Raises:
        InputError: the file can't be read, is not closed, or has the size of another unit.
    """
    import trimesh  # takes a second, and is needed the first time alone

    try:
        mesh = trimesh.load_mesh(path)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        size = float(mesh.apply_scale(UNITS[unit]).extents.max())
    except Exception as error:  # each format's reader raises its own
        raise InputError(f"{printable(path)} is no mesh of triangles; save it as PLY, STL or OBJ.") from error
    if not SIZES[0] <= size <= SIZES[1]:
        likely = "mm" if size > SIZES[1] else "m"
        raise InputError(f"{printable(path)} is {size:.3g} m long in unit {unit}; give `unit: {likely}`.")
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise InputError(f"{printable(path)} is not closed, so that nothing lies within; fill its holes.")
    if mesh.volume < 0:
        mesh.invert()
    low, high = mesh.bounds[0] - 2 * radius, mesh.bounds[1] + 2 * radius
    step = max(radius / 3, float((np.prod(high - low) / MOST_VOXELS) ** (1 / 3)))
    fine = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, step, max_iter=20))
    grid = low + step * np.moveaxis(np.indices(np.ceil((high - low) / step).astype(int) + 1), 0, -1)
    wall = np.zeros(grid.shape[:3], bool)
    wall[tuple(((fine.vertices - low) / step).round().astype(int).T)] = True
    wall = ndimage.binary_dilation(wall, np.ones((3, 3, 3)))
    nearest = np.zeros(wall.shape, int)
    nearest[wall] = KDTree(fine.vertices).query(grid[wall], workers=-1)[1]
    nearest = nearest[tuple(ndimage.distance_transform_edt(~wall, return_distances=False, return_indices=True))]
    away, outside = grid - fine.vertices[nearest], ndimage.label(~wall)[0]
    far = np.where(outside == outside[0, 0, 0], 1, -1) * np.linalg.norm(away, axis=-1)
    signed = np.where(wall, (away * fine.vertex_normals[nearest]).sum(axis=-1), far)
    return {"low": low, "step": step, "values": signed.astype(np.float32)}
