"""The whole dent as a least-squares problem: the depth of all visible tissue around a contact against the simulator.

What a pixel shows at a motion is `data.contact.patches`'; it is decided for a motion near the best and then kept.
Errors are new in every frame, or stay where tissue is still and turn with it like a sawtooth where depth is rounded
(`rounding_covariance`); the rest surface's own error is smooth and the same in all frames. All of that is
one normal distribution, in which pixels that are far off count less, so that an outlier does not decide.
"""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
from scipy.ndimage import maximum_filter

from palpate.data.contact.depth_sequence import SequenceNoise, smooth_errors
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.patches import Patches
from palpate.estimators.direct.motion import Kind, PressMotion
from palpate.physics.likelihood import LeastSquares, Linearised
from palpate.physics.mechanics import Mechanics

OUTLIER = 4.0
"""Residuals of more than this many standard deviations count as if they had as many."""
MOVED, SEVERAL = 3.0, 3
"""Pixels that move by more than so many standard deviations say how well the model explains the motion: in any frame by
the model, or in so many by what is observed, as one outlier is no motion."""
STILL_NEW = 0.05
"""Share of the errors that stay which is taken to be new in every frame: nothing stays exactly."""
WALL = 0.08
"""Standard deviation of a pixel's error at a dent's wall, as a share of how much its neighbours differ from it."""
PARTIAL = 0.3
"""Standard deviation beside what an instrument hides: there a pixel of the grid is the mean of a part of its area."""
STEP = math.sqrt(12)
"""Rounding step whose error has a standard deviation of σ [σ]."""
ROUNDING_REACH, INDEPENDENT = 3.0, 0.2
"""Depths farther apart than the first are taken to correlate less than the theory says [steps]; the second is the share
of the rounding errors' variance that is taken to be independent."""


class SequenceProblem(LeastSquares):
    """Weighted residuals of a sequence and their derivatives by all parameters of a press; V vertices, P pixels, N
    frames.

    What the pixels show must be decided first (`look`).

    Args:
        contact: with a depth-change sequence of one frame or more.
        mechanics: of the fits.
        within: as in `PressMotion`.
        noise: σ of every pixel in every frame [scene units]; None = as the depth-change sequence says.
        kind: of motion: what is fitted of the press.
    """

    def __init__(
        self,
        contact: Interaction,
        mechanics: Mechanics,
        within: float = 0.0,
        noise: float | None = None,
        kind: Kind = PressMotion,
    ) -> None:
        sequence = contact.sequence
        assert sequence is not None
        if noise is not None:
            sequence = dataclasses.replace(sequence, noise=SequenceNoise(noise, 0.0))
        self.contact, self.sequence = contact, sequence
        self.patches = Patches(contact.mesh, contact.vertex, sequence.size, parts=kind.parts)
        self.motion = kind(contact, mechanics, self.patches.vertices, sequence.times, within)
        self.observed = sequence.change.reshape(len(sequence.times), -1).astype(np.float64)
        """Shape [N, P] [scene units]."""
        self._smooth = smooth_errors(sequence.noise.total)
        beside = maximum_filter(~np.isfinite(sequence.change), (1, 3, 3)).reshape(self.observed.shape)
        self._unevenness = np.where(beside, PARTIAL, WALL)
        self.offset: np.ndarray | float = 0.0
        """Error of the simulator's own steps, taken off all its displacements, shape [N, V, 3] [scene units]."""
        self.seen = np.isfinite(self.observed)
        """Pixels that show tissue which is known, shape [N, P], bool; all of `look` comes to be known by it."""

    @property
    def sigma(self) -> float:
        """σ of a pixel [scene units]."""
        return self.sequence.noise.total

    def look(self, logs: np.ndarray, *, finer: bool = False, outliers: bool = False) -> None:
        """Decide what the pixels show, and how their errors belong together, by parameters [D] near the best.

        Args:
            finer: whether the error of the simulator's steps is measured there, and taken off from now on.
            outliers: whether pixels that lie far from that motion count less from now on.
        """
        moved, slopes = self.motion.at(logs)
        self.offset = self.motion.finer(logs) - moved if finer else 0.0
        moved = moved + self.offset
        self.covering = self.patches.covering(moved)
        """Cover of the pixels as `Patches` gives it, shape [N, P, K]."""
        self._turning = self.patches.turning(moved, slopes)
        self._looked_at = np.array(logs)
        change, total = self.change(moved, logs), self.sequence.noise.total
        left = change - self.observed
        self.seen = np.isfinite(left)
        # By what is observed, too: else a model that moves nothing would explain everything.
        # Of some pixels the motion is clear without a model.
        clear = (np.abs(np.nan_to_num(self.observed)) > MOVED * total).sum(axis=0) >= SEVERAL
        self.moving = (np.abs(np.where(self.seen, change, 0)).max(axis=0) > MOVED * total) | clear
        """Pixels that move clearly, by the model or by what is observed, shape [P], bool."""
        self._walls = np.square(self._unevenness * self.patches.steepness(moved))
        self._blurs = self.patches.blurs(moved, self.covering)
        weight = np.ones_like(left)
        if outliers:
            apart = np.abs(np.where(self.seen, left, 0)) / np.sqrt(total**2 + self._walls)
            weight = np.minimum(1.0, OUTLIER / np.maximum(apart, OUTLIER)) ** 2
        self._known = None
        self._whitener = self._whitening(np.where(np.isfinite(change), change, 0.0), weight)

    def model_errors(self, sunk: np.ndarray) -> np.ndarray:
        """What the model itself gets wrong, as in `PressMotion`."""
        return self.motion.model_errors(sunk, self.patches.averages)

    def _whitening(self, sunk: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whitening of every pixel's errors over time [P, N, N], common errors as they leave it, what they cost."""
        noise, frames = self.sequence.noise, len(sunk)
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
        smooth = still[:, :, None] * self._smooth[:, None, :]
        errors = np.concatenate([self.model_errors(sunk), self._blurs], axis=2)
        wrong = np.matmul(whiten, np.where(self.seen.T[..., None], errors, 0.0))
        flat = np.concatenate([smooth, wrong], axis=2).reshape(-1, smooth.shape[2] + wrong.shape[2])
        return whiten, flat, np.linalg.cholesky(flat.T @ flat + np.eye(flat.shape[1]))

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Pixels' values [N, P] (or [N, P, D]) in units of their independent errors, shape [N·P + K] (or [..., D])."""
        whiten, smooth, factor = self._whitener
        values = np.where(self.seen.reshape(self.seen.shape + (1,) * (values.ndim - 2)), values, 0.0)
        flat = np.matmul(whiten, np.moveaxis(values, 0, 1).reshape(len(whiten), len(values), -1))
        flat = flat.reshape(-1, flat.shape[2])
        common = np.linalg.solve(factor.T, np.linalg.solve(factor, smooth.T @ flat))
        found = np.concatenate([flat - smooth @ common, common])
        return found[:, 0] if values.ndim == 2 else found

    def _linearise(self, logs: np.ndarray) -> Linearised:
        """Whitened simulated minus observed change, and its derivatives by all parameters."""
        change, tangent = self.tangent(logs)
        return Linearised(self.whitened(change - self.observed), self.whitened(tangent))

    def tangent(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change of every pixel's depth [N, P], and its derivatives by all parameters [N, P, D] [scene units]."""
        moved, slopes = self.motion.at(logs)
        moved = moved + self.offset
        tangent = self.patches.shown(self.patches.sunk_slopes(moved, slopes), self.covering)
        return self.change(moved, logs), tangent + self._turning

    def left(self, moved: np.ndarray, logs: np.ndarray) -> np.ndarray:
        """Whitened simulated minus observed change; arguments as in `change`."""
        return self.whitened(self.change(moved, logs) - self.observed)

    def change(self, moved: np.ndarray, logs: np.ndarray) -> np.ndarray:
        """Change of the depth of every pixel at displacements [N, V, 3] and their parameters [D], shape [N, P].

        What pixels show turns with the parameters, from the last look on.
        """
        change = self.patches.shown(self.patches.sunk(moved), self.covering)
        return change + self._turning @ (logs - self._looked_at)

    @property
    def counted(self) -> float:
        """How many independent values of pixels that move were observed, by the last look."""
        return float((self.seen & self.moving).sum()) / self.sequence.noise.correlated_in_time

    def misfit(self, logs: np.ndarray) -> float:
        """Root mean square of the residuals of pixels that move, in standard deviations; outliers count in full."""
        used = self.seen & self.moving
        left = (self.change(self.motion.at(logs)[0] + self.offset, logs) - self.observed)[used]
        sigma = np.sqrt(self.sequence.noise.total**2 + self._walls[used])
        return float(np.sqrt(np.square(left / sigma).mean())) if len(left) else 0.0

    def coarser(self) -> SequenceProblem:
        """Return the problem with coarse time steps, to search with; it has not looked at anything of its own yet."""
        found = copy.copy(self)
        found.motion = self.motion.coarser()
        return found


def rounding_covariance(simulated: np.ndarray) -> np.ndarray:
    """Covariance of rounding errors between frames, shape [n, M, M] [σ²].

    In theory they correlate as 1 - 6u(1 - u) where depths differ by u steps of rounding.

    Args:
        simulated: displacement along the force, shape [n, M] [σ].
    """
    steps = (simulated[:, :, None] - simulated[:, None]) / STEP
    part = np.abs(steps) % 1
    # A product of positive definite functions of the depths is one too.
    kernel = (1 - 6 * part * (1 - part)) * np.exp(-0.5 * np.square(steps / ROUNDING_REACH))
    return (1 - INDEPENDENT) * kernel + INDEPENDENT * np.eye(simulated.shape[1])
