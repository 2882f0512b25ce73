"""A body's closed surface, and how far from it places are: a grid of signed distances."""

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError


def _read(path: Path, unit: str) -> Any:
    """Read a mesh of trimesh, in metres; raises as `measure`."""
    import trimesh

    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):  # readers chat
            mesh = trimesh.load_mesh(path)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces())
        size = float(mesh.extents.max())
    except Exception as error:  # each format's reader raises its own
        raise InputError(f"{printable(path)} is no mesh of triangles; save it as PLY, STL or OBJ.") from error
    units = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
    # Longest sides of bodies, 2 mm to 2 m.
    likely = [each for each, metres in units.items() if 2e-3 <= size * metres <= 2.0]
    if unit not in likely:
        problem = f"is {size * units[unit]:.3g} m long in unit {unit}"
        raise InputError(f"{printable(path)} {problem}; give `unit: {' or '.join(likely) or 'm'}`.")
    return mesh.apply_scale(units[unit])


def measure(path: Path, unit: str, radius: float) -> dict[str, Any]:
    """Measure signed distances from a closed surface on a grid that goes on two radii of the tip beyond its box.

    The body is all that the outside can't reach, so triangles within it, of hollows and overlapping bodies, don't
    count. The way that triangles face counts only where the body is thinner than a few steps. Close to the surface
    distances are those from the nearest triangle's plane, of second order in the step. Openings narrower than four
    steps count as closed. An instrument pushes tissue before it and doesn't pierce it. So distances are -1000 m in the
    middle between two sides that face away from each other, and half a radius around.

    Args:
        path: of the surface, whose lengths are in `unit`.
        unit: m, cm or mm.
        radius: of the tip [m].

    Returns:
        low, the grid's first place, shape [3] [m]; step [m], a third of a radius or more; and values, negative within,
        shape [X, Y, Z] [m].

    Raises:
        InputError: the file can't be read, is not closed, has the size of another unit, or is too large for the tip.
    """
    import trimesh  # takes a second, and is needed the first time alone

    mesh = _read(path, unit)
    low, high = mesh.bounds[0] - 2 * radius, mesh.bounds[1] + 2 * radius
    step = max(radius / 3, float((np.prod(high - low) / 2_000_000) ** (1 / 3)))
    if step > 1.5 * radius:
        problem = f"is {mesh.extents.max():.3g} m long, too large beside a tip of {radius:g} m"
        raise InputError(f"{printable(path)} {problem}; cut out the part that it works in.")
    fine = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, step, max_iter=20))
    places, normals = fine.triangles_center, fine.face_normals

    def cells(points: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(((points - low) / step).round().astype(int).T)

    def around(points: np.ndarray) -> np.ndarray:
        found = np.zeros(grid.shape[:3], bool)
        found[cells(points)] = True
        return ndimage.binary_dilation(found, np.ones((3, 3, 3)))

    grid = low + step * np.moveaxis(np.indices(np.ceil((high - low) / step).astype(int) + 1), 0, -1)
    outside = ndimage.label(~around(np.concatenate([fine.vertices, places])))[0]
    outside = outside == outside[0, 0, 0]
    # Of the two sides of each triangle the one that is closer to the outside; those of which none is close lie within.
    inwards = ndimage.distance_transform_edt(~outside)
    before, behind = (inwards[cells(places + side * 2 * step * normals)] for side in (1, -1))
    thin = np.maximum(before, behind) <= 1
    # Share of triangles with free space on both sides, from which on a surface with a rim is no body's.
    if (np.bincount(mesh.edges_unique_inverse) % 2).any() and thin.mean() > 0.01:
        raise InputError(f"{printable(path)} is not closed, so that nothing lies within; fill its holes.")
    normals = normals * np.where(thin, np.sign(fine.volume), np.sign(behind - before))[:, None]
    outer = np.minimum(before, behind) <= 2
    places, normals = places[outer], normals[outer]
    wall = around(np.concatenate([fine.triangles[outer].reshape(-1, 3), places]))
    nearest = np.zeros(wall.shape, int)
    nearest[wall] = KDTree(places).query(grid[wall], workers=-1)[1]
    nearest = nearest[tuple(ndimage.distance_transform_edt(~wall, return_distances=False, return_indices=True))]
    away = grid - places[nearest]
    far = np.linalg.norm(away, axis=-1)
    signed = np.where(wall, (away * normals[nearest]).sum(axis=-1), np.where(outside, far, -far))
    # Slope of the distance below which the nearest place of the surface leaps to another side of the body.
    through = (signed < step) & (np.linalg.norm(np.gradient(signed, step), axis=0) < 0.6)
    if through.any():
        signed[step * ndimage.distance_transform_edt(~through) < radius / 2] = -1e3
    return {"low": low, "step": step, "values": signed.astype(np.float32)}
