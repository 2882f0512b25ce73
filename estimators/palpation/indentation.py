"""One force–depth curve: Young's modulus where the indenter's shape is known, a stiffness otherwise.

Elastic half-space, F = c·E/(1 - ν²)·(d - d₀)ⁿ: a sphere of radius R has n = 3/2 and c = 4/3·√R (Hertz 1882; Johnson
1985, equation 4.23), a flat punch of radius R n = 1 and c = 2R, a cone of half-angle α n = 2 and c = 2/π·tan α (Sneddon
1965, section 5). Depth counts from where the tissue is first touched, d₀, which is fitted along.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from palpate.estimators.palpation.curves import LEAST

Shape = Literal["sphere", "flat", "cone"]


@dataclass(frozen=True)
class Indenter:
    """What is pressed into the tissue.

    Raises:
        ValueError: a size that is not positive, a half-angle of 90° or more, an unknown shape, ν outside (-1, 0.5].
    """

    shape: Shape
    """sphere, flat (a punch) or cone."""
    size: float
    """Radius [mm], of a cone its half-angle [°]."""
    poisson: float = 0.5
    """ν of the tissue, which one curve can't tell: 0.5 is incompressible."""

    def __post_init__(self) -> None:
        if self.shape not in ("sphere", "flat", "cone"):
            raise ValueError(f"there is no indenter {self.shape!r}; choose sphere, flat or cone.")
        if not 0 < self.size < (90 if self.shape == "cone" else np.inf):
            raise ValueError(
                f"the indenter's size is {self.size:g}; give a radius in mm, of a cone an angle below 90°."
            )
        if not -1 < self.poisson <= 0.5:
            raise ValueError(f"Poisson's ratio is {self.poisson:g}; give one above -1 and up to 0.5.")

    @property
    def law(self) -> tuple[float, float]:
        """c·1/(1 - ν²) [mm^(2-n)] and n of F = c·E·dⁿ, E in N/mm²."""
        constant, power = {
            "sphere": (4 / 3 * np.sqrt(self.size), 1.5),
            "flat": (2 * self.size, 1.0),
            "cone": (2 / np.pi * np.tan(np.radians(self.size)), 2.0),
        }[self.shape]
        return float(constant) / (1 - self.poisson**2), power


@dataclass(frozen=True)
class Indentation:
    """What one curve says."""

    value: float
    """Young's modulus [kPa] or stiffness [N/mm]."""
    sd: float
    """Its standard deviation, given that the law holds."""
    low: float
    high: float
    """90 % interval, by Student's distribution."""
    unit: Literal["kPa", "N/mm"]
    """kPa: a modulus; N/mm: the indenter is not known, and its size is in the number."""
    begins: float
    """d₀ [mm]."""
    residual: float
    """Root mean square of what the law leaves [N]."""


def fit_indentation(depth: np.ndarray, force: np.ndarray, indenter: Indenter | None = None) -> Indentation:
    """Fit a curve.

    Args:
        depth: shape [D] [mm].
        force: shape [D] [N].
        indenter: None = unknown: a straight line, whose slope is the stiffness.

    Raises:
        ValueError: fewer than LEAST samples, or no change of depth.
    """
    depth, force = np.asarray(depth, np.float64), np.asarray(force, np.float64)
    if len(depth) < LEAST or np.ptp(depth) == 0:
        raise ValueError(f"a curve of {len(depth)} samples between the same depths says nothing; give {LEAST} depths.")
    constant, power = (1.0, 1.0) if indenter is None else indenter.law

    def law(start: float) -> np.ndarray:
        return constant * (np.maximum(depth - start, 0.0) if indenter is not None else depth - start) ** power

    def scale(start: float) -> float:
        shape = law(start)
        square = float(shape @ shape)
        return float(shape @ force) / square if square > 0 else 0.0

    def left(start: float) -> float:
        return float(np.square(force - scale(start) * law(start)).sum())

    if indenter is None:
        slope, offset = np.polyfit(depth, force, 1)
        start = float(-offset / slope) if slope else 0.0
        residual = force - slope * depth - offset
        value, root = float(slope), np.stack([depth, np.ones_like(depth)], axis=1)
    else:
        # Touched later than half-way in, or above the first sample by as much as the whole depth.
        low, high = depth.min() - np.ptp(depth), depth.min() + np.ptp(depth) / 2
        grid = np.linspace(low, high, 61)
        best = int(np.argmin([left(at) for at in grid]))
        around = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        start = float(minimize_scalar(left, bounds=around, method="bounded").x)
        value = scale(start)
        residual = force - value * law(start)
        inner = np.maximum(depth - start, 0.0)
        slope_by_start = -value * constant * power * np.where(inner > 0, inner ** (power - 1), 0.0)
        root = np.stack([law(start), slope_by_start], axis=1)
    freedom = len(depth) - 2
    spread = float(np.sqrt(np.square(residual).sum() / freedom))
    sd = spread * float(np.sqrt(np.linalg.pinv(root.T @ root)[0, 0]))
    factor = 1.0 if indenter is None else 1000.0
    wide = float(stdtrit(freedom, 0.95)) * sd
    rms = float(np.sqrt(np.mean(np.square(residual))))
    numbers = (factor * value, factor * sd, factor * (value - wide), factor * (value + wide))
    return Indentation(*numbers, "N/mm" if indenter is None else "kPa", start, rms)
