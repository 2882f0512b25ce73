"""A slab beneath an open surface that one camera sees: its elements crowd where an instrument presses.

How thick tissue is can't be seen, so it is given. The slab lies under the grid mesh around a vertex, its sides along
the contact's normal; it is held at the bottom, at its sides, and, where that is wanted, beyond the tissue's edge.
Tissue that an instrument hides goes on beneath it.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from palpate.physics.fem.meshing import NoBody, box
from palpate.physics.fem.solid import EDGES, Solid, make_solid
from palpate.physics.mesh import Mesh

Cells = tuple[int, int, int]
"""Number along columns, rows and depth."""
Place = tuple[float, float]
"""Column and row [grid px]."""
CELLS = (10, 10, 3)
"""Along columns, rows and depth: 1,500 tetrahedra."""
WIDE = 0.28
"""From the contact to the slab's sides, as a share of the grid's width."""
CROWDED = 3.0
"""How much the cells crowd around the contact: nodes lie at sinh(CROWDED s)/sinh(CROWDED), s even from -1 to 1."""
GROWTH = 1.6
"""Thickness of a layer over that of the one above it."""
DEGREE, LOOSE_DEGREE = 3, 2
"""Of the polynomial in columns and rows by which depth goes on where none is seen; and where that isn't held, since a
higher one bends so far beyond the tissue's edge that a slab folds."""
NEAREST = 4
"""Vertices that tell the rest of a node's depth."""
OUTSIDE = 1.0
"""A node farther from all vertices lies next to the mesh [grid px]."""
SAMPLES = 41
"""Of a patch along a side, to share it out over nodes."""


@dataclass(frozen=True, eq=False)
class Slab:
    """Elements beneath a surface; N nodes, C columns and R rows of them on top.

    Those of quadratic elements lie at corners and between, so that every other column and row holds corners.
    """

    solid: Solid
    """Lengths in scene units."""
    held: np.ndarray
    """Components that don't move, shape [N, 3], bool."""
    top: np.ndarray
    """Nodes of the surface, by column and row, shape [C, R]."""
    columns: np.ndarray
    """Where their columns are, shape [C] [grid px]."""
    rows: np.ndarray
    """Where their rows are, shape [R] [grid px]."""
    place: Place
    """Column and row of the contact [grid px]."""
    order: int = 1
    """Of the elements' shape functions, 1 or 2."""

    @property
    def focal_lengths(self) -> np.ndarray:
        """Of the camera that sees it, along columns and rows, shape [2] [grid px]."""
        rest = self.solid.rest[self.top]
        rays = rest[..., :2] / rest[..., 2:]
        seen = np.array([np.ptp(self.columns), np.ptp(self.rows)])
        return seen / np.array([rays[-1, 0, 0] - rays[0, 0, 0], rays[0, -1, 1] - rays[0, 0, 1]])

    def patch(self, radius: float, place: Place | None = None) -> np.ndarray:
        """Share of every node in a force that is spread as 1 - (r/R)² around a place, shape [N], sum 1.

        Args:
            radius: R [grid px].
            place: its column and row; None = the contact's [grid px].
        """
        column, row = self.place if place is None else place
        way = np.linspace(-radius, radius, SAMPLES)
        across, down = np.meshgrid(column + way, row + way, indexing="ij")
        pressure = np.maximum(1 - np.square(np.hypot(across - column, down - row) / radius), 0.0).ravel()
        shares = pressure @ self.between(np.column_stack([down.ravel(), across.ravel()]))
        return shares / shares.sum()

    def between(self, pixels: np.ndarray) -> csr_array:
        """Weights of the nodes in what places of the surface do, of the elements' order, shape [V, N].

        Args:
            pixels: row and column of each within the slab, shape [V, 2] [grid px].
        """
        found = []
        for grid, at in ((self.columns, pixels[:, 1]), (self.rows, pixels[:, 0])):
            corners = grid[:: self.order]
            cell = np.clip(np.searchsorted(corners, at, side="right") - 1, 0, len(corners) - 2)
            found.append((cell, (at - corners[cell]) / (corners[cell + 1] - corners[cell])))
        (column, right), (row, down) = found
        if self.order == 1:
            across, below = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
            weights = np.stack([one * two for one in (1 - right, right) for two in (1 - down, down)])
            nodes = self.top[column + across[:, None], row + below[:, None]]
        else:
            across, below, weights = _quadratic((column + row) % 2 == 1, right, down)
            nodes = self.top[2 * column + across, 2 * row + below]
        places = np.tile(np.arange(len(pixels)), len(nodes))
        flat = weights.ravel(), (places, nodes.ravel())
        return csr_array(flat, shape=(len(pixels), len(self.solid.rest)))


def _quadratic(odd: np.ndarray, right: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of the quadratic triangles in which places of cells lie, and their weights, shape [6, V] each.

    Args:
        odd: cells whose diagonal goes from the first corner to the last; that of the others goes between the other two,
            as `physics.fem.meshing.box` has it, shape [V], bool.
        right: where in the cell along columns, 0 to 1, shape [V].
        down: along rows.

    Returns:
        steps along columns and rows from the cell's first node, 0 to 2, and weights.
    """
    mirrored = np.where(odd, 1 - right, right)
    second = mirrored + down > 1
    turned = odd ^ second
    # Seen from the corner at the triangle's right angle.
    one, two = np.where(turned, 1 - right, right), np.where(second, 1 - down, down)
    none = 1 - one - two
    start, low = 2 * turned, 2 * second
    middle = np.ones_like(start)
    across = np.stack([start, 2 - start, start, middle, start, middle])
    below = np.stack([low, low, 2 - low, low, middle, middle])
    corners = [share * (2 * share - 1) for share in (none, one, two)]
    return across, below, np.stack([*corners, 4 * none * one, 4 * none * two, 4 * one * two])


def crowded(cells: Cells, place: Place, wide: float, thickness: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of a slab whose cells crowd at a place, in the order of `physics.fem.meshing.box`.

    Args:
        cells: along columns, rows and depth.
        place: column and row of the contact [grid px].
        wide: from there to the sides [grid px].
        thickness: in any unit of length.

    Returns:
        Columns and rows [K, 2], how deep they lie below the surface [K], and which are at a side or the bottom [K].
    """
    shares, _ = box((1.0, 1.0, 1.0), cells)
    pixels = np.add(place, wide * np.sinh(CROWDED * (2 * shares[:, :2] - 1)) / math.sinh(CROWDED))
    below = thickness * (GROWTH ** np.rint(shares[:, 2] * cells[2]) - 1) / (GROWTH ** cells[2] - 1)
    return pixels, below, (shares == 1).any(axis=1) | (shares[:, :2] == 0).any(axis=1)


def layered(corners: np.ndarray, held: np.ndarray, cells: Cells, pixels: np.ndarray, place: Place, order: int) -> Slab:
    """A slab of layers, its corners as `crowded` gives them.

    Args:
        corners: where they are at rest, shape [K, 3].
        held: which of them don't move, shape [K], bool; of other nodes those between two that are held, but for one
            between two sides, which lies inside.
        cells: along columns, rows and depth.
        pixels: columns and rows of the corners, shape [K, 2] [grid px].
        place: column and row of the contact [grid px].
        order: of the elements' shape functions, 1 or 2.

    Raises:
        ValueError: it folds.
    """
    places, tetrahedra = box((1.0, 1.0, 1.0), cells)
    upper = pixels[places[:, 2] == 0].reshape(cells[0] + 1, cells[1] + 1, 2)
    grid = upper[:, 0, 0], upper[0, :, 1]
    solid = make_solid(corners, tetrahedra, order=order)
    halves = np.rint(2 * places * cells).astype(np.int64)
    if order == 2:
        count, ends = len(corners), solid.elements[:, EDGES]
        between = np.zeros((len(solid.rest) - count, 3), np.int64)
        between[solid.elements[:, 4:] - count] = halves[ends].sum(axis=2) // 2
        fixed, across = np.zeros((2, len(between)), bool)
        fixed[solid.elements[:, 4:] - count] = held[ends].all(axis=2)
        across[solid.elements[:, 4:] - count] = _outside(halves, cells)[ends].all(axis=2)
        fixed &= _outside(between, cells) | ~across
        halves, held = np.concatenate([halves, between]), np.concatenate([held, fixed])
        columns, rows = (np.interp(np.arange(0, len(line) - 0.5, 0.5), np.arange(len(line)), line) for line in grid)
        grid = columns, rows
    top = np.flatnonzero(halves[:, 2] == 0)
    top = top[np.lexsort((halves[top, 1], halves[top, 0]))].reshape(len(grid[0]), len(grid[1]))
    return Slab(solid, np.repeat(held[:, None], 3, axis=1), top, *grid, place, order)


def _outside(halves: np.ndarray, cells: Cells) -> np.ndarray:
    """Which places, in halves of cells [P, 3], lie on a side or at the bottom, shape [P], bool."""
    ends = 2 * np.array(cells)
    return (halves == ends).any(axis=1) | (halves[:, :2] == 0).any(axis=1)


def slab_beneath(
    mesh: Mesh, vertex: int, normal: np.ndarray, thickness: float, cells: Cells, attached: bool = True, order: int = 1
) -> Slab:
    """The slab under a surface around a vertex.

    Args:
        mesh: tissue at rest.
        vertex: of it, where an instrument presses.
        normal: of the surface there, towards the camera, shape [3].
        thickness: [scene units].
        cells: along columns, rows and depth, the first two even, so that a node lies at the vertex.
        attached: whether it is held beyond the tissue's edge, too.
        order: of the elements' shape functions, 1 or 2.

    Raises:
        NoBody: a thickness that is not positive, or a surface under which a slab folds.
    """
    if not (math.isfinite(thickness) and thickness > 0):
        raise NoBody(f"a thickness of {thickness:g}; give a positive one.")
    middle = mesh.pixels[vertex].astype(np.float64)
    row, column = middle
    wide = WIDE * mesh.grid_shape[1]
    across, below, held = crowded(cells, (column, row), wide, thickness)
    pixels = across[:, ::-1]
    depth, outside = _depth(mesh, pixels, middle, wide, DEGREE if attached else LOOSE_DEGREE)
    surface = np.column_stack([_rays(mesh, pixels) * depth[:, None], depth])
    corners = surface - below[:, None] * np.asarray(normal, np.float64)
    try:
        return layered(corners, held | (outside & attached), cells, across, (column, row), order)
    except ValueError as error:
        raise NoBody(f"below this surface a slab of {thickness:g} folds ({error}); give a smaller one.") from error


def _rays(mesh: Mesh, pixels: np.ndarray) -> np.ndarray:
    """(x, y)/z of the camera that the mesh's own vertices imply, at rows and columns [P, 2], shape [P, 2]."""
    rays = mesh.vertices[:, :2].astype(np.float64) / mesh.vertices[:, 2:]
    found = []
    for axis in (0, 1):
        slope, start = np.polyfit(mesh.pixels[:, 1 - axis], rays[:, axis], 1)
        found.append(start + slope * pixels[:, 1 - axis])
    return np.stack(found, axis=1)


def _depth(
    mesh: Mesh, pixels: np.ndarray, middle: np.ndarray, wide: float, degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Depth at rows and columns [P, 2], and which of them lie beyond the tissue's edge, shape [P] each."""
    known = mesh.pixels.astype(np.float64)

    def terms(places: np.ndarray) -> np.ndarray:
        down, across = ((places - middle) / wide).T
        powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        return np.stack([down**i * across**j for i, j in powers], axis=1)

    depth = mesh.vertices[:, 2].astype(np.float64)
    fitted = np.linalg.lstsq(terms(known), depth, rcond=None)[0]
    left = depth - terms(known) @ fitted
    # Far beyond the mesh a polynomial means nothing; tissue there is held anyway.
    low, high = known.min(axis=0), known.max(axis=0)
    apart, nearest = KDTree(known).query(pixels, k=NEAREST)
    weights = 1 / np.maximum(apart, 1e-3) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    found = terms(np.clip(pixels, low, high)) @ fitted + (weights * left[nearest]).sum(axis=1)
    return found, (apart[:, 0] > OUTSIDE) & mesh.rim[nearest[:, 0]]
