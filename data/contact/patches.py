"""Which of the mesh's vertices the pixels around a contact show while the tissue moves.

Every vertex carries the patch of tissue up to half-way to its neighbours, which sinks as the vertex does. A pixel shows
the patch that has come to lie there; a pixel of the grid that is the mean of several of the picture shows the mean of
what they show.
"""

from __future__ import annotations

import numpy as np

from data.contact.film import REACH
from physics.mesh import Mesh

LARGEST_SHIFT = 2
"""Patches that come from farther away than this are not known [grid pixels]."""
ITERATIONS = 12
"""To find what a sample shows; tissue that shifts by s grid pixels a pixel needs log(SETTLED)/log(s) of them."""
EXACT = 0.01
"""No more of them once all have settled to this [grid pixels]."""
SETTLED = 0.05
"""What still moves by more than this in the last of them lies in a fold [grid pixels]."""
MOST_SAMPLES = 6
"""Of larger pictures as many places a pixel of the grid, evenly spread, stand for its pixels along an axis."""

ENOUGH = 1000
"""Vertices that tell the focal lengths."""


class Patches:
    """The patches around a contact at rest; V vertices, P = (2·reach + 1)² pixels, row by row.

    Args:
        mesh: tissue at rest, a vertex a pixel of its grid.
        vertex: the contact.
        size: width and height of the picture that was brought to the mesh's grid [px].
        reach: rows and columns from the contact.
    """

    def __init__(self, mesh: Mesh, vertex: int, size: tuple[int, int], reach: int = REACH) -> None:
        self.size, self._side = size, 2 * reach + 1
        pixels = np.arange(-reach, reach + 1)
        reach += LARGEST_SHIFT
        offsets = mesh.pixels - mesh.pixels[vertex]
        self.vertices = np.flatnonzero(np.abs(offsets).max(axis=1) <= reach)
        """Vertices of the mesh, shape [V]."""
        self._cells = tuple((offsets[self.vertices] + reach).T)
        self._size = 2 * reach + 1
        rest = mesh.vertices[self.vertices].astype(np.float64)
        self._depth, self._rays = rest[:, 2], rest[:, :2] / rest[:, 2:]
        self._focal = focal_length(mesh)
        self._slope = self._rest_slope()
        centre = mesh.pixels[vertex]
        rows, columns = (
            footprint(int(middle) + pixels, cells, length)
            for middle, cells, length in zip(centre, mesh.grid_shape, size[::-1], strict=True)
        )
        side, down, across = self._side, rows[0].shape[1], columns[0].shape[1]
        shape = (side, side, down, across)
        places = (rows[0] - centre[0])[:, None, :, None], (columns[0] - centre[1])[None, :, None, :]
        self._places = np.stack([np.broadcast_to(part, shape) for part in places], axis=-1) + reach
        """Of the picture's pixels in the square around the contact, shape [side, side, rows, columns, 2]."""
        self.weights = (rows[1][:, None, :, None] * columns[1][None, :, None, :]).reshape(side * side, down * across)
        """Share of every sample in its pixel of the grid, shape [P, K]."""

    def own(self) -> np.ndarray:
        """The vertex in every pixel at rest, as a place among the V, shape [P]; -1 where none is known."""
        return self._number()[LARGEST_SHIFT:-LARGEST_SHIFT, LARGEST_SHIFT:-LARGEST_SHIFT].ravel()

    def _number(self) -> np.ndarray:
        """The same on the whole square of pixels around the contact, shape [S, S]."""
        number = np.full((self._size, self._size), -1)
        number[self._cells] = np.arange(len(self.vertices))
        return number

    def _rest_slope(self) -> np.ndarray:
        """Change of the depth at rest from row to row and from column to column, shape [V, 2] [scene units]."""
        depth = self._dense(self._depth[None])[0]
        slopes = []
        for axis in (0, 1):
            ahead, behind = (np.roll(depth, shift, axis) for shift in (-1, 1))
            last = np.s_[-1:, :] if axis == 0 else np.s_[:, -1:]
            first = np.s_[:1, :] if axis == 0 else np.s_[:, :1]
            ahead[last], behind[first] = np.nan, np.nan
            both = np.stack([ahead - depth, depth - behind])
            count = np.isfinite(both).sum(axis=0)
            slopes.append((np.nansum(both, axis=0) / np.maximum(count, 1))[self._cells])
        return np.stack(slopes, axis=-1)

    def _dense(self, values: np.ndarray) -> np.ndarray:
        """Values [N, V, ...] on the square of pixels around the contact, not a number where there is no vertex."""
        dense = np.full((len(values), self._size, self._size, *values.shape[2:]), np.nan)
        dense[:, self._cells[0], self._cells[1]] = values
        return dense

    def shift(self, moved: np.ndarray) -> np.ndarray:
        """By how much displacements [N, V, 3] move the patches in the picture, shape [N, V, 2], rows and columns."""
        across = moved[..., :2] - self._rays * moved[..., 2:]
        return (self._focal * across / (self._depth[:, None] + moved[..., 2:]))[..., ::-1]

    def sunk(self, moved: np.ndarray) -> np.ndarray:
        """By how much displacements [N, V, 3] change the depth of a pixel that the patch covers, shape [N, V].

        A patch that shifts along sloping tissue changes it as well.
        """
        return moved[..., 2] - (self._slope * self.shift(moved)).sum(axis=-1)

    def sunk_slopes(self, moved: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Derivatives of `sunk` from those of the displacements, shapes [N, V, 3, D] to [N, V, D]."""
        after, pull = self._depth + moved[..., 2], self._slope[:, ::-1] * self._focal
        sinking = after + (self._slope * self.shift(moved)).sum(axis=-1) + (pull * self._rays).sum(axis=-1)
        across = np.broadcast_to(-pull, (*after.shape, 2))
        by_motion = np.concatenate([across, sinking[..., None]], axis=-1) / after[..., None]
        return np.matmul(by_motion[..., None, :], slopes)[..., 0, :]

    def _shift_slopes(self, moved: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Derivatives of `shift` from those of the displacements, shapes [N, V, 3, D] to [N, V, 2, D]."""
        along = slopes[..., 2:, :]
        after = (self._depth[:, None] + moved[..., 2:])[..., None]
        across = self._focal[:, None] * (slopes[..., :2, :] - self._rays[:, :, None] * along) / after
        return across[..., ::-1, :] - self.shift(moved)[..., None] * along / after

    @property
    def averages(self) -> bool:
        """Whether a pixel of the grid is the mean of several of the picture."""
        return self.weights.shape[1] > 1

    def turning(self, moved: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """How the pixels' depth changes because they come to show other patches, where they are means of several.

        Args:
            moved, slopes: displacements [N, V, 3] and their derivatives [N, V, 3, D].

        Returns:
            Its derivatives [N, P, D]; 0 where a pixel of the grid is one of the picture: that shows one patch, then
            another.
        """
        if not self.averages:
            return np.zeros((len(moved), self._side**2, slopes.shape[-1]))
        frames, place = self._at_rest(moved)
        values = np.concatenate([self.sunk(moved)[..., None], self.shift(moved)], axis=-1)
        dense = np.moveaxis(self._dense(values), -1, 0)
        gradient = np.stack(
            [_between(dense, frames, place + half) - _between(dense, frames, place - half) for half in 0.5 * np.eye(2)],
            axis=-1,
        )
        flat = self._shift_slopes(moved, slopes).reshape(*moved.shape[:2], -1)
        shifting = _between(np.moveaxis(self._dense(flat), -1, 0), frames, place).reshape(*place.shape, -1)
        # What a pixel shows lies at x with x + shift(x) = pixel.
        inverse = np.linalg.inv(np.eye(2) + np.nan_to_num(gradient[..., 1:, :]))
        return np.nan_to_num(-np.einsum("npi,npij,npjd->npd", gradient[..., 0, :], inverse, shifting))

    def seen(self, moved: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change of every pixel's depth since rest, and its derivatives, with what it shows decided at this motion.

        Args:
            moved, slopes: displacements [N, V, 3] and their derivatives [N, V, 3, D].

        Returns:
            Shapes [N, P] and [N, P, D]; not a number where a pixel shows nothing known.
        """
        covering = self.covering(moved)
        tangent = self.shown(self.sunk_slopes(moved, slopes), covering) + self.turning(moved, slopes)
        return self.shown(self.sunk(moved), covering), tangent

    def steepness(self, moved: np.ndarray) -> np.ndarray:
        """How much its neighbours differ from a pixel, where it is the mean of several, at displacements [N, V, 3].

        Root mean square along an axis, shape [N, P]; 0 where a pixel of the grid is one of the picture.
        """
        if not self.averages:
            return np.zeros((len(moved), self._side**2))
        frames, place = self._at_rest(moved)
        dense = self._dense(self.sunk(moved))[None]
        here = _between(dense, frames, place)
        apart = [_between(dense, frames, place + step) - here for axis in np.eye(2) for step in (axis, -axis)]
        return np.sqrt(0.5 * np.square(np.nan_to_num(apart)).sum(axis=0))[..., 0]

    def _at_rest(self, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frames [N, 1], and where what the pixels' middles show lay at rest, shape [N, P, 2]; themselves in folds."""
        shift = np.moveaxis(self._dense(self.shift(moved)), -1, 0)
        middle = np.mgrid[: self._side, : self._side].reshape(2, -1).T[None] + float(LARGEST_SHIFT)
        place = self._origin(shift, middle)
        return np.arange(len(moved))[:, None], np.where(np.isfinite(place), place, middle)

    def covering(self, moved: np.ndarray) -> np.ndarray:
        """Vertices, as places among the V, that every pixel's samples show: shape [N, P, K]; -1 where none is known.

        Between vertices the tissue shifts as they do, in proportion, so that what a sample shows lay at rest where the
        shift there leads to the sample.
        """
        # Where there is no vertex nothing shifts, and nothing is shown.
        shift = np.nan_to_num(np.moveaxis(self._dense(self.shift(moved)), -1, 0).astype(np.float32))
        samples = self._places.reshape(1, -1, 2).astype(np.float32)
        if not self.averages:
            place = self._origin(shift, samples)
        else:
            # Between samples half a pixel apart it hardly bends, and they are far fewer.
            side = 2 * (self._side + 1) + 1
            lattice = np.mgrid[:side, :side].reshape(2, -1).T[None] / np.float32(2) + np.float32(LARGEST_SHIFT - 1)
            found = np.moveaxis(self._origin(shift, lattice).reshape(-1, side, side, 2), -1, 0)
            frames = np.arange(len(moved))[:, None]
            place = _between(found, frames, 2 * (samples - (LARGEST_SHIFT - 1)))
        number = self._number()
        nearest = np.clip(np.rint(np.nan_to_num(place)), 0, self._size - 1).astype(np.int64)
        down, right = np.moveaxis(np.abs(place - (self._size - 1) / 2) <= self._size / 2, -1, 0)
        found = np.where(down & right, number[nearest[..., 0], nearest[..., 1]], -1)
        return found.reshape(len(moved), *self.weights.shape)

    def _origin(self, shift: np.ndarray, samples: np.ndarray) -> np.ndarray:
        """Where what samples [1, Q, 2] show lay at rest, shape [N, Q, 2]; not a number in folds, and out of sight."""
        place = np.broadcast_to(samples, (shift.shape[1], *samples.shape[1:]))
        frames, change = np.arange(len(place))[:, None], np.zeros(place.shape[:2])
        for _ in range(ITERATIONS):
            before, place = place, samples - _between(shift, frames, place)
            down, right = np.moveaxis(np.abs(place - before), -1, 0)
            change = np.maximum(down, right)  # faster than along an axis of two
            if not (change > EXACT).any():
                break
        return np.where((change < SETTLED)[..., None], place, np.nan)

    def shown(self, values: np.ndarray, covering: np.ndarray) -> np.ndarray:
        """Values of the vertices [N, V, ...] as every pixel shows them, the mean over its samples, shape [N, P, ...].

        Not a number where a sample shows nothing known.
        """
        frames = np.arange(len(values))[:, None]
        total = np.zeros((*covering.shape[:2], *values.shape[2:]))
        for sample, weight in zip(np.moveaxis(covering, 2, 0), self.weights.T, strict=True):
            total += values[frames, sample] * weight.reshape(-1, *(1,) * (values.ndim - 2))
        total[((covering < 0) & (self.weights > 0)).any(axis=2)] = np.nan
        return total


def footprint(cells: np.ndarray, count: int, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """Where along one axis the pixels lie whose mean some cells of the grid are, and their shares, shapes [C, K] each.

    Args:
        cells: indices, shape [C].
        count: cells of the grid.
        pixels: of the picture.

    Returns:
        Middles of the pixels in the grid [grid pixels]: those of an area average, as `data.depth.normalise` shrinks.
    """
    size = pixels / count
    if size <= 1 or size > MOST_SAMPLES:
        each = 1 if size <= 1 else MOST_SAMPLES
        inside = (np.arange(each) + 0.5) / each - 0.5
        return cells[:, None] + inside, np.full((len(cells), each), 1 / each)
    begin, end = cells * size, (cells + 1) * size
    found = np.floor(begin)[:, None] + np.arange(int(np.ceil(size)) + 1)
    share = np.clip(np.minimum(found + 1, end[:, None]) - np.maximum(found, begin[:, None]), 0, None) / size
    # What only touches a cell by rounding isn't part of it.
    share = np.where(share < 1e-6, 0, share)
    return (found + 0.5) / size - 0.5, share / share.sum(axis=1, keepdims=True)


def _between(values: np.ndarray, frames: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values on the square [C, N, S, S] at places (row, column) in every frame [N, Q, 2], bilinear, shape [N, Q, C]."""
    side = values.shape[2]
    place = np.clip(place, 0, side - 1)
    corner = np.minimum(np.nan_to_num(place), side - 2).astype(np.intp)
    down, right = np.moveaxis(place - corner, -1, 0)
    first = (frames * side + corner[..., 0]) * side + corner[..., 1]
    flat = values.reshape(len(values), -1)
    upper, upper_right, lower, lower_right = (flat.take(first + step, axis=1) for step in (0, 1, side, side + 1))
    upper += right * (upper_right - upper)
    lower += right * (lower_right - lower)
    upper += down * (lower - upper)
    return np.moveaxis(upper, 0, -1)


def focal_length(mesh: Mesh) -> np.ndarray:
    """Focal lengths along x and y, from the places of the mesh's vertices in its grid, shape [2] [grid pixels]."""
    some = np.s_[:: max(1, len(mesh.vertices) // ENOUGH)]  # all lie on the same two lines
    rays = mesh.vertices[some, :2].astype(np.float64) / mesh.vertices[some, 2:]
    places = mesh.pixels[some, ::-1].astype(np.float64)
    rays, places = rays - rays.mean(axis=0), places - places.mean(axis=0)
    return (rays * places).sum(axis=0) / np.square(rays).sum(axis=0)
