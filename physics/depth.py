"""Depth of the tissue around a contact against a motion: observations, expected errors, and the likelihood.

What a pixel shows at a motion is `physics.patches`'; it is decided for a motion near the best and then kept.
Errors are new in every frame, or stay where tissue is still and turn with it like a sawtooth where depth is rounded
(`rounding_covariance`); the rest surface's own error is smooth and the same in all frames. All of that is
one normal distribution, in which pixels that are far off count less, so that an outlier does not decide.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from palpate.physics.mesh import Mesh
from palpate.physics.observation import CommonErrors, Linearised
from palpate.physics.patches import REACH, Patches

REST_SHARE, REST_LENGTH = 0.1, 5.0
"""Standard deviation of the rest surface's error [σ], and its correlation length [grid pixels]."""
REST_KEPT = 0.99
"""Share of the rest surface's variance that `smooth_errors` keeps."""
OUTLIER = 4.0
"""Largest residual that counts in full: larger ones are weighted down to it [σ]."""
MOVED = 3.0
"""Least change of a pixel that moves, which counts for the misfit [σ]."""
STILL_NEW = 0.05
"""Share of the staying errors' variance that is new in every frame: nothing stays exactly."""
WALL = 0.08
"""Standard deviation of a pixel's error at a dent's wall, as a share of how much its neighbours differ from it."""
PARTIAL = 0.3
"""Standard deviation beside what an instrument hides: there a pixel of the grid is the mean of a part of its area."""


@dataclass(frozen=True)
class SequenceNoise:
    """Errors of the depth of a clip's tissue."""

    in_time: float
    """Standard deviation of the error that is new in every frame [scene units]."""
    in_place: float
    """Standard deviation of the error that stays while tissue is still: rounding, the rest surface [scene units]."""
    correlated_in_time: float = 1.0
    """Number of pixels that count as one, for errors that are new: those of neighbours are correlated."""
    correlated_in_place: float = 1.0
    """Number of pixels that count as one, for errors that stay."""

    @property
    def rounded(self) -> bool:
        """True if the errors are those of rounding: hardly any is new while tissue is still."""
        return self.in_time < 0.5 * self.in_place

    @property
    def total(self) -> float:
        """Standard deviation of a pixel's error [scene units]."""
        return math.hypot(self.in_time, self.in_place)


@dataclass(frozen=True, eq=False)
class DepthSequence:
    """Depth around a contact over a run; N frames, S = 2·REACH + 1."""

    times: np.ndarray
    """Times since the onset, shape [N] [s]."""
    change: np.ndarray
    """Depth less that at rest, camera motion subtracted, the contact's pixel in the middle, [N, S, S], float32 [scene
    units]; NaN where no tissue is visible."""
    noise: SequenceNoise
    size: tuple[int, int]
    """Width and height of the picture that was brought to the grid [px]."""
    around: np.ndarray | None = None
    """`change` and A more pixels on every side, shape [N, S + 2·A, S + 2·A]; None = no more."""

    def is_finer_than(self, grid_shape: tuple[int, int]) -> bool:
        """Return whether a pixel of a grid [h, w] is the mean of several of the picture."""
        return self.size[0] > grid_shape[1] or self.size[1] > grid_shape[0]

    def chosen(self, frames: np.ndarray) -> DepthSequence:
        """Subset of its frames: a mask [N] or indices."""
        around = None if self.around is None else self.around[frames]
        return dataclasses.replace(self, times=self.times[frames], change=self.change[frames], around=around)

    def elsewhere(self, row: int, column: int) -> DepthSequence:
        """Sequence of a contact so many rows and columns away; NaN beyond what is known."""
        around = self.change if self.around is None else self.around
        side, most = self.change.shape[1], max(abs(row), abs(column))
        wide = np.pad(around, ((0, 0), (most, most), (most, most)), constant_values=np.nan)
        wide = wide[:, most + row :, most + column :][:, : around.shape[1], : around.shape[2]]
        inner = slice((around.shape[1] - side) // 2, (around.shape[1] + side) // 2)
        return dataclasses.replace(self, change=wide[:, inner, inner], around=wide)


class DepthLikelihood:
    """Likelihood of a depth-change sequence; V vertices, P pixels, N frames, D parameters of the motion.

    `look` decides what the pixels show, before anything else is asked.

    Args:
        mesh, vertex: tissue at rest, and the contact.
        sequence: one frame or more.
        noise: σ of every pixel in every frame [scene units]; None = as the sequence says.
        reach, parts: arguments of `Patches`.
        partial: value in place of PARTIAL.
        astray: standard deviation of a whole frame's lateral shift by axis, in grids coarser than the picture [grid
            pixels]. Half of the variance is the same in all frames.
        uneven: standard deviation of the depth of dents, as a share, half of its variance likewise.
    """

    def __init__(
        self,
        mesh: Mesh,
        vertex: int,
        sequence: DepthSequence,
        noise: float | None = None,
        *,
        reach: int = REACH,
        parts: int = 1,
        partial: float = PARTIAL,
        astray: float = 0.0,
        uneven: float = 0.0,
    ) -> None:
        inner = np.s_[:, REACH - reach : REACH + reach + 1, REACH - reach : REACH + reach + 1]
        self.noise = sequence.noise if noise is None else SequenceNoise(noise, 0.0)
        self.times, change = sequence.times, sequence.change[inner]
        self.patches = Patches(mesh, vertex, sequence.size, reach, parts)
        self.vertices, self._astray, self._uneven = self.patches.vertices, astray, uneven
        self.observed = change.reshape(len(change), math.prod(change.shape[1:])).astype(np.float64)
        """Shape [N, P] [scene units]."""
        beside = maximum_filter(~np.isfinite(sequence.change), (1, 3, 3))[inner].reshape(self.observed.shape)
        self._unevenness = np.where(beside, partial, WALL)
        self.seen = np.isfinite(self.observed)
        """Pixels that show tissue which is known, shape [N, P], bool; all of `look` comes to be known by it."""

    def see(self, moved: np.ndarray) -> np.ndarray:
        """Decide what the pixels show, as `look`; returns the change of their depth, shape [N, P]."""
        self.covering = self.patches.covering(moved)
        """Cover of the pixels as `Patches` gives it, shape [N, P, K]."""
        self._turning: np.ndarray | float = 0.0
        change, total = self.change(moved), self.noise.total
        self.seen = np.isfinite(change - self.observed)
        # Also by the observation: else a model without motion would explain everything. One outlier is no motion.
        clear = (np.abs(np.nan_to_num(self.observed)) > MOVED * total).sum(axis=0) >= 3
        self.moving = (np.abs(np.where(self.seen, change, 0)).max(axis=0) > MOVED * total) | clear
        """Mask of pixels that move clearly, in the model or the observation, shape [P]."""
        self._walls = np.square(self._unevenness * self.patches.steepness(moved))
        self.blurs = self.patches.blurs(moved, self.covering)
        """Changes as in `Patches.blurs`, shape [P, N, 2], or of no columns."""
        return change

    def look(
        self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray | None = None, *, outliers: bool = False
    ) -> None:
        """Decide what the pixels show, and how their errors are correlated, at a motion near the best.

        Args:
            moved, slopes: displacements [N, V, 3] and their derivatives [N, V, 3, D].
            logs: parameters of that motion, shape [D]; None = no other motion is compared.
            outliers: True = pixels far from that motion count less from now on.
        """
        change, total = self.see(moved), self.noise.total
        self._turning, self._looked_at = self.patches.turning(moved, slopes), logs
        weight = np.ones_like(change)
        if outliers:
            apart = np.abs(np.where(self.seen, change - self.observed, 0)) / np.sqrt(total**2 + self._walls)
            weight = np.minimum(1.0, OUTLIER / np.maximum(apart, OUTLIER)) ** 2
        self._whitener = self._whitening(np.where(np.isfinite(change), change, 0.0), weight)

    def _model_errors(self, sunk: np.ndarray) -> np.ndarray:
        """Columns of the model's own error, with independent normal factors, shape [P, N, B].

        A dent as a whole lies aside or is too deep: columns of every frame, then of all.

        Args:
            sunk: change of the depth of every pixel, shape [N, P] [scene units].
        """
        frames, pixels = sunk.shape
        if not (self.patches.averages and (self._astray or self._uneven)):
            return np.zeros((pixels, frames, 0))
        side = math.isqrt(pixels)
        down, across = np.array(np.gradient(sunk.reshape(frames, side, side), axis=(1, 2)))
        ways = [self._astray * down, self._astray * across, self._uneven * sunk]
        common = math.sqrt(0.5) * np.stack([way.reshape(frames, pixels).T for way in ways], axis=-1)
        each = common[:, :, None] * np.eye(frames)[:, :, None]
        return np.concatenate([each.reshape(pixels, frames, -1), common], axis=2)

    def _whitening(self, sunk: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, CommonErrors]:
        """Whitening of every pixel's errors over time [P, N, N], and common errors as it leaves them."""
        noise, frames = self.noise, len(sunk)
        new = noise.correlated_in_time * noise.in_time**2 + noise.total**2 * (1 / weight - 1)
        # Standard deviation of what isn't seen [σ].
        new = np.where(self.seen, new, (1e6 * noise.total) ** 2).T
        walls = np.sqrt(np.where(self.seen, self._walls, 0.0)).T
        # A patch's end stays where it is, more or less.
        covariance = new[:, :, None] * np.eye(frames) + 0.5 * walls[:, :, None] * walls[:, None]
        covariance += 0.5 * np.square(walls)[:, :, None] * np.eye(frames)
        if noise.in_place > 0:
            common = noise.correlated_in_place * (np.ones((1, frames, frames)) + STILL_NEW * np.eye(frames))
            if noise.rounded:
                common = math.sqrt(noise.correlated_in_place) * rounding_covariance(sunk.T / noise.in_place)
            covariance = covariance + noise.in_place**2 * common
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        still = whiten.sum(axis=2)  # [P, N]: what an error that stays is in every frame
        smooth = still[:, :, None] * (noise.total * smooth_errors())[:, None, :]
        errors = np.concatenate([self._model_errors(sunk), self.blurs], axis=2)
        wrong = np.matmul(whiten, np.where(self.seen.T[..., None], errors, 0.0))
        flat = np.concatenate([smooth, wrong], axis=2).reshape(-1, smooth.shape[2] + wrong.shape[2])
        return whiten, CommonErrors(flat)

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Pixels' values [N, P] (or [N, P, D]) in units of their independent errors, shape [N·P + K] (or [..., D])."""
        whiten, common = self._whitener
        values = np.where(self.seen.reshape(self.seen.shape + (1,) * (values.ndim - 2)), values, 0.0)
        flat = np.matmul(whiten, np.moveaxis(values, 0, 1).reshape(len(whiten), len(values), -1))
        found = common.marginalised(flat.reshape(-1, flat.shape[2]))
        return found[:, 0] if values.ndim == 2 else found

    def linearise(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray | None = None) -> Linearised:
        """Whitened simulated minus observed change, and its derivatives; arguments as in `look`."""
        change, tangent = self.change(moved, logs), self.tangent(moved, slopes)
        return Linearised(self.whitened(change - self.observed), self.whitened(tangent))

    def change(self, moved: np.ndarray, logs: np.ndarray | None = None) -> np.ndarray:
        """Change of the depth of every pixel at displacements [N, V, 3] and their parameters [D], shape [N, P].

        What pixels show turns with the parameters, from the last look on.
        """
        change = self.patches.shown(self.patches.sunk(moved), self.covering)
        return change if logs is None else change + self._turning @ (logs - self._looked_at)

    def tangent(self, moved: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Derivatives of `change` by all parameters, shape [N, P, D]."""
        return self.patches.shown(self.patches.sunk_slopes(moved, slopes), self.covering) + self._turning

    @property
    def counted(self) -> float:
        """Number of independent values of pixels that move, by the last look."""
        return float((self.seen & self.moving).sum()) / self.noise.correlated_in_time

    def singly(self, values: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Values [N, P] or [N, P, D] of L pixels, each in units of its own error alone, shape [L] or [L, D]."""
        sigma = np.sqrt(self.noise.total**2 + self._walls[used])
        return values[used] / sigma.reshape(-1, *[1] * (values.ndim - 2))

    def misfit(self, moved: np.ndarray, logs: np.ndarray | None = None) -> float:
        """Root mean square of the residuals of pixels that move, in standard deviations; outliers count in full."""
        left = self.singly(self.change(moved, logs) - self.observed, self.seen & self.moving)
        return float(np.sqrt(np.square(left).mean())) if len(left) else 0.0


def rounding_covariance(simulated: np.ndarray) -> np.ndarray:
    """Covariance of rounding errors between frames, shape [n, M, M] [σ²].

    In theory they correlate as 1 - 6u(1 - u) where depths differ by u steps of rounding.

    Args:
        simulated: displacement along the force, shape [n, M] [σ].
    """
    steps = (simulated[:, :, None] - simulated[:, None]) / math.sqrt(12)  # the error of a step of √12 σ has the SD σ
    part = np.abs(steps) % 1
    # Depths more than 3 steps apart are taken to correlate less than in theory, and a fifth of the variance not at all.
    # A product of positive definite functions of the depths is one too.
    kernel = (1 - 6 * part * (1 - part)) * np.exp(-0.5 * np.square(steps / 3.0))
    return (1 - 0.2) * kernel + 0.2 * np.eye(simulated.shape[1])


@functools.cache
def smooth_errors() -> np.ndarray:
    """Columns of the rest surface's error, with independent normal factors, shape [P, K] [σ]."""
    places = np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1].reshape(2, -1).T
    squares = np.square(places[:, None] - places).sum(axis=-1)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * squares / REST_LENGTH**2))
    values, vectors = values[::-1], vectors[:, ::-1]
    count = int(np.searchsorted(np.cumsum(values) / values.sum(), REST_KEPT)) + 1
    return REST_SHARE * vectors[:, :count] * np.sqrt(values[:count])
