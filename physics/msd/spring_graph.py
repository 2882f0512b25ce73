"""A mesh sorted by its distance from the load, for meshes that aren't grids and for parameters that vary over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from physics.mesh import Mesh
from physics.msd.reference import NORM_GUARD


class SpringGraph(NamedTuple):
    """The part of a mesh that springs connect with the load, nearest first; n vertices, s springs.

    Watched vertices that nothing connects with the load come last, so that they too have a place: they never move.
    """

    order: np.ndarray
    """Index of each vertex in the mesh, those of the load first, shape [n], int64."""
    springs: np.ndarray
    """Positions in ``order``, shape [s, 2], int64."""
    rest: np.ndarray
    """Rest vectors, shape [s, 3] [scene units]."""
    length: np.ndarray
    """Rest lengths, shape [s] [scene units]."""
    vertex_count: np.ndarray
    """Vertices within radius 0, 1, …, shape [R]; the last entry is all that are connected."""
    spring_count: np.ndarray
    """Springs with an end within radius 0, 1, …, shape [R]; the last entry is s."""
    position: np.ndarray
    """Where each vertex of the mesh is in ``order``, -1 for those that are left out, shape [N], int64."""

    def prefixes(self, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of vertices and springs that each step computes, shapes [T], for radii of shape [T]."""
        radii = np.minimum(radii, len(self.vertex_count) - 1)
        return self.vertex_count[radii], self.spring_count[radii]


def spring_graph(mesh: Mesh, loaded: np.ndarray, watched: np.ndarray, reach: int, dtype: np.dtype) -> SpringGraph:
    """Sort the mesh around the loaded vertices.

    Args:
        mesh: the mesh.
        loaded: vertices that are pressed or gripped, shape [P].
        watched: vertices that must have a place, shape [M].
        reach: largest radius that any step is computed to.
        dtype: float32 or float64.
    """
    count = len(mesh.vertices)
    first, second = mesh.springs.T.astype(np.int64)
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count)).tocsr()
    # One spring further than moved vertices: those still pull.
    distance = dijkstra(links, directed=False, indices=loaded, unweighted=True, limit=reach + 1, min_only=True)
    connected = np.argsort(distance, kind="stable")[: np.isfinite(distance).sum()]
    order = np.concatenate([connected, np.unique(watched[~np.isfinite(distance[watched])])])
    nearer = np.minimum(distance[first], distance[second])
    spring_order = np.argsort(nearer, kind="stable")[: np.isfinite(nearer).sum()]
    # A spring that leaves the sorted part has only unmoved ends, so it pulls at nothing that is computed.
    spring_order = spring_order[np.isfinite(np.maximum(distance[first], distance[second])[spring_order])]
    position = np.full(count, -1, dtype=np.int64)
    position[order] = np.arange(len(order))
    vertices = mesh.vertices.astype(dtype)
    rest = vertices[second[spring_order]] - vertices[first[spring_order]]
    levels = np.arange(int(distance[connected[-1]]) + 1)
    return SpringGraph(
        order=order,
        springs=np.stack([position[first[spring_order]], position[second[spring_order]]], axis=1),
        rest=rest,
        length=np.sqrt((rest * rest).sum(axis=1) + dtype.type(NORM_GUARD)),
        vertex_count=np.searchsorted(distance[connected], levels, side="right"),
        spring_count=np.searchsorted(nearer[spring_order], levels, side="right"),
        position=position,
    )
