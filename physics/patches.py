"""Vertices of the mesh that the pixels around a contact show while the tissue moves.

Every vertex carries the patch of tissue up to half-way to its neighbours, which sinks as the vertex does. A pixel shows
the patch that has come to lie there; a pixel of the grid that is the mean of several of the picture shows the mean of
what they show.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.physics.jit import inlined, kernel
from palpate.physics.mesh import Mesh, focal_length

REACH = 7
"""Rows and columns from the contact within which pixels are compared.

In nine simulated contacts those up to 6 away held 95 % of the information, those up to 8 held 99 %."""
MAX_SHIFT = 2
"""Largest shift of patches that are known [grid pixels]."""


class Patches:
    """The patches around a contact at rest; V vertices, P = (2·reach + 1)² pixels, row by row.

    Args:
        mesh: tissue at rest, a vertex a pixel of its grid.
        vertex: the contact.
        size: width and height of the picture that was brought to the mesh's grid [px].
        reach: rows and columns from the contact.
        parts: number of parts of a larger picture's pixel along an axis that may each show another patch.
    """

    def __init__(self, mesh: Mesh, vertex: int, size: tuple[int, int], reach: int = REACH, parts: int = 1) -> None:
        self.size, self._side = size, 2 * reach + 1
        pixels = np.arange(-reach, reach + 1)
        reach += MAX_SHIFT
        offsets = mesh.pixels - mesh.pixels[vertex]
        rows, columns = np.abs(offsets).T
        self.vertices = np.flatnonzero((rows <= reach) & (columns <= reach))
        """Vertices of the mesh, shape [V]."""
        self._cells = tuple((offsets[self.vertices] + reach).T)
        self._size = 2 * reach + 1
        rest = mesh.vertices[self.vertices].astype(np.float64)
        self._depth, self._rays = rest[:, 2], rest[:, :2] / rest[:, 2:]
        self._focal = focal_length(mesh)
        self._slope = self._rest_slope()
        self._pull = self._slope[:, ::-1] * self._focal
        centre = mesh.pixels[vertex]
        axes = zip(centre, mesh.grid_shape, size[::-1], strict=True)
        rows, columns = (footprint(int(middle) + pixels, cells, length, parts) for middle, cells, length in axes)
        side, down, across = self._side, rows[0].shape[1], columns[0].shape[1]
        shape = (side, side, down, across)
        places = (rows[0] - centre[0])[:, None, :, None], (columns[0] - centre[1])[None, :, None, :]
        self._places = np.stack([np.broadcast_to(part, shape) for part in places], axis=-1) + reach
        """Places of the picture's pixels in the square around the contact, shape [side, side, rows, columns, 2]."""
        self.weights = (rows[1][:, None, :, None] * columns[1][None, :, None, :]).reshape(side * side, down * across)
        """Share of every sample in its pixel of the grid, shape [P, K]."""
        self.averages = self.weights.shape[1] > 1
        """True if a pixel of the grid is the mean of several of the picture."""

    def own(self) -> np.ndarray:
        """The vertex in every pixel at rest, as a place among the V, shape [P]; -1 where none is known."""
        return self._number()[MAX_SHIFT:-MAX_SHIFT, MAX_SHIFT:-MAX_SHIFT].ravel()

    def _number(self) -> np.ndarray:
        """Vertex in each pixel of the whole square of pixels around the contact, shape [S, S]."""
        number = np.full((self._size, self._size), -1)
        number[self._cells] = np.arange(len(self.vertices))
        return number

    def _rest_slope(self) -> np.ndarray:
        """Change of the depth at rest from row to row and from column to column, shape [V, 2] [scene units]."""
        depth = self._dense(self._depth[None])[0]
        slopes = []
        for axis in (0, 1):
            ahead, behind = np.diff(depth, axis=axis, append=np.nan), np.diff(depth, axis=axis, prepend=np.nan)
            both = np.stack([ahead, behind])
            count = np.isfinite(both).sum(axis=0)
            slopes.append((np.nansum(both, axis=0) / np.maximum(count, 1))[self._cells])
        return np.stack(slopes, axis=-1)

    def _dense(self, values: np.ndarray) -> np.ndarray:
        """Values [N, V, ...] on the square of pixels around the contact, NaN where there is no vertex."""
        dense = np.full((len(values), self._size, self._size, *values.shape[2:]), np.nan)
        dense[:, self._cells[0], self._cells[1]] = values
        return dense

    def shift(self, moved: np.ndarray) -> np.ndarray:
        """Shifts of the patches in the picture by displacements [N, V, 3], shape [N, V, 2], rows and columns."""
        across = moved[..., :2] - self._rays * moved[..., 2:]
        return (self._focal * across / (self._depth[:, None] + moved[..., 2:]))[..., ::-1]

    def sunk(self, moved: np.ndarray, some: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Change by displacements [N, V, 3] of the depth of a pixel that the patch covers, shape [N, V].

        A patch that shifts along sloping tissue changes it as well.

        Args:
            moved: displacements of all patches or, with their places among the V, of some.
            some: these places.
        """
        (across, down, away), pull = np.moveaxis(moved, -1, 0), self._pull[some]
        along = pull[:, 0] * (across - self._rays[some, 0] * away) + pull[:, 1] * (down - self._rays[some, 1] * away)
        return away - along / (self._depth[some] + away)

    def sunk_slopes(self, moved: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Derivatives of `sunk` from those of the displacements, shapes [N, V, 3, D] to [N, V, D]."""
        after, pull = self._depth + moved[..., 2], self._pull
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

    def turning(self, moved: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Change of the pixels' depth because they come to show other patches, where they are means of several.

        Args:
            moved, slopes: displacements [N, V, 3] and their derivatives [N, V, 3, D].

        Returns:
            Its derivatives [N, P, D]; 0 where a pixel of the grid is one of the picture: that shows one patch, then
            another.
        """
        if not self.averages:
            return np.zeros((len(moved), self._side**2, slopes.shape[-1]))
        place = self._at_rest(moved)
        dense = self._dense(np.concatenate([self.sunk(moved)[..., None], self.shift(moved)], axis=-1))
        steps = [between(dense, place + half) - between(dense, place - half) for half in 0.5 * np.eye(2)]
        gradient = np.stack(steps, axis=-1)
        flat = self._shift_slopes(moved, slopes).reshape(*moved.shape[:2], -1)
        shifting = between(self._dense(flat), place).reshape(*place.shape, -1)
        # What a pixel shows lies at x with x + shift(x) = pixel.
        inverse = np.linalg.inv(np.eye(2) + np.nan_to_num(gradient[..., 1:, :]))
        return np.nan_to_num(-np.einsum("npi,npij,npjd->npd", gradient[..., 0, :], inverse, shifting))

    def steepness(self, moved: np.ndarray) -> np.ndarray:
        """Difference of its neighbours from a pixel, where it is the mean of several, at displacements [N, V, 3].

        Root mean square along an axis, shape [N, P]; 0 where a pixel of the grid is one of the picture.
        """
        if not self.averages:
            return np.zeros((len(moved), self._side**2))
        cross = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # a pixel and its neighbours
        places = self._at_rest(moved)[:, None] + cross[:, None]
        found = between(self._dense(self.sunk(moved)[..., None]), places.reshape(len(moved), -1, 2))
        found = found.reshape(places.shape[:3])
        return np.sqrt(0.5 * np.square(np.nan_to_num(found[:, 1:] - found[:, :1])).sum(axis=1))

    def _at_rest(self, moved: np.ndarray) -> np.ndarray:
        """Places at rest of what the pixels' middles show, shape [N, P, 2]; themselves in folds, and out of sight."""
        middle = np.mgrid[: self._side, : self._side].reshape(2, -1).T + float(MAX_SHIFT)
        place = _settled(self._dense(self.shift(moved)), middle)
        return np.where(np.isfinite(place), place, middle)

    def covering(self, moved: np.ndarray) -> np.ndarray:
        """Vertices, as places among the V, that every pixel's samples show: shape [N, P, K]; -1 where none is known."""
        return _nearest(self._sampled(moved), self._number()).reshape(len(moved), *self.weights.shape)

    def blurs(self, moved: np.ndarray, covering: np.ndarray) -> np.ndarray:
        """Change of pixels that are means if tissue sinks linearly between vertices, and if depth is blurred.

        Args:
            moved: displacements [N, V, 3].
            covering: output of `covering` at that motion.

        Returns:
            Changes of every pixel's depth, shape [P, N, 2]; none where a pixel of the grid is one of the picture.
        """
        count, pixels = covering.shape[:2]
        if not self.averages:
            return np.zeros((pixels, count, 0))
        sunk = self.sunk(moved)
        samples = between(self._dense(sunk[..., None]), self._sampled(moved)).reshape(covering.shape)
        linear = np.nan_to_num((samples * self.weights).sum(axis=2))
        square = linear.reshape(count, self._side, self._side)
        blur = 0.7  # standard deviation of a blur of the depth by its sensor that is as likely as none [grid pixels]
        blurred = gaussian_filter(square, (0, blur, blur), mode="nearest").reshape(linear.shape)
        found = np.stack([linear - self.shown(sunk, covering), blurred - linear], axis=-1)
        return np.nan_to_num(found).swapaxes(0, 1)

    def _sampled(self, moved: np.ndarray) -> np.ndarray:
        """Places at rest of what the samples show, shape [N, P·K, 2].

        Between vertices the shift is linear; a sample shows the place at rest whose shift leads to the sample.
        """
        # Where there is no vertex nothing shifts, and nothing is shown.
        shift, samples = np.nan_to_num(self._dense(self.shift(moved))), self._places.reshape(-1, 2)
        if not self.averages:
            return _settled(shift, samples)
        # Between samples half a pixel apart it hardly bends, and they are far fewer.
        side = 2 * (self._side + 1) + 1
        lattice = np.mgrid[:side, :side].reshape(2, -1).T / 2 + (MAX_SHIFT - 1)
        found = _settled(shift, lattice).reshape(-1, side, side, 2)
        places = np.broadcast_to(2 * (samples - (MAX_SHIFT - 1)), (len(moved), *samples.shape))
        return between(found, places)

    def shown(self, values: np.ndarray, covering: np.ndarray) -> np.ndarray:
        """Values of the vertices [N, V, ...] as every pixel shows them, the mean over its samples, shape [N, P, ...].

        Not a number where a sample shows nothing known.
        """
        flat = np.ascontiguousarray(values).reshape(*values.shape[:2], -1)
        return _mean_of(flat, covering, self.weights).reshape(*covering.shape[:2], *values.shape[2:])


def footprint(cells: np.ndarray, count: int, pixels: int, parts: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Places along one axis of the pixels whose mean some cells of the grid are, and their shares, shapes [C, K] each.

    Args:
        cells: indices, shape [C].
        count: cells of the grid.
        pixels: number of pixels of the picture.
        parts: number of parts of each pixel, if a cell has more than one.

    Returns:
        Middles of the pixels in the grid [grid pixels]: those of an area average, as `data.depth.normalise` shrinks.
    """
    size, most = pixels / count, 6  # more pixels of the picture are represented by six places, evenly spread
    if size > 1 and parts > 1:
        middles, shares = footprint(cells, count, pixels)
        within = ((np.arange(parts) + 0.5) / parts - 0.5) / min(size, most)
        return (middles[:, :, None] + within).reshape(len(cells), -1), np.repeat(shares / parts, parts, axis=1)
    if size <= 1 or size > most:
        each = 1 if size <= 1 else most
        inside = (np.arange(each) + 0.5) / each - 0.5
        return cells[:, None] + inside, np.full((len(cells), each), 1 / each)
    begin, end = cells * size, (cells + 1) * size
    found = np.floor(begin)[:, None] + np.arange(int(np.ceil(size)) + 1)
    share = np.clip(np.minimum(found + 1, end[:, None]) - np.maximum(found, begin[:, None]), 0, None) / size
    # What only touches a cell by rounding isn't part of it.
    share = np.where(share < 1e-6, 0, share)
    return (found + 0.5) / size - 0.5, share / share.sum(axis=1, keepdims=True)


@inlined
def corner(along, last):
    """The place within the square, and the row or column before it."""
    along = min(max(along, 0.0), last)
    return along, min(int(along), int(last) - 1)


@inlined
def bilinear(values, top, left, down, right, channel):
    """One channel of values [S, S, C] between four of them."""
    upper, lower = values[top, left, channel], values[top + 1, left, channel]
    upper += right * (values[top, left + 1, channel] - upper)
    lower += right * (values[top + 1, left + 1, channel] - lower)
    return upper + down * (lower - upper)


@kernel
def between(values, place):
    """Values on the square [N, S, S, C] at places (row, column) in every frame [N, Q, 2], bilinear, shape [N, Q, C].

    Beyond the square's ends those at the ends; NaN at places that are NaN, and next to such values.
    """
    found = np.empty((place.shape[0], place.shape[1], values.shape[3]))
    last = values.shape[1] - 1.0
    for frame in range(place.shape[0]):
        for index in range(place.shape[1]):
            row, column = place[frame, index, 0], place[frame, index, 1]
            if np.isnan(row + column):
                found[frame, index] = np.nan
                continue
            row, top = corner(row, last)
            column, left = corner(column, last)
            for channel in range(values.shape[3]):
                found[frame, index, channel] = bilinear(values[frame], top, left, row - top, column - left, channel)
    return found


@kernel
def _settled(shift, samples):
    """Places at rest of what samples show, shape [N, Q, 2]; NaN in folds, and out of sight.

    Args:
        shift: on the square, by rows and columns, shape [N, S, S, 2].
        samples: row and column on the square, shape [Q, 2].
    """
    found = np.full((shift.shape[0], *samples.shape), np.nan)
    last = shift.shape[1] - 1.0
    for frame in range(shift.shape[0]):
        for index in range(samples.shape[0]):
            row, column, change = samples[index, 0], samples[index, 1], np.inf
            for _ in range(12):  # a shift of s grid pixels a pixel needs log(0.05)/log(s) rounds
                near_row, top = corner(row, last)
                near_column, left = corner(column, last)
                down, right = near_row - top, near_column - left
                next_row = samples[index, 0] - bilinear(shift[frame], top, left, down, right, 0)
                next_column = samples[index, 1] - bilinear(shift[frame], top, left, down, right, 1)
                change = max(abs(next_row - row), abs(next_column - column))
                row, column = next_row, next_column
                if np.isnan(row + column) or change <= 1e-3:
                    break
            if not np.isnan(row + column) and change < 0.05:  # in folds the last round moves farther
                found[frame, index, 0], found[frame, index, 1] = row, column
    return found


@kernel
def _mean_of(values, covering, weights):
    """Mean [N, P, C] of values [N, V, C] over samples that show vertices [N, P, K] with weights [P, K]."""
    found = np.zeros((covering.shape[0], covering.shape[1], values.shape[2]))
    for frame in range(covering.shape[0]):
        for pixel in range(covering.shape[1]):
            for sample in range(covering.shape[2]):
                vertex, weight = covering[frame, pixel, sample], weights[pixel, sample]
                if weight > 0:
                    for channel in range(values.shape[2]):
                        value = values[frame, vertex, channel] if vertex >= 0 else np.nan
                        found[frame, pixel, channel] += weight * value
    return found


def _nearest(place: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Numbers [S, S] nearest to places [N, Q, 2], shape [N, Q]; -1 where these lie outside or aren't known."""
    inside = (np.abs(place - (len(number) - 1) / 2) <= len(number) / 2).all(axis=-1)
    nearest = np.rint(np.where(inside[..., None], place, 0)).clip(0, len(number) - 1).astype(int)
    return np.where(inside, number[nearest[..., 0], nearest[..., 1]], -1)
