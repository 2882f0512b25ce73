"""Appearance of a pressed plane to a camera with a light next to it: where tissue comes from, and how it darkens.

A pixel shows tissue that lay elsewhere at rest, as the dent has moved it in the picture, too. The surface between the
vertices of the mesh is rounded off by a Gaussian, in the picture, before the law of light (`physics.shading`) is
applied to it: how far is a parameter, since neither the mesh nor the picture constrains it. Three more are of the
tissue: how far light spreads in it before it comes out again, how wide the lobe is into which its wet surface mirrors
light, and how rough it is, since a rough surface darkens less as it tilts.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from palpate.data.shading.light import FINE
from palpate.data.shading.sequence import MARGIN, REACH
from palpate.physics.jit import kernel
from palpate.physics.mesh import Mesh, contact_normal, focal_length, grid_mesh
from palpate.physics.patches import between as between_vertices
from palpate.physics.patches import bilinear, corner
from palpate.physics.shading import exchanged, log_brightness, matt, mirrored

SIDE = 2 * (REACH + MARGIN) + 1
"""Rows and columns of vertices around a contact."""
PLACING = 4
"""Parameters of where tissue lies: how far the dent lies aside and the plane's tilt."""


class Placed(NamedTuple):
    """Tissue that pixels show, at rest and at some displacements; N frames, L² pixels."""

    normal: np.ndarray
    """Unit normal of the plane, shape [3]."""
    rest: np.ndarray
    """Logarithms of the light that compared pixels' tissue had at rest, colour by colour, shape [N, 3·P]."""
    flat: np.ndarray
    """Depth of the plane at rest, shape [L, L]."""
    sunk: np.ndarray
    """Depth of the tissue beyond that, shape [N, L, L]."""
    facing: np.ndarray
    """Logarithm of cos θ at rest, shape [N, L²]."""
    falloff: np.ndarray
    """Logarithm of the share of light that arrives at rest, shape [N, L²]."""


class Shown(NamedTuple):
    """Light of compared pixels, in shares of the matt light at rest; N frames, P pixels."""

    rest: np.ndarray
    """Logarithms of the light that their tissue had at rest, colour by colour, shape [N, 3·P]."""
    matt: np.ndarray
    """Matt light, shape [N, P]."""
    gloss: np.ndarray
    """Light that the surface mirrors, where it would be as much as the matt light if it faced the camera, [N, P]."""
    gloss_at_rest: np.ndarray
    """Gloss at rest, shape [N, P]."""
    received: np.ndarray
    """Matt light that places receive from the rest of the surface, if that reflected all, shape [N, P]."""


class LitSheet:
    """A plane through a contact's point that is seen by a camera with a light next to it.

    Args:
        mesh: tissue at rest; its grid, camera, outline and the contact's distance count, not its shape.
        vertex: the contact.
        rest: light at rest, as in `ShadingSequence`.
        tilt: of the plane, right and down, as tangents against the plane that faces the camera; None = the mesh itself
            is simulated, whose tilt at the contact is the plane's.
    """

    def __init__(self, mesh: Mesh, vertex: int, rest: np.ndarray, tilt: np.ndarray | None) -> None:
        self.focal = focal_length(mesh)[::-1]  # by rows and columns
        rays = mesh.vertices[:, :2].astype(np.float64) / mesh.vertices[:, 2:]
        self.middle = (mesh.pixels - rays[:, ::-1] * self.focal).mean(axis=0)
        self.pixel = mesh.pixels[vertex].astype(np.int64)
        # The median around the contact, where depth may be rough.
        near = np.abs(mesh.pixels - self.pixel).max(axis=1) <= REACH + MARGIN
        self.distance = float(np.median(mesh.vertices[near, 2]))
        self.ray = self.rays(self.pixel.astype(np.float64))
        self._sideways = np.linalg.svd(self.ray[None])[2][1:]
        self._sideways *= np.where(np.diag(self._sideways) < 0, -1.0, 1.0)[:, None]
        normal, facing = contact_normal(mesh, vertex).astype(np.float64), -self.ray / np.linalg.norm(self.ray)
        self.tilt = self._sideways @ normal / (facing @ normal) if tilt is None else np.array(tilt, np.float64)
        self.normal = self.normal_at(self.tilt)
        self.mesh = mesh if tilt is None else self._plane(mesh)
        offsets = self.mesh.pixels - self.pixel
        self.vertex = int(np.flatnonzero((offsets == 0).all(axis=1))[0])
        self.vertices = np.flatnonzero((np.abs(offsets) <= REACH + MARGIN).all(axis=1))
        """Vertices whose motion shows, shape [V]."""
        self._cells = tuple((offsets[self.vertices] + REACH + MARGIN).T)
        along = (np.arange(FINE * SIDE) + 0.5) / FINE - 0.5
        self._pixels = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
        """Pixels of the lattice on the square of vertices, shape [L, L, 2]."""
        self._first = (self.pixel - REACH - MARGIN).astype(np.float64)
        self._rays = self.rays(self._pixels + self._first)
        self._texture = np.moveaxis(np.asarray(rest, np.float64), 0, -1)
        self.inner = np.zeros(rest.shape[1:], bool)
        """Pixels that are compared, shape [L, L]; what may come to be seen there surrounds them."""
        self.inner[FINE * MARGIN : -FINE * MARGIN, FINE * MARGIN : -FINE * MARGIN] = True

    def _plane(self, mesh: Mesh) -> Mesh:
        """The plane as a mesh on the pixels of another."""
        valid = np.zeros(mesh.grid_shape, bool)
        valid[tuple(mesh.pixels.T)] = True
        rays = self.rays(np.moveaxis(np.indices(valid.shape), 0, -1).astype(np.float64))
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = self._depth(rays, self.normal)
        return grid_mesh(rays * depth[..., None], valid & (depth > 0))

    def rays(self, places: np.ndarray) -> np.ndarray:
        """Rays with z = 1 through places (row, column) of the grid, shapes [..., 2] to [..., 3]."""
        across = (places - self.middle) / self.focal
        return np.stack([across[..., 1], across[..., 0], np.ones(across.shape[:-1])], axis=-1)

    def normal_at(self, tilt: np.ndarray) -> np.ndarray:
        """Unit normal towards the camera of a tilt, shape [3]."""
        normal = np.asarray(tilt) @ self._sideways - self.ray / np.linalg.norm(self.ray)
        return normal / np.linalg.norm(normal)

    def _depth(self, rays: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """z of a plane through the contact's point, along rays [..., 3]."""
        return self.distance * (self.ray @ normal) / (rays @ normal)

    def dense(self, values: np.ndarray) -> np.ndarray:
        """Values of the vertices [N, V, ...] on their square [N, S, S, ...]; 0 where there is no vertex."""
        found = np.zeros((len(values), SIDE, SIDE, *values.shape[2:]))
        found[:, self._cells[0], self._cells[1]] = values
        return found

    def placed(self, moved: np.ndarray, place: np.ndarray) -> Placed:
        """Find the tissue that pixels show.

        Args:
            moved: displacements of the vertices, shape [N, V, 3].
            place: how far the dent lies aside (rows, columns) [grid pixels], and the plane's tilt (right, down),
                shape [PLACING].
        """
        aside, normal = place[:2], self.normal_at(place[2:])
        # The dent turns with the plane.
        field = np.einsum("ij,nrcj->nrci", _rotation(self.normal, normal), self.dense(moved))
        plane, pixels = self.distance * (self.ray @ normal), self._pixels.reshape(-1, 2)
        place = _rested(field, pixels, aside, self._first - self.middle, self.focal, plane, normal)
        away = between(field[..., 2:], place - aside)[..., 0]
        rays, flat = self.rays(place + self._first), self._depth(self._rays, normal)
        depth, square = self._depth(rays, normal), np.log(np.einsum("npi,npi->np", rays, rays))
        texture = np.broadcast_to(self._texture, (len(moved), *self._texture.shape))
        rest = between(texture, place[:, self.inner.ravel()] * FINE + 0.5 * (FINE - 1))
        return Placed(
            normal,
            np.moveaxis(rest, -1, 1).reshape(len(moved), -1),
            flat,
            (depth + away).reshape(len(moved), *flat.shape) - flat,
            np.log(np.abs(rays @ normal)) - 0.5 * square,
            -square - 2 * np.log(depth),
        )

    def shown(self, placed: Placed, surface: np.ndarray) -> Shown:
        """Return the light of compared pixels.

        Args:
            placed: their tissue.
            surface: logarithms of how far it is rounded off [grid pixels], how far light spreads in it [grid pixels],
                and how wide the lobe of mirrored light is [rad], then its roughness, as in `matt`, shape [4].
        """
        rounding, spreading = np.exp(surface[:2])
        lobe, rough = surface[2:]
        depth, inner = _rounded(placed.sunk, rounding) + placed.flat, self.inner.ravel()
        facing, falloff = (part.reshape(len(depth), -1) for part in log_brightness(depth, self._rays))
        rest, farther = matt(placed.facing, rough), np.exp(falloff - placed.falloff)
        direct = (matt(facing, rough) * farther / rest).reshape(depth.shape)
        rest, farther = rest[:, inner], farther[:, inner]
        return Shown(
            placed.rest,
            _rounded(direct, spreading)[:, self.inner],
            mirrored(facing[:, inner], lobe) * farther / rest,
            mirrored(placed.facing[:, inner], lobe) / rest,
            self._received(depth, direct),
        )

    def _received(self, surface: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Light from the rest of a surface: its z along the pixels' rays and its own light have shape [N, L, L]."""
        grid = slice(FINE * MARGIN, -FINE * MARGIN, FINE)
        points = (surface[..., None] * self._rays)[:, grid, grid]
        found = exchanged(np.ascontiguousarray(points), np.ascontiguousarray(light[:, grid, grid]))
        return found.repeat(FINE, axis=1).repeat(FINE, axis=2).reshape(len(surface), -1)


def between(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values on a square [N, S, S, C] at places (row, column) in every frame [N, P, 2], bilinear, shape [N, P, C]."""
    return between_vertices(np.ascontiguousarray(values), np.ascontiguousarray(places))


@kernel
def _rested(still, pixels, aside, shift, focal, plane, normal):
    """Where the tissue that pixels show lay at rest, row and column on the square of vertices, shape [N, P, 2].

    Args:
        still: displacements on the square, shape [N, S, S, 3].
        pixels: row and column on the square, shape [P, 2].
        aside: of the dent, by rows and columns.
        shift: from the square's row and column to the camera's axis.
        focal: by rows and columns.
        plane: of points on the plane, along its normal.
        normal: of the plane, shape [3].
    """
    found, last = np.empty((len(still), *pixels.shape)), still.shape[1] - 1.0
    for frame in range(len(still)):
        field = still[frame]
        for index in range(len(pixels)):
            row, column = pixels[index, 0], pixels[index, 1]
            # To find where a pixel's tissue lay at rest; every one leaves a third or less of the error.
            for _ in range(6):
                near_row, top = corner(row - aside[0], last)
                near_column, left = corner(column - aside[1], last)
                down, right = near_row - top, near_column - left
                across_x = bilinear(field, top, left, down, right, 0)
                across_y = bilinear(field, top, left, down, right, 1)
                away = bilinear(field, top, left, down, right, 2)
                y, x = (row + shift[0]) / focal[0], (column + shift[1]) / focal[1]
                beyond = plane / (x * normal[0] + y * normal[1] + normal[2]) + away
                last_row, last_column = row, column
                row = pixels[index, 0] - focal[0] * (across_y - y * away) / beyond
                column = pixels[index, 1] - focal[1] * (across_x - x * away) / beyond
                # Where nothing is known, too.
                if not abs(row - last_row) + abs(column - last_column) > 1e-9:
                    break
            found[frame, index, 0], found[frame, index, 1] = row, column
    return found


def _rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns one unit vector into another, shape [3, 3]."""
    x, y, z = np.cross(first, second)
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + turn + turn @ turn / (1 + first @ second)


def _rounded(values: np.ndarray, width: float) -> np.ndarray:
    """Values on the lattice [N, L, L] under a Gaussian of so many grid pixels."""
    # As a product of matrices it takes a fraction of the time of a filter along strided axes.
    weights = gaussian_filter1d(np.eye(values.shape[1]), width * FINE, axis=0, mode="nearest")
    return weights @ values @ weights.T
