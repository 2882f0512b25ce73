"""Adam (Kingma 2015, algorithm 1) in numpy: the online estimator runs where torch is not installed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Adam:
    """One optimiser's running means; begins at none.

    Raises:
        ValueError: a rate that is not positive.
    """

    rate: float = 0.1
    """Liang 2024, section III-B."""
    decay: tuple[float, float] = (0.9, 0.999)
    """Of the means of slopes and of their squares: Adam's usual ones, as the paper gives none."""
    guard: float = 1e-8
    _mean: np.ndarray | None = field(default=None, init=False, repr=False)
    _square: np.ndarray | None = field(default=None, init=False, repr=False)
    _count: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the range."""
        if not (self.rate > 0 and math.isfinite(self.rate)):
            raise ValueError(f"rate is {self.rate}; give a positive number.")

    def step(self, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Values after one step against slopes of the same shape."""
        mean, square = (np.zeros_like(values) if past is None else past for past in (self._mean, self._square))
        first, second = self.decay
        self._count += 1
        self._mean = first * mean + (1 - first) * slopes
        self._square = second * square + (1 - second) * slopes * slopes
        size = np.sqrt(self._square / (1 - second**self._count)) + self.guard
        return values - self.rate * self._mean / (1 - first**self._count) / size
