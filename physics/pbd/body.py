"""Particles and the constraints that join them, in one list that every solver walks along; volumes under sheets."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from palpate.physics.mesh import crosses


class Layout(NamedTuple):
    """Arrays of compiled loops; K constraints with M members in all: distances first, then volumes, then shapes."""

    starts: np.ndarray
    """First member of every constraint and the total, shape [K + 1], int64."""
    members: np.ndarray
    """Particles of the constraints, one after the other, shape [M], int64."""
    rest: np.ndarray
    """Lengths [m] and volumes [m³] at rest, 0 for shapes, shape [K]."""
    offsets: np.ndarray
    """Rest positions of a shape's members from their mean, 0 for others, shape [M, 3] [m]."""
    firsts: np.ndarray
    """First indices of volumes and shapes, shape [2], int64."""


@dataclass(frozen=True, eq=False)
class Body:
    """A sheet or a body of N particles; made by `make_body`."""

    rest: np.ndarray
    """Positions at rest, shape [N, 3], float64 [m]."""
    pinned: np.ndarray
    """Mask of particles that never move, shape [N], bool."""
    edges: np.ndarray
    """Pairs that keep their distance, shape [E, 2]."""
    tetrahedra: np.ndarray
    """Fours that keep their volume, shape [V, 4]; none for a sheet."""
    faces: np.ndarray
    """Triangles of the surface, shape [F, 3]."""
    layout: Layout

    @property
    def count(self) -> int:
        """N."""
        return len(self.rest)

    @cached_property
    def edge(self) -> float:
        """Mean length of edges at rest [m]."""
        return float(self.layout.rest[self.kinds[0]].mean())

    @cached_property
    def averages(self) -> csr_array:
        """Mean over every constraint's particles (Liang 2024, section II-A), shape [K, N]."""
        starts, members = self.layout.starts, self.layout.members
        share = np.repeat(1 / np.diff(starts), np.diff(starts))
        return csr_array((share, members, starts), shape=(len(starts) - 1, self.count))

    @property
    def kinds(self) -> tuple[slice, slice, slice]:
        """Slices of the constraints: distances, volumes and shapes."""
        volumes, shapes = self.layout.firsts.tolist()
        return slice(0, volumes), slice(volumes, shapes), slice(shapes, len(self.layout.rest))

    def inverse_mass(self, gripped: np.ndarray) -> np.ndarray:
        """1, as the paper gives no masses, and 0 for pinned or gripped particles, shape [N].

        Args:
            gripped: particles, shape [G].
        """
        inverse = np.where(self.pinned, 0.0, 1.0)
        inverse[gripped] = 0.0
        return inverse

    def strains(self, points: np.ndarray) -> np.ndarray:
        """Strain of edges, shape [..., E], at positions [..., N, 3] [m]."""
        first, second = self.edges.T
        lengths = np.linalg.norm(points[..., first, :] - points[..., second, :], axis=-1)
        return lengths / self.layout.rest[self.kinds[0]] - 1


def make_body(
    rest: np.ndarray, faces: np.ndarray, tetrahedra: np.ndarray | None = None, *, pinned: np.ndarray | None = None
) -> Body:
    """Join particles: a distance an edge, a volume a tetrahedron, a shape a particle and its neighbours.

    The paper doesn't say which neighbours form a shape: here those along edges. Neighbourhoods on a line have none.

    Args:
        rest: positions at rest, shape [N, 3] [m].
        faces: triangles of a sheet, or of a body's surface, shape [F, 3].
        tetrahedra: tetrahedra of a volume, shape [V, 4]; None = a sheet.
        pinned: mask of particles that never move, shape [N]; None = none.

    Raises:
        ValueError: shapes that don't fit, indices of no particle, numbers that are not finite, edges of zero.
    """
    rest = np.ascontiguousarray(rest, np.float64)
    if rest.ndim != 2 or rest.shape[1] != 3 or not np.isfinite(rest).all():
        raise ValueError(f"rest has shape {rest.shape}; give finite positions, [N, 3].")
    count = len(rest)
    fours = np.empty((0, 4), np.int64) if tetrahedra is None else np.asarray(tetrahedra, np.int64)
    triangles = np.asarray(faces, np.int64)
    for name, cells, width in (("faces", triangles, 3), ("tetrahedra", fours, 4)):
        if cells.ndim != 2 or cells.shape[1] != width or cells.min(initial=0) < 0 or cells.max(initial=-1) >= count:
            raise ValueError(f"{name} has shape {cells.shape}; give [·, {width}], indices of the {count} particles.")
    held = np.zeros(count, bool) if pinned is None else np.asarray(pinned, bool)
    if held.shape != (count,):
        raise ValueError(f"pinned has shape {held.shape}; give one entry a particle, {count}.")
    # Pairs that some triangle or tetrahedron joins, each once.
    edges = [
        triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2),
        fours[:, [0, 1, 0, 2, 0, 3, 1, 2, 1, 3, 2, 3]].reshape(-1, 2),
    ]
    edges = np.unique(np.sort(np.concatenate(edges), axis=1), axis=0)
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    if not (lengths > 0).all():
        raise ValueError("two particles that an edge joins lie in one place; merge them.")
    layout = _layout(rest, edges, fours, lengths)
    return Body(rest, held, edges, fours, triangles, layout)


def _layout(rest: np.ndarray, edges: np.ndarray, tetrahedra: np.ndarray, lengths: np.ndarray) -> Layout:
    corners = rest[tetrahedra]
    volumes = (crosses(corners[:, :3]) * (corners[:, 3] - corners[:, 0])).sum(axis=1) / 6
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    neighbours = np.split(both[:, 1], np.searchsorted(both[:, 0], np.arange(1, len(rest))))
    shapes, offsets = [], []
    for particle, near in enumerate(neighbours):
        members = np.array([particle, *near])
        offset = rest[members] - rest[members].mean(axis=0)
        extent = np.linalg.svd(offset, compute_uv=False)
        # Neighbourhoods on a line have no rotation.
        if len(near) >= 2 and extent[1] > 1e-6 * extent[0]:
            shapes.append(members)
            offsets.append(offset)
    sizes = [2] * len(edges) + [4] * len(tetrahedra) + [len(shape) for shape in shapes]
    plain = 2 * len(edges) + 4 * len(tetrahedra)
    members = np.concatenate([edges.ravel(), tetrahedra.ravel(), *shapes]).astype(np.int64)
    rest_values = np.concatenate([lengths, volumes, np.zeros(len(shapes))])
    offsets, firsts = np.concatenate([np.zeros((plain, 3)), *offsets]), np.cumsum([len(edges), len(tetrahedra)])
    return Layout(np.cumsum([0, *sizes]), members, rest_values, offsets, firsts)


def layered(upper: np.ndarray, faces: np.ndarray, below: np.ndarray, layers: int) -> tuple[np.ndarray, np.ndarray]:
    """Particles and tetrahedra under a surface of n particles: these again in layers below, three in every prism.

    Args:
        upper: the surface's, shape [n, 3] [m].
        faces: its triangles, anticlockwise seen from above, shape [F, 3].
        below: from each particle to the one under it in the lowest layer, shape [n, 3] [m].
        layers: the surface and those below, 2 at least.

    Returns:
        Positions layer after layer, the surface's first, shape [layers·n, 3], and corners of the tetrahedra, shape
        [V, 4]. There are none where a prism would turn over: below a step that leans over, or a sharp bend. The volumes
        of a prism's three add up to a positive one.
    """
    rest = (upper + np.linspace(0, 1, layers)[:, None, None] * below).reshape(-1, 3)
    ordered = np.sort(faces, axis=1)  # the same for all: prisms side by side share the diagonals of their sides
    (one, two, three), lower = ordered.T, ordered.T + len(upper)
    prisms = np.stack([(one, two, three, lower[2]), (one, two, lower[2], lower[1]), (one, *lower)]).transpose(2, 0, 1)
    upright = (crosses(upper[ordered]) * crosses(upper[faces])).sum(axis=1) > 0
    prisms[upright] = prisms[upright][..., [1, 0, 2, 3]]
    tetrahedra = len(upper) * np.arange(layers - 1)[:, None, None, None] + prisms
    volumes = np.linalg.det(rest[tetrahedra[..., 1:]] - rest[tetrahedra[..., :1]]).sum(axis=2)
    return rest, tetrahedra[:, (volumes > 0).all(axis=0)].reshape(-1, 4)
