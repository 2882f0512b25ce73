"""The depth-change sequence of a dent: changes of the depth around a contact, frame by frame, and their noise.

A contact is one point of a dent. Its surroundings sink with it and determine far more
(docs/reports/identifiability.md). Pixels stay where they are while tissue moves: `physics.patches` finds the mesh's
vertices that they show.
"""

from __future__ import annotations

import math
from typing import Any, Self

import numpy as np

from palpate.data.labels import TISSUE
from palpate.physics.depth import DepthSequence, SequenceNoise
from palpate.physics.mesh import Mesh
from palpate.physics.patches import REACH

ASIDE = 6
"""Distance of a dent's middle from the contact that is found, at most: an instrument hides where it presses [grid
pixels]."""
KEPT = REACH + ASIDE
"""Distance up to which the change around a contact is kept [grid pixels]."""
FAR = 25
"""Least distance from the contact at which the depth's noise and the camera's motion are measured [grid pixels]."""
MIN_FAR = 200
"""Smallest number of such pixels that determine either."""
OUTLIER = 4.0
"""Largest change from frame to frame that is noise [standard deviations]."""


class SequenceRecorder:
    """Gathers the depth-change sequence of one contact; memory doesn't grow with the picture.

    Args:
        mesh: tissue at rest.
        vertex: the contact.
        noise: standard deviation of the depth about the smoothed tissue [scene units].
        size: picture's width and height [px].
    """

    def __init__(self, mesh: Mesh, vertex: int, noise: float, size: tuple[int, int]) -> None:
        self._noise, self._size = noise, size
        self._rest = np.full(mesh.grid_shape, np.nan)
        self._rest[tuple(mesh.pixels.T)] = mesh.vertices[:, 2]
        centre = mesh.pixels[vertex]
        self._window = np.pad(self._rest, KEPT, constant_values=np.nan)[window_around(centre + KEPT)]
        self._centre = centre
        apart = np.abs(mesh.pixels - centre).max(axis=1)
        far = mesh.pixels[apart >= FAR]
        self._far = np.ravel_multi_index(tuple(far.T), mesh.grid_shape)
        self._far_rest = self._rest.ravel()[self._far]
        self._columns = np.vstack([np.ones(len(far)), (far - centre).T / FAR])
        self._before: np.ndarray | None = None
        self._measured: list[tuple[np.ndarray, int]] = []
        """`_products` of the first frame's errors, and of every two frames' difference."""

    @classmethod
    def of(cls, mesh: Mesh, vertex: int, noise: float, size: tuple[int, int], onset: Any) -> Self | None:
        """Begin with the first frame of a contact; None if the noise isn't known."""
        if not math.isfinite(noise):
            return None
        found = cls(mesh, vertex, float(np.float32(noise)), size)
        found.frame(onset)
        return found

    def frame(self, frame: Any) -> np.ndarray | None:
        """Change of the depth in a frame, shape [2·KEPT + 1, 2·KEPT + 1]; None where the camera's motion isn't
        known, or a stored frame comes without its depth.
        """
        depth = frame.depth
        if depth is None:
            return None
        visible = np.where((frame.labels == TISSUE) & (depth > 0), depth, np.nan)
        # Scale and tilt are the camera's or the depth network's; they are relative to the distance.
        far = visible.ravel()[self._far]
        known = valid = np.isfinite(far)
        relative = np.where(valid, far / self._far_rest - 1, 0.0)
        for _ in range(3):
            if known.sum() < MIN_FAR:
                return None
            columns = self._columns * known
            motion = np.linalg.lstsq(columns @ self._columns.T, columns @ relative, rcond=None)[0]
            left = relative - motion @ self._columns
            known = known & (np.abs(left) <= OUTLIER * np.sqrt(np.mean(np.square(left), where=known)) + 1e-12)
        self._measure(np.where(valid, left * self._far_rest, np.nan))
        rows, columns = np.mgrid[-KEPT : KEPT + 1, -KEPT : KEPT + 1] / FAR
        moved = motion[0] + motion[1] * rows + motion[2] * columns
        window = np.pad(visible, KEPT, constant_values=np.nan)[window_around(self._centre + KEPT)]
        return (window - self._window * (1 + moved)).astype(np.float32)

    def _measure(self, left: np.ndarray) -> None:
        """Measure the noise: errors of the far pixels [Q], and their change since the frame before."""
        first = self._before is None
        values, largest = (left, 1.0) if first else (left - self._before, math.sqrt(2))
        self._measured.append(self._products(values, largest * OUTLIER * self._noise))
        self._before = left

    def _products(self, left: np.ndarray, largest: float) -> tuple[np.ndarray, int]:
        """Mean square of the far pixels' values, and mean products with lower and right neighbours', [3]; their least
        number.
        """
        picture = np.full(self._rest.shape, np.nan)
        np.put(picture, self._far, np.where(np.abs(left) <= largest, left, np.nan))
        pairs = picture * picture, picture[1:] * picture[:-1], picture[:, 1:] * picture[:, :-1]
        known = [pair[np.isfinite(pair)] for pair in pairs]
        return np.array([pair.mean() if len(pair) else 0.0 for pair in known]), min(map(len, known))

    def noise(self, count: int) -> SequenceNoise:
        """Return the noise as measured in the first frame and `count` after it; with 0, all of it counts as new."""
        later = self._measured[1 : count + 1]
        if not later:
            return SequenceNoise(self._noise, 0.0)
        (first, first_pairs), total = self._measured[0], self._noise**2
        changes, pairs = np.mean([products for products, _ in later], axis=0), sum(number for _, number in later)
        new = min(0.5 * changes[0], total)
        still, share = total - new, 0.1  # of the other part, below which one is not distinguished from none
        if still < share * new:
            return SequenceNoise(self._noise, 0.0, _correlated(changes, pairs))
        in_time = _correlated(changes, pairs) if new > share * still else 1.0
        return SequenceNoise(math.sqrt(new), math.sqrt(still), in_time, _correlated(first - 0.5 * changes, first_pairs))

    def record(self, times: np.ndarray, changes: list[np.ndarray], known: int) -> DepthSequence:
        """Sequence of some frames, its noise as measured in the first frame and `known` ones after it."""
        size = 2 * KEPT + 1
        around = np.stack(changes) if changes else np.empty((0, size, size), np.float32)
        inner = slice(KEPT - REACH, KEPT + REACH + 1)
        noise = self.noise(known)
        return DepthSequence(np.asarray(times, np.float64), around[:, inner, inner], noise, self._size, around)


def window_around(centre: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns within KEPT of a pixel (row, column)."""
    row, column = (int(value) for value in centre)
    return np.s_[row - KEPT : row + KEPT + 1, column - KEPT : column + KEPT + 1]


def _correlated(products: np.ndarray, pairs: int) -> float:
    """Number of pixels that count as one, from mean square and products with both neighbours, [3], of `pairs` pairs.

    The correlation of noise that was blurred by a Gaussian falls as ρ^(k²).
    """
    square, *neighbours = products
    found = 1.0
    for product in neighbours if square > 0 else ():
        correlation = min(product / square, 0.999)
        # Correlations below three standard deviations of white noise's are chance. At 854x480 pixels of the grid share
        # pixels of the picture, and 0.05 is none.
        if correlation > 3.0 / math.sqrt(max(pairs, 1)):
            # Noise of pixels that are farther apart than 12 grid pixels is independent.
            found *= 1 + 2 * float(np.power(correlation, np.arange(1, 13) ** 2).sum())
    return found
