"""A body's surface as it was scanned, carried by coarser tetrahedra (Frank 2010, section IV-A).

Vertices move as the shape functions of the element that they lie in, or closest to, say; forces on them reach the nodes
by the same shares, so that both do the same work.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.spatial import KDTree

from palpate.physics.fem import Solid
from palpate.physics.fem.solid import EDGES
from palpate.physics.fem.surface import areas, closest, even_shares, nearest
from palpate.physics.mesh import crosses, holding


@dataclass(frozen=True, eq=False)
class Skin:
    """Surface of V vertices and F triangles on a body of N nodes; made by `cover`."""

    body: Solid
    vertices: np.ndarray
    """Vertices at rest, shape [V, 3] [m]."""
    triangles: np.ndarray
    """Indices of corners, anticlockwise seen from outside, shape [F, 3]."""
    shares: csr_array
    """Shares of the nodes' displacements in a vertex's, shape [V, N]; rows add up to 1."""

    @cached_property
    def _creases(self) -> KDTree | None:
        """Places along the sharp edges at rest and along the rims of holes; None where there are none."""
        import trimesh  # takes a second

        mesh = trimesh.Trimesh(self.vertices, self.triangles, process=False)
        lone = mesh.edges_unique[np.bincount(mesh.edges_unique_inverse) != 2]
        sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > np.arccos(0.8)]
        ends = self.vertices[np.concatenate([lone, sharp])]
        if not len(ends):
            return None
        along = (np.arange(8) + 0.5)[:, None, None] / 8  # eight places on every edge
        return KDTree((ends[:, 0] + along * (ends[:, 1] - ends[:, 0])).reshape(-1, 3))

    def from_creases(self, places: np.ndarray) -> np.ndarray:
        """Return the distance of places at rest [P, 3] from the closest sharp edge or rim, shape [P] [m]."""
        return np.full(len(places), np.inf) if self._creases is None else self._creases.query(places)[0]

    def moved(self, displacement: np.ndarray) -> np.ndarray:
        """Return vertices where the nodes are displaced [N, 3], shape [V, 3] [m]."""
        return self.vertices + self.shares @ displacement

    def pressed(self, place: np.ndarray, radius: float, force: np.ndarray) -> np.ndarray:
        """Return nodal forces of a force that is spread as 1 - (r/R)² around a place, as `Press.on_patch` spreads it.

        Args:
            place: on the surface at rest, shape [3] [m].
            radius: R [m].
            force: shape [3] [N].

        Returns:
            shape [N, 3] [N].

        Raises:
            ValueError: fewer than three vertices lie within the radius.
        """
        within = np.count_nonzero(np.linalg.norm(self.vertices - place, axis=1) < radius)
        if within < 3:
            problem = f"{within} vertices lie within {radius:g} m of the contact {np.round(place, 4)};"
            raise ValueError(f"{problem} give a contact on the surface, a wider tool or a finer surface.")
        # Integrated over the triangles: sums over vertices alone would shift and widen the patch.
        shares = even_shares(4)
        corners = self.vertices[self.triangles]
        apart = np.linalg.norm(np.einsum("sk,fkx->fsx", shares, corners) - place, axis=2) / radius
        pressure = (areas(corners)[:, None] * np.maximum(1 - apart**2, 0.0)) @ shares
        weights = np.bincount(self.triangles.ravel(), pressure.ravel(), minlength=len(self.vertices))
        return (self.shares.T @ (weights / weights.sum()))[:, None] * force


def cover(body: Solid, vertices: np.ndarray, triangles: np.ndarray, held: np.ndarray | None = None) -> Skin:
    """Couple a surface to a body that fills it.

    Args:
        body: linear or quadratic.
        vertices: shape [V, 3] [m].
        triangles: shape [F, 3]; turned over where they face inwards as a whole.
        held: vertices that stand still, as those below a floor where the body is cut off, shape [V], bool.
    """
    element, _ = holding(body.rest[body.elements[:, :4]], vertices, 24)
    matrix = shapes_at(body, element, vertices)
    if held is not None:
        matrix = diags_array(np.where(held, 0.0, 1.0)) @ matrix
    one, two, three = vertices[triangles].transpose(1, 0, 2)
    volume = float(np.einsum("fi,fi->f", one, np.cross(two, three)).sum())
    return Skin(body, vertices, triangles if volume >= 0 else triangles[:, ::-1], csr_array(matrix))


def shapes_at(body: Solid, element: np.ndarray, points: np.ndarray) -> csr_array:
    """Return shape functions of a body's nodes at points [P, 3], each in its element [P] or close to it, shape [P, N].

    Where steps to a place off a curved element lead away, it is the closest that they came to.
    """
    nodes = body.elements[element]
    corners, quadratic = body.rest[nodes[:, :4]], nodes.shape[1] == 10
    inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    place = best = np.tile(np.eye(4)[0], (len(points), 1))
    least = np.full(len(points), np.inf)
    # The first step leads to the place in a straight element, four more to that in a curved one.
    for _ in range(6 if quadratic else 2):
        beyond = points - np.einsum("pn,pni->pi", _shapes(place) if quadratic else place, body.rest[nodes])
        off = np.linalg.norm(beyond, axis=1)
        best, least = np.where((off < least)[:, None], place, best), np.minimum(off, least)
        change = np.einsum("pj,pji->pi", beyond, inverse)
        place = place + np.concatenate([-change.sum(axis=1, keepdims=True), change], axis=1)
    index = np.repeat(np.arange(len(points)), nodes.shape[1]), nodes.ravel()
    return csr_array(((_shapes(best) if quadratic else best).ravel(), index), shape=(len(points), len(body.rest)))


def _shapes(place: np.ndarray) -> np.ndarray:
    """Return the quadratic shape functions at barycentric places [V, 4], shape [V, 10]."""
    return np.concatenate([place * (2 * place - 1), 4 * place[:, EDGES[:, 0]] * place[:, EDGES[:, 1]]], axis=1)


def _normals(corners: np.ndarray) -> np.ndarray:
    """Return outward normals of triangles [F, 3, 3], shape [F, 3]."""
    normals = crosses(corners)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


@dataclass(frozen=True, eq=False)
class Match:
    """Places of a surface that belong to P points."""

    face: np.ndarray
    """Triangle, shape [P]."""
    shares: np.ndarray
    """Barycentric, shape [P, 3]."""
    normal: np.ndarray
    """Normal of the triangle, outwards, shape [P, 3]."""
    distance: np.ndarray
    """Distance of the points along the normal, or along their sight, positive outside, shape [P] [m]."""
    apart: np.ndarray
    """Distance of the points from the places, shape [P] [m]."""

    @classmethod
    def of(cls, points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> "Match":
        """Match points [P, 3] with the closest places on triangles [F, 3] of vertices [V, 3]."""
        corners = vertices[triangles]
        face, shares = nearest(points, corners)
        normal = _normals(corners)[face]
        beyond = points - np.einsum("pk,pkx->px", shares, corners[face])
        return cls(face, shares, normal, (beyond * normal).sum(axis=1), np.linalg.norm(beyond, axis=1))

    @classmethod
    def along(cls, points: np.ndarray, sights: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> "Match":
        """Match points with the places where their lines of sight meet the surface, beginning at the closest triangle.

        Args:
            points: shape [P, 3] [m].
            sights: unit vectors from the points towards what saw them, shape [P, 3].
            vertices: shape [V, 3] [m].
            triangles: shape [F, 3].

        Returns:
            with a distance that is not a number where a line meets no triangle.
        """
        corners = vertices[triangles]
        normals, close = _normals(corners), 1e-9 * float(np.ptp(vertices))
        face, shares = np.zeros(len(points), np.int64), np.zeros((len(points), 3))
        distance, apart = np.zeros(len(points)), np.full(len(points), np.inf)
        places, left = points.copy(), np.arange(len(points))
        for _ in range(5):
            face[left] = nearest(places[left], corners)[0]
            where, normal, sight = corners[face[left]], normals[face[left]], sights[left]
            steep = (sight * normal).sum(axis=1)
            steep = np.where(np.abs(steep) < 0.1, 0.1, steep)  # less steeply a plane isn't followed to
            distance[left] = ((points[left] - where[:, 0]) * normal).sum(axis=1) / steep
            places[left] = points[left] - distance[left, None] * sight
            shares[left] = closest(places[left], where)
            apart[left] = np.linalg.norm(places[left] - np.einsum("pk,pkx->px", shares[left], where), axis=1)
            left = left[apart[left] > close]
        distance[left] = np.nan
        return cls(face, shares, normals[face], distance, apart)

    def at(self, triangles: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return values of the vertices [V, …] at the matched places, shape [P, …]."""
        return np.einsum("pk,pk...->p...", self.shares, values[triangles[self.face]])
