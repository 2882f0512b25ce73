"""Where gripped tissue is stiffer than its mean, with how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.estimators.grip.lattice import bilinear
from palpate.estimators.grip.sheet import EXCESS
from palpate.physics.identifiability import LIMIT

LEARNT = 0.7
"""What is known must be surer than what was expected before anything was observed, by this factor."""
MOST = 0.5
"""Share of the tissue that moves which must be known for the field to count as determined."""
MOVES = 5.0
"""Ratios are to the mean of tissue that moves by more than this [px]."""


@dataclass(frozen=True, eq=False)
class StiffnessField:
    """Log stiffness of a sheet, bilinear between the K knots of a grid, beyond these as at their edge.

    Known but for a factor: only ratios between places count. It is taken for granted that tissue is attached the same
    everywhere, which a picture doesn't show.
    """

    shape: tuple[int, int]
    """Columns and rows of knots."""
    low: np.ndarray
    """The first knot (column, row) [px of `picture`]."""
    extent: np.ndarray
    """From the first to the last [px]."""
    log_stiffness: np.ndarray
    """At the knots, columns outside, shape [K]."""
    covariance: np.ndarray
    """Theirs, shape [K, K]."""
    expected: np.ndarray
    """Their covariance before anything was observed, shape [K, K]."""
    roughness: float
    """Standard deviation of the difference between neighbouring knots that was expected."""
    moving: np.ndarray
    """Places of tissue that moves by more than MOVES, shape [M, 2] [px]."""
    excess: float
    """Standard deviation by axis of what the sheet leaves of the motion besides the given noise [px]."""
    picture: np.ndarray
    """The run's first one, in whose pixels all places are, uint8 [H, W, 3] RGB."""

    @property
    def knots(self) -> np.ndarray:
        """Places of the knots, shape [K, 2] [px]."""
        sides = [
            np.linspace(start, start + far, count)
            for start, far, count in zip(self.low, self.extent, self.shape, strict=True)
        ]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)

    def at(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log stiffness over the mean of tissue that moves, and its standard deviation, shape [N] each.

        Args:
            places: shape [N, 2] [px].
        """
        row = self._relative(places)
        # From one knot to the next it is a random walk with both ends known.
        share = self._places(places) % 1
        stray = self.roughness * np.sqrt((share * (1 - share)).sum(axis=1))
        return row @ self.log_stiffness, np.hypot(_sd(row, self.covariance), stray)

    def known(self, places: np.ndarray) -> np.ndarray:
        """Where the logarithm is known to LIMIT, as the knots around it are, by what was observed, shape [N], bool.

        Nothing is known beyond the knots, which span what moves.
        """
        row = self._relative(places)
        sd = _sd(row, self.covariance)
        spanned = np.all((places >= self.low) & (places <= self.low + self.extent), axis=1)
        return spanned & (sd < LIMIT) & (sd <= LEARNT * _sd(row, self.expected))

    @property
    def tells(self) -> bool:
        """Whether a sheet explains the motion to within its noise, and most tissue that moves is known."""
        return self.excess <= EXCESS and bool(self.known(self.moving).mean() > MOST)

    def _relative(self, places: np.ndarray) -> np.ndarray:
        """How log stiffness over the mean of tissue that moves follows the knots, shape [N, K]."""
        return self._weights(places) - self._weights(self.moving).mean(axis=0)

    def _weights(self, places: np.ndarray) -> np.ndarray:
        return bilinear(self._places(places), np.array(self.shape)).toarray()

    def _places(self, places: np.ndarray) -> np.ndarray:
        """Places [N, 2] in the distances of knots from the first one, within the grid."""
        return np.clip((places - self.low) / self.extent, 0, 1) * (np.array(self.shape) - 1)


def _sd(row: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations of linear functions [N, K] of numbers with a covariance [K, K], shape [N]."""
    return np.sqrt(np.maximum(((row @ covariance) * row).sum(axis=1), 0))
