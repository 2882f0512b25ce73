"""Quadratic tetrahedra whose outer faces follow a curved surface (isoparametric elements).

The nodes in the middle of the body's outer edges are drawn to the surface. What that does to an element is a
deformation F of its straight twin, by which gradients and volumes change: ∇N ↦ ∇N F⁻¹, V ↦ V det F.
"""

import dataclasses

import numpy as np

from palpate.physics.fem.solid import EDGES, Solid
from palpate.physics.fem.surface import areas, nearest, rows_needed


def curve(solid: Solid, triangles: np.ndarray, fixed: np.ndarray) -> Solid:
    """A body with its outer middles on a surface.

    Args:
        solid: body of straight quadratic elements, its outer corners on the surface.
        triangles: corners of the surface's, shape [F, 3, 3]; those without area don't count [m].
        fixed: nodes that stay, as on a floor that cuts the body off, shape [N], bool.
    """
    count = len(solid.rest)
    bare = np.sort(solid.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.sort(solid.elements[:, EDGES].reshape(-1, 2), axis=1)
    outer = np.isin(edges @ [count, 1], bare @ [count, 1])
    middles = np.unique(solid.elements[:, 4:].ravel()[outer])
    middles = middles[~fixed[middles]]
    spacing = float(np.linalg.norm(np.diff(solid.rest[bare], axis=1), axis=2).mean())
    triangles = triangles[areas(triangles) > 1e-9 * spacing**2]
    face, shares = nearest(solid.rest[middles], triangles, rows_needed(triangles, spacing))
    step = np.zeros_like(solid.rest)
    step[middles] = np.einsum("pk,pkx->px", shares, triangles[face]) - solid.rest[middles]
    for _ in range(6):
        # Where det F is smaller, a middle goes back half of its way.
        crushed = (np.linalg.det(solid.deformation(step)) < 0.3).any(axis=1)
        if not crushed.any():
            break
        step[np.unique(solid.elements[crushed])] /= 2
    else:
        step[:] = 0
    change = solid.deformation(step)
    gradients, weights = np.matmul(solid.gradients, np.linalg.inv(change)), solid.weights * np.linalg.det(change)
    return dataclasses.replace(solid, rest=solid.rest + step, gradients=gradients, weights=weights)
