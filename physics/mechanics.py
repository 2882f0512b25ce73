"""Mechanics of the simulated tissue: integration constants, admissible parameters, and whether they are stable.

Sources: Bini 2026, section 3.3, equation 9 and table 1 (constants), section 3.4.1 (admissible box).
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

import numpy as np
from scipy.sparse.linalg import eigsh

from palpate.common.settings import Checked, Positive
from palpate.physics.mesh import incidence

PARAMETERS = ("stiffness", "damping", "force")
"""Order of θ = [k_s, k_d, F] everywhere."""
SIGNS = (1.0, 1.0, -1.0)
"""Signs of θ where φ = (log k_s, log k_d, log |F|) is known: F presses."""

REFERENCE_STIFFNESS = 5.34
REFERENCE_DAMPING = 0.127
"""Literature values that Bini 2026 (section 4.1) compares with: a baseline, never an initial value."""


class UnstableConfiguration(ValueError):
    """The admissible stiffness and the time step can't be integrated on this mesh."""


@dataclass(frozen=True)
class Mechanics(Checked, group="mechanics."):
    """Constants of the mass-spring-damper rollout (Bini 2026, table 1) and the choices that the paper leaves open."""

    mass: Positive = 0.001
    """Mass of every vertex [kg by the paper's convention; scene geometry is normalised]."""
    time_step: Annotated[float, 1e-15, 1] = 0.005
    """Integration step Δt [s]."""
    # A longer rollout is a mistake: 100 s of motion by default.
    steps: Annotated[int, 1, 20_000] = 200
    """Number of steps T; the horizon is T·Δt (1 s)."""
    load_steps: int = 50
    """Steps during which the force acts, from the start (the first quarter), unless an observation says otherwise."""
    scheme: Literal["euler", "dkd"] = "euler"
    """Semi-implicit Euler (the paper's, order 1) or drift–kick–drift (order 2, exact damping, same cost).

    Euler's damping is implicit, stable for every k_d ≥ 0; the paper's explicit one diverges from 2m/Δt on.
    """
    window_error: Annotated[float, 0, 0.999] = 0.0
    """Threshold of compiled rollouts that compute a window; 0 computes all that can reach a watched vertex.

    Every call compares its window with a smaller one. If the watched vertices' displacements differ by this share of
    the largest one, or with derivatives by θ a thirtieth of it, the exact rollout is computed instead. Errors of the
    window are then below this share, of displacements and of each derivative's largest value; most are far below.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.load_steps <= self.steps:
            raise ValueError(f"mechanics.load_steps is {self.load_steps}; give 0 to {self.steps} (mechanics.steps).")

    def matched(self, interval: float) -> Self:
        """Return the mechanics over the same time, with the largest step of at most Δt that divides an interval [s].

        Observations at multiples of the interval then lie on steps: no rounding shifts them.
        """
        step = interval / max(1, math.ceil(interval / self.time_step - 1e-6))
        scale = self.time_step / step
        if abs(scale - 1) < 1e-9:
            return self
        return replace(self, time_step=step, steps=round(self.steps * scale), load_steps=round(self.load_steps * scale))

    @property
    def seconds(self) -> float:
        """Longest duration of an observation: the horizon and half a step, to which time stamps are rounded [s]."""
        return (self.steps + 0.5) * self.time_step

    @property
    def times(self) -> np.ndarray:
        """Time after each step, shape [T] [s]."""
        return self.time_step * np.arange(1, self.steps + 1)


def theta_of(logs: np.ndarray) -> np.ndarray:
    """θ of φ = (log k_s, log k_d, log |F|), shape [..., 3], float64; F presses."""
    return np.exp(np.asarray(logs, np.float64)) * SIGNS


@dataclass(frozen=True)
class Bounds:
    """Admissible box of θ (Bini 2026, section 3.4.1) and where the parameter head starts inside it."""

    stiffness: tuple[float, float] = (0.0, 1.0)
    """Lowest and highest k_s [normalised]."""
    damping: tuple[float, float] = (0.0, 1.0)
    """Lowest and highest k_d [normalised]."""
    force: tuple[float, float] = (-10.0, 0.0)
    """Lowest and highest signed F [normalised]; negative presses into the tissue."""
    initial: tuple[float, float, float] = (0.5, 0.5, -5.0)
    """θ₀ = (k_s, k_d, F) that the head gives before training, strictly inside the box."""

    def __post_init__(self) -> None:
        for name, start in zip(PARAMETERS, self.initial, strict=True):
            low, high = getattr(self, name)
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ValueError(f"bounds.{name} is [{low}, {high}]; give a lower bound below a finite upper bound.")
            if name != "force" and low < 0:
                raise ValueError(f"bounds.{name} starts at {low}; a {name} below 0 is not physical, give 0 or more.")
            if not low < start < high:
                raise ValueError(f"bounds.initial gives {name} {start}; choose it strictly inside [{low}, {high}].")

    @property
    def lower(self) -> tuple[float, float, float]:
        """Lower corner of the box, in θ's order."""
        return (self.stiffness[0], self.damping[0], self.force[0])

    @property
    def upper(self) -> tuple[float, float, float]:
        """Upper corner of the box, in θ's order."""
        return (self.stiffness[1], self.damping[1], self.force[1])

    @property
    def log_box(self) -> np.ndarray:
        """Lower and upper φ = (log k_s, log k_d, log |F|) of the box, shape [2, 3], for what estimates logarithms.

        Raises:
            ValueError: the box reaches 0 in some parameter, or F changes its sign in it.
        """
        for name in ("stiffness", "damping"):
            if not getattr(self, name)[0] > 0:
                problem = f"bounds.{name} starts at {getattr(self, name)[0]} and head posterior works with logarithms;"
                raise ValueError(f"{problem} give a positive lower bound, or choose head parameters.")
        if not self.force[1] < 0:
            problem = f"bounds.force ends at {self.force[1]} and head posterior works with log |F|;"
            raise ValueError(f"{problem} give a negative upper bound such as -0.01, or choose head parameters.")
        return np.log([self.stiffness, self.damping, (-self.force[1], -self.force[0])]).T


RECOMMENDED = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1))
"""The box in which displacements are those really seen; `configs/recommended.yaml` says so too."""


def highest_frequency(springs: np.ndarray, vertex_count: int, stiffness: float, mechanics: Mechanics) -> float:
    """Upper bound on the highest angular frequency of the sheet [rad/s].

    The bound is k_s times the largest eigenvalue of the springs' graph Laplacian, above the elastic operator's: each
    spring resists along its own direction only.

    Args:
        springs: vertex indices, shape [S, 2].
        vertex_count: number of vertices N.
        stiffness: k_s.
    """
    ends = abs(incidence(np.asarray(springs), vertex_count))
    if vertex_count > 3 and len(springs):
        # The signless Laplacian bounds the Laplacian, and its leading vector is positive, so Lanczos converges fast.
        signless, start = ends @ ends.T, np.ones(vertex_count)
        largest = float(eigsh(signless, k=1, which="LA", v0=start, tol=1e-3, return_eigenvectors=False)[0]) * 1.001
    else:
        largest = 2.0 * float(ends.sum(axis=1).max(initial=0))
    return math.sqrt(largest * stiffness / mechanics.mass)


def require_stable(springs: np.ndarray, vertex_count: int, bounds: Bounds, mechanics: Mechanics) -> None:
    """Refuse an admissible box that the integrator can't follow on this mesh.

    Raises:
        UnstableConfiguration: Δt·ω_max ≥ 2 at the largest admissible k_s.
    """
    stiffness = bounds.stiffness[1]
    frequency = highest_frequency(springs, vertex_count, stiffness, mechanics)
    product = mechanics.time_step * frequency
    if product >= 2:
        allowed = stiffness * (2 / product) ** 2
        raise UnstableConfiguration(
            f"bounds.stiffness allows k_s = {stiffness:g}, where Δt·ω_max = {product:.2f} on this mesh of "
            f"{vertex_count} vertices and must stay below 2; lower the bound under {allowed:.3g} "
            f"or mechanics.time_step under {2 / frequency:.3g} s."
        )


def damping_ratio(stiffness: float, damping: float, mass: float) -> float:
    """ζ = k_d/(2√(k_s m))."""
    return damping / (2 * math.sqrt(stiffness * mass))
