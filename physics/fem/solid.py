"""A body of tetrahedra with linear or quadratic shape functions, and the sums over its elements.

N nodes, E elements of n nodes (4 linear, 10 quadratic) with Q quadrature points, straight-sided. Quadratic elements are
what nearly incompressible material and bending need: linear ones lock.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csr_array

EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Corners between which nodes 4 … 9 of a quadratic tetrahedron lie."""
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
"""Corners of a tetrahedron's faces, anticlockwise seen from outside."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Nodes, elements, and the gradients of the shape functions at rest; made by `make_solid`."""

    rest: np.ndarray
    """Places of the nodes at rest, shape [N, 3] [m]."""
    elements: np.ndarray
    """Node indices, corners first, shape [E, n]."""
    gradients: np.ndarray
    """Gradients of the shape functions by place at rest, shape [E, Q, n, 3] [1/m]."""
    weights: np.ndarray
    """Volume at rest of each quadrature point, shape [E, Q] [m³]."""

    @property
    def volumes(self) -> np.ndarray:
        """Volumes of the elements at rest, shape [E] [m³]."""
        return self.weights.sum(axis=1)

    @cached_property
    def faces(self) -> np.ndarray:
        """Corner nodes of the surface's triangles, anticlockwise seen from outside, shape [S, 3]."""
        return outer_faces(self.elements)

    def deformation(self, displacement: np.ndarray) -> np.ndarray:
        """Deformation gradient F at every quadrature point, shape [E, Q, 3, 3].

        Args:
            displacement: displacement of the nodes from rest, shape [N, 3] [m].
        """
        moved = displacement[self.elements]
        return np.matmul(moved.transpose(0, 2, 1)[:, None], self.gradients) + np.eye(3)

    def forces(self, stress: np.ndarray) -> np.ndarray:
        """Nodal forces that a stress takes to hold, shape [N, 3] [N].

        Args:
            stress: first Piola–Kirchhoff at every quadrature point, shape [E, Q, 3, 3] [Pa].
        """
        return self.gather(self.element_forces(stress))

    def element_forces(self, stress: np.ndarray) -> np.ndarray:
        """Return the elastic forces before the elements are added up, shape [E, n, 3]."""
        weighted = self.weights[..., None, None] * stress
        return np.matmul(self.gradients, weighted.transpose(0, 1, 3, 2)).sum(axis=1)

    def gather(self, by_element: np.ndarray) -> np.ndarray:
        """Sums over elements of what each has at its nodes, [E, n, 3] → [N, 3]."""
        where, nodes = self.elements.ravel(), len(self.rest)
        parts = by_element.reshape(-1, 3).T
        return np.stack([np.bincount(where, part, minlength=nodes) for part in parts], axis=1)

    def stiffness(self, tangent: np.ndarray) -> csr_array:
        """Global matrix of a law's tangents, shape [3N, 3N], rows and columns node by node.

        Args:
            tangent: ∂stress/∂F at every quadrature point, shape [E, Q, 9, 9] [Pa].
        """
        stressed = np.matmul(self.weights[..., None, None] * tangent, self._strains)
        return self._assembled(np.matmul(self._strains.transpose(0, 1, 3, 2), stressed).sum(axis=1))

    @cached_property
    def _strains(self) -> np.ndarray:
        """F, row by row, per displacement of an element's nodes, shape [E, Q, 9, 3n]."""
        elements, points, nodes, _ = self.gradients.shape
        found = np.zeros((elements, points, 3, 3, nodes, 3))
        for axis in range(3):
            found[:, :, axis, :, :, axis] = self.gradients.transpose(0, 1, 3, 2)
        return found.reshape(elements, points, 9, 3 * nodes)

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Block to which each pair of an element's nodes adds, and the blocks' columns and row ends."""
        count, nodes = len(self.rest), self.elements.shape[1]
        pairs = np.repeat(self.elements, nodes, axis=1).ravel() * count + np.tile(self.elements, (1, nodes)).ravel()
        blocks, which = np.unique(pairs, return_inverse=True)
        ends = np.searchsorted(blocks, count * np.arange(count + 1))
        return which, blocks % count, ends

    def _assembled(self, by_element: np.ndarray) -> csr_array:
        which, columns, ends = self._pattern
        nodes, count = self.elements.shape[1], 3 * len(self.rest)
        entries = by_element.reshape(-1, nodes, 3, nodes, 3).transpose(2, 4, 0, 1, 3).reshape(9, -1)
        blocks = np.stack([np.bincount(which, part, minlength=len(columns)) for part in entries], axis=1)
        return bsr_array((blocks.reshape(-1, 3, 3), columns, ends), shape=(count, count)).tocsr()


def outer_faces(elements: np.ndarray) -> np.ndarray:
    """Triangles of one tetrahedron only, anticlockwise seen from outside, shape [S, 3].

    Args:
        elements: corners of the tetrahedra first, shape [E, n].
    """
    faces = elements[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


def make_solid(nodes: np.ndarray, tetrahedra: np.ndarray, *, order: int = 1) -> Solid:
    """A body at rest.

    Args:
        nodes: corners, shape [N, 3] [m].
        tetrahedra: indices of their four corners, shape [E, 4], with det(x₁ - x₀, x₂ - x₀, x₃ - x₀) > 0.
        order: order of the shape functions, 1 or 2; 2 adds nodes in the middle of the edges, after those given.

    Raises:
        ValueError: another order; indices that don't fit; an element that is inverted or flat.
    """
    nodes, tetrahedra = np.asarray(nodes, np.float64), np.asarray(tetrahedra, np.int64)
    if order not in (1, 2):
        raise ValueError(f"order is {order}; give 1 (linear) or 2 (quadratic).")
    if nodes.ndim != 2 or nodes.shape[1] != 3 or not np.isfinite(nodes).all():
        raise ValueError(f"nodes have shape {nodes.shape}; give finite places of shape [N, 3].")
    if tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4 or not len(tetrahedra):
        raise ValueError(f"tetrahedra have shape {tetrahedra.shape}; give indices of shape [E, 4], one at least.")
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(nodes):
        raise ValueError(f"tetrahedra name nodes {tetrahedra.min()} to {tetrahedra.max()} of {len(nodes)}.")
    if len(bad := np.flatnonzero(qualities(nodes, tetrahedra) < 1e-9)):
        problem = f"{len(bad)} of {len(tetrahedra)} tetrahedra are inverted or flat, number {bad[0]} first;"
        raise ValueError(f"{problem} mesh anew.")
    edges = nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]
    slopes = np.linalg.inv(edges).transpose(0, 2, 1)
    barycentric = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)  # of the four coordinates
    volumes = np.linalg.det(edges) / 6
    if order == 1:
        return Solid(nodes, tetrahedra, barycentric[:, None], volumes[:, None])
    sides = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    pairs, which = np.unique(sides, axis=0, return_inverse=True)
    elements = np.concatenate([tetrahedra, len(nodes) + which.reshape(-1, 6)], axis=1)
    inner = (5 - np.sqrt(5)) / 20  # four points, exact for polynomials of degree 2
    points = np.full((4, 4), inner) + (1 - 4 * inner) * np.eye(4)
    by_corner = (4 * points - 1)[None, :, :, None] * barycentric[:, None]
    ends = EDGES.T, EDGES.T[::-1]
    by_edge = 4 * sum(points[:, a][None, :, :, None] * barycentric[:, None, b] for a, b in ends)
    nodes, gradients = np.concatenate([nodes, nodes[pairs].mean(axis=1)]), np.concatenate([by_corner, by_edge], axis=2)
    return Solid(nodes, elements, gradients, np.repeat(volumes[:, None] / 4, 4, axis=1))


def qualities(nodes: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Six volumes over the longest edge's cube, shape [E]: √½ where regular, 0 where flat, negative where inverted."""
    corners = np.asarray(nodes)[tetrahedra]
    longest = np.linalg.norm(corners[:, EDGES[:, 0]] - corners[:, EDGES[:, 1]], axis=2).max(axis=1)
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    return np.divide(volume, longest**3, out=np.zeros_like(volume), where=longest > 0)
