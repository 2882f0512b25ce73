"""Tetrahedra from an incomplete surface, as Frank 2010 (section IV-A) and Spillmann 2006 make them.

Cells of a grid whose centre lies inside are filled with five tetrahedra each, and the nodes of their surface are drawn
to the triangles as far as no element becomes bad. Inside is what most of six rays along the axes say, by how often they
cross the surface: no orientation is needed, and a hole or an inner wall misleads only the rays through it.

Where an instrument presses, tetrahedra are divided by bisection of longest edges (Rivara 1984; in space Rivara & Levin
1992). One is halved through the middle of its longest edge, and so are all others around that edge. Those of which it
is not the longest edge are halved first through their own, so that the mesh stays one without hanging nodes.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.spatial import KDTree

from palpate.physics.fem.solid import EDGES, FACES, outer_faces, qualities
from palpate.physics.fem.surface import areas, nearest, rows_needed

Floor = tuple[int, float] | None
"""Axis across a plane that a body stands on, and where along it [m]."""
Longest = Callable[[np.ndarray], np.ndarray]
"""Largest length of edges around places [P, 3], shape [P], positive [m]."""
GROWTH = 0.5
"""Growth of edges' length by the distance from their centre of refinement."""


def around(places: np.ndarray, radius: float, edge: float) -> Longest:
    """Edges that crowd where an instrument presses.

    Args:
        places: centres of the refinement, shape [K, 3] [m].
        radius: radius within which edges have their smallest length [m].
        edge: smallest length, which grows by GROWTH farther off [m].
    """
    return lambda there: edge + GROWTH * np.maximum(KDTree(places).query(there)[0] - radius, 0.0)


def refine(nodes: np.ndarray, tetrahedra: np.ndarray, longest: Longest) -> tuple[np.ndarray, np.ndarray]:
    """Divide tetrahedra until their edges are short enough.

    Args:
        nodes: shape [N, 3] [m].
        tetrahedra: corners, shape [E, 4], of positive volume.
        longest: largest length of edges by the elements' middle.

    Returns:
        nodes, those given first; corners of the tetrahedra, of positive volume.
    """
    while True:
        sides = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
        found, which = np.unique(sides, axis=0, return_inverse=True)
        pairs = np.asarray(found, np.int64)
        which = which.reshape(-1, len(EDGES))
        length = np.linalg.norm(np.diff(nodes[pairs], axis=1)[:, 0], axis=1)
        # Among edges as long as each other up to rounding, all tetrahedra are to choose the same.
        rank = np.empty(len(pairs), np.int64)
        rank[np.lexsort([np.arange(len(pairs)), np.round(length / length.max(), 9)])] = np.arange(len(pairs))
        own = which[np.arange(len(which)), rank[which].argmax(axis=1)]
        wanted = length[own] > longest(nodes[tetrahedra].mean(axis=1))
        if not wanted.any():
            return nodes, tetrahedra
        while True:  # tetrahedra around a halved edge are halved before, if not by it
            halved = np.zeros(len(pairs), bool)
            halved[own[wanted]] = True
            around = halved[which].any(axis=1)
            if (around == wanted).all():
                break
            wanted = around
        blocked = np.zeros(len(pairs), bool)
        blocked[which[which != own[:, None]]] = True
        halved &= ~blocked
        middle = len(nodes) + np.cumsum(halved) - 1
        some = halved[own]
        ends, old = pairs[own[some]], tetrahedra[some]
        parts = [np.where(old == end[:, None], middle[own[some]][:, None], old) for end in ends.T]
        nodes = np.concatenate([nodes, nodes[pairs[halved]].mean(axis=1)])
        tetrahedra = np.concatenate([tetrahedra[~some], *parts])


def fill_cells(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and tetrahedra of some cells of a grid.

    Args:
        inside: mask of cells, shape [I, J, K].

    Returns:
        the nodes' grid coordinates, shape [N, 3], int64; corners of the tetrahedra, shape [5·cells, 4].
    """
    cells, shape = np.argwhere(inside), tuple(np.array(inside.shape) + 1)
    at = np.ravel_multi_index(tuple((cells[:, None] + np.indices((2, 2, 2)).reshape(3, 8).T).transpose(2, 0, 1)), shape)
    even = np.array([[0, 4, 2, 1], [6, 2, 4, 7], [5, 1, 7, 4], [3, 1, 2, 7], [1, 4, 2, 7]])
    odd = (even ^ 4)[:, [0, 2, 1, 3]]  # mirrored, so that the diagonals of shared faces agree
    parts = np.where((cells.sum(axis=1) % 2 == 0)[:, None, None], at[:, even], at[:, odd])
    used, corners = np.unique(parts.reshape(-1, 4), return_inverse=True)
    return np.stack(np.unravel_index(used, shape), axis=1), corners.reshape(-1, 4)


def box(lengths: tuple[float, float, float], cells: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A block from the origin on.

    Args:
        lengths: lengths of the sides [m].
        cells: along them.

    Returns:
        nodes, shape [N, 3] [m]; corners of the tetrahedra, shape [E, 4].
    """
    places, corners = fill_cells(np.ones(cells, bool))
    return places * (np.asarray(lengths) / np.asarray(cells)), corners


WORST = 0.05
"""Lowest quality of an element that drawing leaves (`qualities`; a lattice's are 0.35 to 0.71)."""


class NoBody(ValueError):
    """A surface that no body can be made from; the message says why, and what to do."""


@dataclass(frozen=True, eq=False)
class Meshed:
    """Tetrahedra that fill a surface."""

    nodes: np.ndarray
    """Shape [N, 3] [m]."""
    tetrahedra: np.ndarray
    """Corners, shape [E, 4], of positive volume."""


def mesh_surface(
    vertices: np.ndarray, triangles: np.ndarray, *, cells: int = 16, floor: Floor = None, longest: Longest | None = None
) -> Meshed:
    """Fill a surface.

    Args:
        vertices: shape [V, 3] [m].
        triangles: indices of their corners, shape [F, 3]; in any order, with holes or edges of more than two
            triangles. Where closed parts overlap counts as outside.
        cells: number of the grid's cells along the surface's longest side.
        floor: axis, and the place on it below which the body is cut off, as where it is held. Nodes lie on that plane
            whatever the grid.
        longest: largest length of edges, as in `refine`, once all nodes are drawn onto the surface; elements that keep
            some off it are left out. A round body of coarse straight elements then is smaller, one of curved elements
            (`physics.fem.curved`) isn't. None = nodes may lie off the surface by a tenth of a cell.

    Raises:
        NoBody: shapes that don't fit, no area, nothing enclosed, a floor above all of it.
    """
    vertices, triangles = _checked(vertices, triangles)
    corners = vertices[triangles]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    spacing = float((high - low).max()) / cells
    corners = corners[areas(corners) > 1e-9 * spacing**2]
    if not len(corners):
        raise NoBody("the surface has no triangle with an area; give one that has.")
    if floor is not None and floor[1] > low[floor[0]]:
        if not floor[1] < high[floor[0]] - spacing / 2:
            raise NoBody(f"all of the surface lies below the floor at {floor[1]:g} m; give a lower one, or more cells.")
        low[floor[0]] = floor[1]
    origin, sides, shape = _grid(low, high, spacing)
    centres = origin + sides * (np.moveaxis(np.indices(tuple(shape)), 0, -1) + 0.5)
    samples = rows_needed(corners, spacing)
    inside = _enclosed(corners, centres)
    if not inside.any():
        raise NoBody("the surface encloses nothing; give a closed one, or more cells.")
    if floor is not None:
        inside &= centres[..., floor[0]] > floor[1]
    parts = label(inside)[0]
    # The most cells that hang together.
    places, tetrahedra = fill_cells(parts == 1 + np.bincount(parts.ravel(), minlength=2)[1:].argmax())
    drawn = functools.partial(_drawn, corners=corners, samples=samples, floor=floor)
    nodes = drawn(origin + sides * places, tetrahedra)
    if longest is not None:
        for _ in range(3):  # flat outer elements are left out, and the others drawn anew
            flat = _flat(nodes, tetrahedra)
            if not flat.any() or flat.all():
                break
            kept, left = np.unique(tetrahedra[~flat], return_inverse=True)
            tetrahedra = left.reshape(-1, 4)
            nodes = drawn(nodes[kept], tetrahedra)
        nodes, tetrahedra = refine(nodes, tetrahedra, longest)
        nodes = drawn(nodes, tetrahedra)
    return Meshed(nodes, tetrahedra)


def _checked(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = np.asarray(vertices, np.float64), np.asarray(triangles)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise NoBody(f"vertices of shape {vertices.shape} are no finite places; give [V, 3] in metres.")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles) or triangles.dtype.kind not in "iu":
        raise NoBody(f"triangles of shape {triangles.shape} are none; give [F, 3] indices of vertices.")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise NoBody(f"triangles name vertices {triangles.min()} to {triangles.max()} of {len(vertices)}; give others.")
    return vertices, triangles.astype(np.int64)


def _grid(low: np.ndarray, high: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origin [3] and sides [3] of the cells, and their numbers [3], one more on either side of a box than fill it.

    The box's faces are cells' faces, so that a body with flat sides along the axes keeps its volume: rounding would
    decide which cells are inside where a face goes through their middle. A box thinner than half a cell lies in the
    middle of one.
    """
    span = high - low
    count = np.maximum(np.round(span / spacing), 1)
    sides = np.where(span < spacing / 2, spacing, span / count)
    origin = (low + high) / 2 - sides * (count / 2 + 1)
    return origin, sides, count.astype(int) + 2


def _enclosed(corners: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Mask of cells that more than half of six rays call inside, shape [I, J, K], bool."""
    votes = np.zeros(centres.shape[:3], np.int64)
    sides = centres[1, 1, 1] - centres[0, 0, 0]
    off = sides * [3.1e-4, 1.7e-4, 2.3e-4]  # of the rays from the cells' centres: on the grid they would meet edges
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        order = (axis, one, two)
        grid = np.transpose(centres, (*order, 3))  # along the rays first
        flat = grid[0].reshape(-1, 3)[:, [one, two]] + off[[one, two]]
        depth = grid[:, 0, 0, axis]
        first, second, third = (corners[:, corner][:, [one, two]] for corner in range(3))
        square = _cross(second - first, third - first)
        upright = np.abs(square) > 1e-12 * sides[one] * sides[two]
        below, hits = np.zeros((len(depth), len(flat)), np.int64), np.zeros(len(flat), np.int64)
        step = max(1, 4_000_000 // len(corners))
        for begin in range(0, len(flat), step):
            ray = flat[begin : begin + step, None]
            with np.errstate(divide="ignore", invalid="ignore"):
                v = _cross(ray - first, third - first) / square
                w = _cross(second - first, ray - first) / square
                at, face = np.nonzero((v >= 0) & (w >= 0) & (v + w <= 1) & upright)
            share, other = v[at, face], w[at, face]
            heights = corners[face, 0, axis] * (1 - share - other)
            heights += corners[face, 1, axis] * share + corners[face, 2, axis] * other
            np.add.at(below.T, at + begin, heights[:, None] < depth)
            np.add.at(hits, at + begin, 1)
        found = (below % 2) + ((hits - below) % 2)
        votes += np.transpose(found.reshape(grid.shape[:3]), np.argsort(order))
    return votes > 3


def _flat(nodes: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Mask of outer elements, nearly flat, with all corners on the surface, shape [E], bool.

    They keep their nodes from going where they belong, and without them the body is as it is to be.
    """
    faces = np.sort(tetrahedra[:, FACES].reshape(-1, 3), axis=1)
    _, which, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    bare = (count[which.ravel()] == 1).reshape(-1, 4)
    outer = np.zeros(len(nodes), bool)
    outer[tetrahedra[:, FACES][bare]] = True
    return outer[tetrahedra].all(axis=1) & bare.any(axis=1) & (qualities(nodes, tetrahedra) < 0.1)


def _drawn(nodes: np.ndarray, tetrahedra: np.ndarray, corners: np.ndarray, samples: int, floor: Floor) -> np.ndarray:
    """Nodes with those of the body's surface drawn to the triangles, inner ones to their neighbours."""
    bare = outer_faces(tetrahedra)
    axis, height = (0, -np.inf) if floor is None else floor
    grounded = np.abs(nodes[:, axis] - height) < 1e-9 * np.ptp(nodes)
    outer = np.unique(bare[~grounded[bare].all(axis=1)])
    pairs = np.concatenate([tetrahedra[:, [a, b]] for a in range(4) for b in range(4) if a != b])
    pairs = np.unique(pairs, axis=0)
    neighbours = np.bincount(pairs[:, 0], minlength=len(nodes))

    least = np.minimum(qualities(nodes, tetrahedra) / 2, WORST)
    for _ in range(30):
        sums = [np.bincount(pairs[:, 0], nodes[pairs[:, 1], one], minlength=len(nodes)) for one in range(3)]
        aim = np.stack(sums, axis=1) / neighbours[:, None]
        face, share = nearest(nodes[outer], corners, samples)
        aim[outer] = np.einsum("pk,pkx->px", share, corners[face])
        aim[grounded, axis] = nodes[grounded, axis]
        step = 0.5 * (aim - nodes)
        for _ in range(12):  # an element that becomes bad takes its nodes' steps back by half, in the end all of it
            bad = qualities(nodes + step, tetrahedra) < least
            if not bad.any():
                break
            step[np.unique(tetrahedra[bad])] /= 2
        else:
            step[:] = 0
        nodes = nodes + step
    return nodes


def _cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
