"""What a camera with a light next to it sees of a pressed plane: where tissue comes from, and how it darkens.

A pixel shows tissue that lay elsewhere at rest, as the dent has moved it in the picture, too. The surface between the
vertices of the mesh is rounded off by a Gaussian, in the picture, before the law of light (`physics.brightness`) is
applied to it: how far is a parameter, since neither the mesh nor the picture tell it. Three more are of the tissue: how
far light spreads in it before it comes out again, how wide the lobe is into which its wet surface mirrors light, and
how rough it is, since a rough surface darkens less as it tilts.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from palpate.data.brightness.light import FINE
from palpate.data.brightness.sequence import MARGIN, REACH
from palpate.data.contact.patches import between as between_vertices
from palpate.data.contact.patches import bilinear, corner
from palpate.physics.brightness import log_brightness, log_brightness_slopes, matt, matt_slope, mirrored
from palpate.physics.jit import kernel
from palpate.physics.mesh import Mesh, focal_length, grid_mesh

ITERATIONS = 6
"""To find where a pixel's tissue lay at rest; every one leaves a third or less of the error."""
DIFFERENCE = 1e-4
"""Step of differences along the grid [grid pixels], and of the rounding's logarithm."""
SIDE = 2 * (REACH + MARGIN) + 1
"""Rows and columns of vertices around a contact."""
Pair = tuple[np.ndarray, np.ndarray]
"""What is known of log cos θ, and of log(1/r²)."""


class Shown(NamedTuple):
    """What pixels show at some displacements, in shares of the matt light at rest; N frames, P = L² pixels."""

    rest: np.ndarray
    """Logarithm of the light that their tissue had at rest, shape [N, P]."""
    matt: np.ndarray
    """Matt light, shape [N, P]."""
    gloss: np.ndarray
    """Light that the surface mirrors, where it would be as much as the matt light if it faced the camera, [N, P]."""
    gloss_at_rest: np.ndarray
    """The same at rest, shape [N, P]."""


class _Seen(NamedTuple):
    """Which tissue pixels show; N frames, P = L² pixels, C columns, the displacement first."""

    normal: np.ndarray
    """Of the plane, shape [3]."""
    field: np.ndarray
    """Displacements on the square of vertices, turned with the plane, shape [N, S, S, 3, 1]."""
    values: np.ndarray
    """What moves, at the places that pixels show, shape [N, P, 3, C]."""
    place: np.ndarray
    """Where these lay at rest, rows and columns on the square of vertices, shape [N, P, 2]."""
    rays: np.ndarray
    """Rays through them, shape [N, P, 3]."""
    depth: np.ndarray
    """z of the plane there, shape [N, P]."""
    flat: np.ndarray
    """z of the plane along the pixels' own rays, shape [L, L]."""
    facing: np.ndarray
    """log cos θ of the plane at the places, shape [N, P]."""
    falloff: np.ndarray
    """log(1/r²) of it there, shape [N, P]."""
    below: np.ndarray
    """How much deeper than that the pixels' tissue lies, shape [N, L, L]."""


class LitSheet:
    """A plane through a contact's point that is seen by a camera with a light next to it.

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
        # The median around the contact, where depth may be rough.
        near = np.abs(mesh.pixels - self.pixel).max(axis=1) <= REACH + MARGIN
        self.distance = float(np.median(mesh.vertices[near, 2]))
        self.ray = self.rays(self.pixel.astype(np.float64))
        self._sideways = np.linalg.svd(self.ray[None])[2][1:]
        self._sideways *= np.where(np.diag(self._sideways) < 0, -1.0, 1.0)[:, None]
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
        self._pixel_rays = np.ascontiguousarray(self._rays.reshape(-1, 3))
        self._rest = np.asarray(rest, np.float64)
        self.inner = np.zeros(rest.shape, bool)
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

    def shown(self, moved: np.ndarray, others: np.ndarray) -> Shown:
        """What pixels show.

        Args:
            moved: displacements of the vertices, shape [N, V, 3].
            others: how far the dent lies aside (rows, columns) [grid pixels], the plane's tilt (right, down), and
                logarithms of how far the surface is rounded off [grid pixels], how far light spreads in tissue
                [grid pixels], and how wide the lobe of mirrored light is [rad], then the roughness, as of `matt`,
                shape [8].
        """
        seen = self._seen(moved[..., None], others)
        surface = _rounded(seen.below[..., None], np.exp(others[4]))[..., 0] + seen.flat
        facing, falloff = (part.reshape(len(moved), -1) for part in log_brightness(surface, self._rays))
        rest, farther = matt(seen.facing, others[7]), np.exp(falloff - seen.falloff)
        direct = (matt(facing, others[7]) * farther / rest).reshape(*surface.shape, 1)
        spread = _rounded(direct, np.exp(others[5])).reshape(facing.shape)
        gloss = mirrored(facing, others[6]) * farther / rest
        return Shown(self._carried(seen.place)[..., 0], spread, gloss, mirrored(seen.facing, others[6]) / rest)

    def linearised(self, moved: np.ndarray, slopes: np.ndarray, others: np.ndarray) -> tuple[Shown, Shown]:
        """The same with derivatives by all parameters.

        Args:
            moved, others: as of `shown`.
            slopes: derivatives of the displacements by D' parameters, shape [N, V, 3, D'].

        Returns:
            What pixels show, and its derivatives by the D' parameters, then by the eight others, shape [N, P, D].
        """
        tilt, rounding, frames = others[2:4], np.exp(others[4]), len(moved)
        seen = self._seen(np.concatenate([moved[..., None], slopes], axis=-1), others)
        rays, depth = seen.rays, seen.depth
        ray_slopes = np.zeros((3, 2))
        ray_slopes[1, 0], ray_slopes[0, 1] = 1 / self.focal
        depth_slopes = -depth[..., None] * (seen.normal @ ray_slopes) / (rays @ seen.normal)[..., None]
        along_plane = self._depth_by_tilt(rays, depth, tilt)
        turning = np.cross(seen.normal, self._normal_slopes(tilt).T)
        at, still = seen.place - others[:2], np.ascontiguousarray(seen.field[..., 0])
        shifted, deeper = _followed(
            still, at, seen.values, rays, depth, depth_slopes, along_plane, turning, self._pixel_rays, self.focal
        )
        flat_slopes = self._depth_by_tilt(self._rays, seen.flat, tilt)
        deeper[..., -2:] -= flat_slopes.reshape(-1, 2)
        below = np.concatenate([seen.below[..., None], deeper.reshape(*seen.below.shape, -1)], axis=-1)
        rounded = _rounded(below, rounding)
        rounder = (_rounded(below[..., :1], rounding * np.exp(DIFFERENCE)) - rounded[..., :1]) / DIFFERENCE
        surface = rounded[..., 0] + seen.flat
        rounded[..., -2:] += flat_slopes
        surface_slopes = np.concatenate([rounded[..., 1:], rounder], axis=-1)
        facing, falloff = (part.reshape(frames, -1) for part in log_brightness(surface, self._rays))
        by_law = log_brightness_slopes(surface, surface_slopes, self._rays)
        by_facing, by_falloff = (part.reshape(*facing.shape, -1) for part in by_law)
        resting = self._rest_slopes(seen, tilt, ray_slopes, depth_slopes)
        rest_facing, rest_falloff = np.zeros_like(by_facing), np.zeros_like(by_facing)
        for found, (by_place, by_tilt) in zip((rest_facing, rest_falloff), resting, strict=True):
            found[..., :-1] = np.einsum("npi,npid->npd", by_place, shifted)
            found[..., -3:-1] += by_tilt

        shown, by_all = _lit((facing, falloff), (by_facing, by_falloff), seen, (rest_facing, rest_falloff), others)
        carried = self._carried(seen.place, DIFFERENCE)
        texture = (carried[..., 1:] - carried[..., :1]) / DIFFERENCE
        carried_slopes = np.zeros_like(by_facing)
        carried_slopes[..., :-1] = np.einsum("npi,npid->npd", texture, shifted)
        nothing = np.zeros((*carried_slopes.shape[:2], 3))
        carried_slopes = np.concatenate([np.nan_to_num(carried_slopes), nothing], axis=-1)
        return shown._replace(rest=carried[..., 0]), by_all._replace(rest=carried_slopes)

    def _seen(self, moving: np.ndarray, others: np.ndarray) -> _Seen:
        """Which tissue pixels show, from displacements and whatever else moves with them, shape [N, V, 3, C]."""
        aside, normal, frames = others[:2], self.normal_at(others[2:4]), len(moving)
        field = np.einsum("ij,nrcjd->nrcid", _rotation(self.normal, normal), self.dense(moving))
        still, pixels = np.ascontiguousarray(field[..., 0]), self._places.reshape(-1, 2)
        plane = self.distance * (self.ray @ normal)
        place = _rested(still, pixels, aside, self._first - self.middle, self.focal, plane, normal)
        values = between(field.reshape(frames, SIDE, SIDE, -1), place - aside).reshape(*place.shape[:2], 3, -1)
        rays = self.rays(place + self._first)
        depth = self._depth(rays, normal)
        flat = self._depth(self._rays, normal)
        square = np.einsum("npi,npi->np", rays, rays)
        facing, falloff = np.log(np.abs(rays @ normal)) - 0.5 * np.log(square), -np.log(square) - 2 * np.log(depth)
        below = (depth + values[..., 2, 0]).reshape(frames, *flat.shape) - flat
        return _Seen(normal, still[..., None], values, place, rays, depth, flat, facing, falloff, below)

    def _carried(self, place: np.ndarray, step: float = 0.0) -> np.ndarray:
        """Light at rest of places [N, P, 2]; with a step, that a step down and to the right as well, [N, P, 1 or 3]."""
        light = np.broadcast_to(self._rest[None, :, :, None], (len(place), *self._rest.shape, 1))
        steps = [np.zeros(2), *(step * np.eye(2) if step else ())]
        return np.concatenate([between(light, (place + each) * FINE + 0.5 * (FINE - 1)) for each in steps], axis=-1)

    def _rest_slopes(
        self, seen: _Seen, tilt: np.ndarray, ray_slopes: np.ndarray, depth_slopes: np.ndarray
    ) -> list[Pair]:
        """Derivatives of log cos θ and of log(1/r²) of the plane at the places, by place and tilt, [N, P, 2] each."""
        rays, depth, normal = seen.rays, seen.depth, seen.normal
        square, facing = np.einsum("npi,npi->np", rays, rays), (rays @ normal)[..., None]
        stretched = (rays @ ray_slopes) / square[..., None]
        by_depth = self._depth_by_tilt(rays, depth, tilt) / depth[..., None]
        return [
            ((normal @ ray_slopes) / facing - stretched, rays @ self._normal_slopes(tilt) / facing),
            (-2 * stretched - 2 * depth_slopes / depth[..., None], -2 * by_depth),
        ]

    def _normal_slopes(self, tilt: np.ndarray) -> np.ndarray:
        """Derivatives of the normal by the tilt, shape [3, 2]."""
        steps = DIFFERENCE * np.eye(2)
        found = [(self.normal_at(tilt + step) - self.normal_at(tilt - step)) / (2 * DIFFERENCE) for step in steps]
        return np.stack(found, axis=-1)

    def _depth_by_tilt(self, rays: np.ndarray, depth: np.ndarray, tilt: np.ndarray) -> np.ndarray:
        """Derivatives of the plane's z along rays [..., 3] by the tilt, shape [..., 2]."""
        normal, slopes = self.normal_at(tilt), self._normal_slopes(tilt)
        return depth[..., None] * (self.ray @ slopes / (self.ray @ normal) - rays @ slopes / (rays @ normal)[..., None])


def _lit(now: Pair, by_now: Pair, seen: _Seen, by_rest: Pair, others: np.ndarray) -> tuple[Shown, Shown]:
    """What pixels show but for the light at rest, and its derivatives by all parameters.

    Args:
        now: log cos θ and log(1/r²) of what pixels show, shape [N, P] each.
        by_now: their derivatives by all parameters but those of the tissue, shape [N, P, D].
        seen: the same at rest.
        by_rest: the derivatives at rest.
        others: as of `LitSheet.shown`.
    """
    (facing, falloff), (by_facing, by_falloff), (rest_facing, rest_falloff) = now, by_now, by_rest
    (spreading, lobe), rough, farther = np.exp(others[5:7]), float(others[7]), np.exp(falloff - seen.falloff)
    level, rest = matt(facing, rough), matt(seen.facing, rough)
    # Derivatives of the logarithms of matt light, now and at rest, by geometry and by roughness.
    by_level = matt_slope(facing, rough)[..., None] * by_facing
    by_rest_level = matt_slope(seen.facing, rough)[..., None] * rest_facing
    rougher, rest_rougher = (-np.expm1(2 * part) / of for part, of in ((facing, level), (seen.facing, rest)))
    by_farther, square = by_falloff - rest_falloff, (len(facing), *seen.below.shape[1:], -1)
    direct, by_rough = (level * farther / rest)[..., None], (rougher - rest_rougher)[..., None]
    by_direct = direct * np.concatenate([by_level + by_farther - by_rest_level, by_rough], axis=-1)
    light = _rounded(np.concatenate([direct, by_direct], axis=-1).reshape(square), spreading)
    wider = _rounded(direct.reshape(square), spreading * np.exp(DIFFERENCE))
    spread = (wider - light[..., :1]).reshape(*facing.shape, 1) / DIFFERENCE
    light, nothing = light.reshape(*facing.shape, -1), np.zeros_like(spread)
    gloss, at_rest = mirrored(facing, others[6]) * farther / rest, mirrored(seen.facing, others[6]) / rest
    tight = lobe**-2
    by_gloss = (tight * np.exp(facing))[..., None] * by_facing + by_farther - by_rest_level
    by_gloss_at_rest = (tight * np.exp(seen.facing))[..., None] * rest_facing - by_rest_level

    def lobes(logarithm: np.ndarray, by_geometry: np.ndarray) -> np.ndarray:
        """Derivatives of the logarithm of mirrored light by all parameters, from those by geometry."""
        by_lobe = -2 * tight * np.expm1(logarithm)[..., None]
        return np.concatenate([by_geometry, nothing, by_lobe, -rest_rougher[..., None]], axis=-1)

    return Shown(nothing, light[..., 0], gloss, at_rest), Shown(
        nothing,
        np.concatenate([light[..., 1:-1], spread, nothing, light[..., -1:]], axis=-1),
        gloss[..., None] * lobes(facing, by_gloss),
        at_rest[..., None] * lobes(seen.facing, by_gloss_at_rest),
    )


def between(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values on a square [N, S, S, C] at places (row, column) in every frame [N, P, 2], bilinear, shape [N, P, C]."""
    return between_vertices(np.ascontiguousarray(values), np.ascontiguousarray(places))


@kernel
def _followed(still, at, values, rays, depth, depth_slopes, along_plane, turning, pixel_rays, focal):
    """How the places at rest shift that pixels show, [N, P, 2, D], and how much deeper their tissue comes to lie,
    [N, P, D], by all parameters of the motion, the dent's place and the tilt: a pixel goes on showing its own ray.

    Args:
        still: displacements on the square of vertices, shape [N, S, S, 3].
        at: places on it whose displacements pixels show, shape [N, P, 2].
        values: displacements there and their derivatives by the motion's parameters, shape [N, P, 3, 1 + D'].
        rays, depth: of these places at rest, shapes [N, P, 3] and [N, P].
        depth_slopes: derivatives of that depth by row and column, shape [N, P, 2].
        along_plane: the same by the tilt.
        turning: axes around which the dent turns with the tilt, shape [2, 3].
        pixel_rays: rays of the pixels, shape [P, 3].
        focal: by rows and columns.
    """
    frames, pixels, _, columns = values.shape
    motion = columns - 1
    shifted, deeper = np.empty((frames, pixels, 2, motion + 4)), np.empty((frames, pixels, motion + 4))
    last, by_place, by_one = still.shape[1] - 1.0, np.empty((3, 2)), np.empty(3)
    for frame in range(frames):
        for index in range(pixels):
            ray, across = rays[frame, index], pixel_rays[index]
            for way in range(2):
                row, column = at[frame, index, 0], at[frame, index, 1]
                row, column = (row + DIFFERENCE, column) if way == 0 else (row, column + DIFFERENCE)
                row, top = corner(row, last)
                column, left = corner(column, last)
                for axis in range(3):
                    beside = bilinear(still[frame], top, left, row - top, column - left, axis)
                    by_place[axis, way] = (beside - values[frame, index, axis, 0]) / DIFFERENCE
            gradient = by_place.copy()
            for way in range(2):
                for axis in range(3):
                    by_place[axis, way] += ray[axis] * depth_slopes[frame, index, way]
                by_place[1 - way, way] += depth[frame, index] / focal[way]
            a, b = by_place[0, 0] - across[0] * by_place[2, 0], by_place[0, 1] - across[0] * by_place[2, 1]
            c, d = by_place[1, 0] - across[1] * by_place[2, 0], by_place[1, 1] - across[1] * by_place[2, 1]
            determinant = a * d - b * c
            x, y, z = values[frame, index, 0, 0], values[frame, index, 1, 0], values[frame, index, 2, 0]
            for one in range(motion + 4):
                if one < motion:
                    by_one[:] = values[frame, index, :, 1 + one]
                elif one < motion + 2:
                    by_one[:] = -gradient[:, one - motion]
                else:
                    axis, plane = turning[one - motion - 2], along_plane[frame, index, one - motion - 2]
                    by_one[0] = ray[0] * plane + axis[1] * z - axis[2] * y
                    by_one[1] = ray[1] * plane + axis[2] * x - axis[0] * z
                    by_one[2] = ray[2] * plane + axis[0] * y - axis[1] * x
                first, second = by_one[0] - across[0] * by_one[2], by_one[1] - across[1] * by_one[2]
                down, right = (b * second - d * first) / determinant, (c * first - a * second) / determinant
                shifted[frame, index, 0, one], shifted[frame, index, 1, one] = down, right
                deeper[frame, index, one] = by_place[2, 0] * down + by_place[2, 1] * right + by_one[2]
    return shifted, deeper


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
            for _ in range(ITERATIONS):
                near_row, top = corner(row - aside[0], last)
                near_column, left = corner(column - aside[1], last)
                down, right = near_row - top, near_column - left
                across_x = bilinear(field, top, left, down, right, 0)
                across_y = bilinear(field, top, left, down, right, 1)
                away = bilinear(field, top, left, down, right, 2)
                y, x = (row + shift[0]) / focal[0], (column + shift[1]) / focal[1]
                beyond = plane / (x * normal[0] + y * normal[1] + normal[2]) + away
                row = pixels[index, 0] - focal[0] * (across_y - y * away) / beyond
                column = pixels[index, 1] - focal[1] * (across_x - x * away) / beyond
                if np.isnan(row + column):
                    break
            found[frame, index, 0], found[frame, index, 1] = row, column
    return found


def _rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns one unit vector into another, shape [3, 3]."""
    x, y, z = np.cross(first, second)
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + turn + turn @ turn / (1 + first @ second)


def _rounded(values: np.ndarray, width: float) -> np.ndarray:
    """Values on the lattice [N, L, L, C] under a Gaussian of so many grid pixels."""
    # As a product of matrices it takes a fraction of the time of a filter along strided axes.
    weights = gaussian_filter1d(np.eye(values.shape[1]), width * FINE, axis=0, mode="nearest")
    rows = weights @ values.reshape(len(values), values.shape[1], -1)
    return weights @ rows.reshape(values.shape)
