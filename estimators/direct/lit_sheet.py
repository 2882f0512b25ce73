"""What a camera with a light beside it sees of a pressed plane: where tissue comes from, and how it darkens.

A pixel shows tissue that lay elsewhere at rest, as the dent has moved it in the picture, too. The surface between the
vertices of the mesh is rounded off by a Gaussian, in the picture, before the law of light (`physics.brightness`) is
applied to it: how far is a parameter, since neither the mesh nor the picture tell it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from palpate.data.brightness.light import FINE
from palpate.data.brightness.sequence import MARGIN, REACH
from palpate.data.contact.patches import _between as between
from palpate.data.contact.patches import focal_length
from palpate.physics.brightness import log_brightness, log_brightness_slopes
from palpate.physics.mesh import Mesh, grid_mesh

ITERATIONS = 6
"""To find where a pixel's tissue lay at rest; every one leaves a third or less of the error."""
DIFFERENCE = 1e-4
"""Step of differences along the grid [grid pixels], and of the rounding's logarithm."""
SIDE = 2 * (REACH + MARGIN) + 1
"""Rows and columns of vertices around a contact."""


class Shown(NamedTuple):
    """What pixels show at some displacements; N frames, P = L² pixels, D parameters."""

    rest: np.ndarray
    """Logarithm of the light that their tissue had at rest, shape [N, P]."""
    change: np.ndarray
    """Logarithm of its light over that, by the law, shape [N, P]."""
    rest_slopes: np.ndarray
    """Derivatives of the first by all parameters, shape [N, P, D]."""
    change_slopes: np.ndarray
    """Of the second."""


class LitSheet:
    """A plane through a contact's point that is seen by a camera with a light beside it.

    Args:
        mesh: tissue at rest; its grid, camera, outline and the contact's distance count, not its shape.
        vertex: the contact.
        rest: light at rest, as of `BrightnessSequence`.
        tilt: of the plane, right and down, as tangents against the plane that faces the camera.
    """

    def __init__(self, mesh: Mesh, vertex: int, rest: np.ndarray, tilt: np.ndarray) -> None:
        self.focal = focal_length(mesh)[::-1]  # by rows and columns
        rays = mesh.vertices[:, :2].astype(np.float64) / mesh.vertices[:, 2:]
        self.middle = (mesh.pixels - rays[:, ::-1] * self.focal).mean(axis=0)
        self.pixel = mesh.pixels[vertex].astype(np.int64)
        self.distance = _distance(mesh, self.pixel)
        self.ray = self.rays(self.pixel.astype(np.float64))
        self._sideways = np.linalg.svd(self.ray[None])[2][1:]
        if self._sideways[0, 0] < 0:
            self._sideways[0] *= -1
        if self._sideways[1, 1] < 0:
            self._sideways[1] *= -1
        self.tilt, self.normal = np.array(tilt, np.float64), self.normal_at(tilt)
        self.mesh = self._plane(mesh)
        offsets = self.mesh.pixels - self.pixel
        self.vertex = int(np.flatnonzero((offsets == 0).all(axis=1))[0])
        self.vertices = np.flatnonzero((np.abs(offsets) <= REACH + MARGIN).all(axis=1))
        """Vertices whose motion shows, shape [V]."""
        self._cells = tuple((offsets[self.vertices] + REACH + MARGIN).T)
        first = self.pixel - REACH - MARGIN
        along = (np.arange(FINE * SIDE) + 0.5) / FINE - 0.5
        self._places = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
        """Pixels of the lattice on the square of vertices, shape [L, L, 2]."""
        self._first = first.astype(np.float64)
        self._rays = self.rays(self._places + first)
        self._rest = np.asarray(rest, np.float64)
        self.inner = np.zeros(rest.shape, bool)
        """Pixels that are compared, shape [L, L]; what may come to be seen there surrounds them."""
        self.inner[FINE * MARGIN : -FINE * MARGIN, FINE * MARGIN : -FINE * MARGIN] = True

    def _plane(self, mesh: Mesh) -> Mesh:
        """The plane as a mesh on the pixels of another."""
        valid = np.zeros(mesh.grid_shape, bool)
        valid[tuple(mesh.pixels.T)] = True
        rays = self.rays(np.stack(np.mgrid[: valid.shape[0], : valid.shape[1]], axis=-1).astype(np.float64))
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

    def shown(self, moved: np.ndarray, slopes: np.ndarray, others: np.ndarray) -> Shown:
        """What all pixels show.

        Args:
            moved: displacements of the vertices, shape [N, V, 3].
            slopes: their derivatives by D' parameters, shape [N, V, 3, D'].
            others: how far the dent lies aside (rows, columns) [grid pixels], the plane's tilt (right, down), and the
                logarithm of how far the surface is rounded off [grid pixels], shape [5].

        Returns:
            With derivatives by the D' parameters, then by those five.
        """
        aside, tilt, rounding = others[:2], others[2:4], np.exp(others[4])
        normal, frames = self.normal_at(tilt), len(moved)
        turn = _rotation(self.normal, normal)
        field = self.dense(np.concatenate([moved[..., None], slopes], axis=-1))
        field = np.einsum("ij,nrcjd->nrcid", turn, field).reshape(frames, SIDE, SIDE, -1)
        pixels, pixel_rays = self._places.reshape(-1, 2), self._rays.reshape(-1, 3)
        still = np.ascontiguousarray(field.reshape(frames, SIDE, SIDE, 3, -1)[..., 0])
        place = np.broadcast_to(pixels, (frames, *pixels.shape)).copy()
        for _ in range(ITERATIONS):
            away = between(still, place - aside)
            rays = self.rays(place + self._first)
            beyond = self._depth(rays, normal) + away[..., 2]
            across = away[..., :2] - rays[..., :2] * away[..., 2:]
            place = pixels - self.focal * across[..., ::-1] / beyond[..., None]
        values = between(field, place - aside).reshape(*place.shape[:2], 3, -1)
        away, by_motion = values[..., 0], values[..., 1:]
        gradient = np.stack([between(still, place - aside + step) - away for step in DIFFERENCE * np.eye(2)], axis=-1)
        gradient /= DIFFERENCE
        rays = self.rays(place + self._first)
        depth = self._depth(rays, normal)
        # How the point moves that a place at rest becomes, by the place itself: [N, P, 3, 2].
        ray_slopes = np.zeros((3, 2))
        ray_slopes[1, 0], ray_slopes[0, 1] = 1 / self.focal
        depth_slopes = -depth[..., None] * (normal @ ray_slopes) / (rays @ normal)[..., None]
        by_place = rays[..., None] * depth_slopes[..., None, :] + depth[..., None, None] * ray_slopes + gradient
        by_tilt = self._by_tilt(rays, depth, away, tilt)
        slopes = np.concatenate([by_motion, -gradient, by_tilt], axis=-1)
        # A pixel goes on showing what lies on its own ray.
        off_ray = by_place[..., :2, :] - pixel_rays[:, :2, None] * by_place[..., 2:, :]
        shifted = -np.linalg.solve(off_ray, slopes[..., :2, :] - pixel_rays[:, :2, None] * slopes[..., 2:, :])
        deeper = np.einsum("npi,npid->npd", by_place[..., 2, :], shifted) + slopes[..., 2, :]
        side = len(self._places)
        flat = self._depth(self._rays, normal)
        flat_slopes = self._depth_by_tilt(self._rays, flat, tilt)
        deeper[..., -2:] -= flat_slopes.reshape(-1, 2)
        below = ((depth + away[..., 2]).reshape(frames, side, side) - flat)[..., None]
        below = np.concatenate([below, deeper.reshape(frames, side, side, -1)], axis=-1)
        rounded = _rounded(below, rounding)
        rounder = (_rounded(below[..., :1], rounding * np.exp(DIFFERENCE)) - rounded[..., :1]) / DIFFERENCE
        surface = rounded[..., 0] + flat
        rounded[..., -2:] += flat_slopes
        by_all = np.concatenate([rounded[..., 1:], rounder], axis=-1)
        points, rays_on = self._rays * surface[..., None], self._rays
        lit = log_brightness(points).reshape(frames, -1)
        lit_slopes = log_brightness_slopes(points, rays_on[..., None] * by_all[..., None, :])
        lit_slopes = lit_slopes.reshape(frames, side**2, -1)
        at_rest, rest_slopes = self._at_rest(rays, depth, normal, tilt, ray_slopes, depth_slopes)
        law_slopes = lit_slopes.copy()
        law_slopes[..., :-1] -= np.einsum("npi,npid->npd", rest_slopes[..., :2], shifted)
        law_slopes[..., -3:-1] -= rest_slopes[..., 2:]
        scaled = place * FINE + 0.5 * (FINE - 1)
        light = np.broadcast_to(self._rest[None, :, :, None], (frames, side, side, 1))
        known = between(light, scaled)
        steps = FINE * DIFFERENCE * np.eye(2)
        texture = [(between(light, scaled + step) - known)[..., 0] / DIFFERENCE for step in steps]
        carried = np.zeros_like(law_slopes)
        carried[..., :-1] = np.einsum("npi,npid->npd", np.stack(texture, axis=-1), shifted)
        return Shown(known[..., 0], lit - at_rest, np.nan_to_num(carried), law_slopes)

    def _at_rest(
        self,
        rays: np.ndarray,
        depth: np.ndarray,
        normal: np.ndarray,
        tilt: np.ndarray,
        ray_slopes: np.ndarray,
        depth_slopes: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """log(cos θ/r²) of the plane along rays [N, P, 3], and its derivatives by the place and the tilt [N, P, 4]."""
        square, facing = np.einsum("npi,npi->np", rays, rays), rays @ normal
        found = np.log(np.abs(facing)) - 1.5 * np.log(square) - 2 * np.log(depth)
        by_place = (normal @ ray_slopes) / facing[..., None] - 3 * (rays @ ray_slopes) / square[..., None]
        by_place = by_place - 2 * depth_slopes / depth[..., None]
        turned = rays @ self._normal_slopes(tilt) / facing[..., None]
        by_tilt = turned - 2 * self._depth_by_tilt(rays, depth, tilt) / depth[..., None]
        return found, np.concatenate([by_place, by_tilt], axis=-1)

    def _normal_slopes(self, tilt: np.ndarray) -> np.ndarray:
        """Derivatives of the normal by the tilt, shape [3, 2]."""
        return np.stack(
            [(self.normal_at(tilt + step) - self.normal_at(tilt - step)) / (2 * DIFFERENCE) for step in
             DIFFERENCE * np.eye(2)], axis=-1
        )  # fmt: skip

    def _depth_by_tilt(self, rays: np.ndarray, depth: np.ndarray, tilt: np.ndarray) -> np.ndarray:
        """Derivatives of the plane's z along rays [..., 3] by the tilt, shape [..., 2]."""
        normal, slopes = self.normal_at(tilt), self._normal_slopes(tilt)
        return depth[..., None] * (self.ray @ slopes / (self.ray @ normal) - rays @ slopes / (rays @ normal)[..., None])

    def _by_tilt(self, rays: np.ndarray, depth: np.ndarray, away: np.ndarray, tilt: np.ndarray) -> np.ndarray:
        """Derivatives by the tilt of where places at rest come to lie, shape [N, P, 3, 2]: the dent turns with it."""
        normal, slopes = self.normal_at(tilt), self._normal_slopes(tilt)
        plane = rays[..., None] * self._depth_by_tilt(rays, depth, tilt)[..., None, :]
        axes = np.cross(normal, slopes.T)
        return plane + np.stack([np.cross(axis, away) for axis in axes], axis=-1)


def _distance(mesh: Mesh, pixel: np.ndarray) -> float:
    """z of the tissue at a pixel: the median around it, where depth may be rough [scene units]."""
    near = np.abs(mesh.pixels - pixel).max(axis=1) <= REACH + MARGIN
    return float(np.median(mesh.vertices[near, 2]))


def _rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns one unit vector into another, shape [3, 3]."""
    x, y, z = np.cross(first, second)
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + turn + turn @ turn / (1 + first @ second)


def _rounded(values: np.ndarray, width: float) -> np.ndarray:
    """Values on the lattice [N, L, L, C] under a Gaussian of so many grid pixels."""
    for axis in (1, 2):
        values = gaussian_filter1d(values, width * FINE, axis=axis, mode="nearest")
    return values
