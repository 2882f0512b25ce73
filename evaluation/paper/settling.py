"""When the released tissue comes to rest again (Bini 2026, section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from physics.mechanics import Mechanics

SETTLED_FRACTION = 0.05
"""At rest means a displacement of at most this fraction of the trajectory's peak."""

State = Literal["settled", "not reached", "no release", "no motion", "not finite"]
STATES: tuple[State, ...] = ("settled", "not reached", "no release", "no motion", "not finite")


@dataclass(frozen=True)
class Settling:
    """One trajectory's return to rest."""

    state: State
    """`settled`, or why there is no settling time: `not reached` within the horizon, `no release` within the horizon,
    `no motion`, `not finite`."""
    peak: float | None
    """Largest displacement of the contact vertex [scene units]."""
    release_s: float
    """Time at which the load ends, counted from the first contact [s]."""
    after_release_s: float | None
    """Time from release until the displacement stays within 5 % of the peak [s]; 0 where it already was."""
    end_fraction: float | None
    """Displacement at the end of the horizon as a fraction of the peak."""


def settle(trajectory: np.ndarray, load_steps: int, mechanics: Mechanics) -> Settling:
    """Find when a simulated displacement enters the 5 % band after release for good.

    Args:
        trajectory: displacement of the contact vertex after steps 1..T, shape [T, 3] [scene units].
        load_steps: number of steps under load; release is at load_steps·Δt.
        mechanics: time step of the rollout.
    """
    distance = np.linalg.norm(np.asarray(trajectory, dtype=float), axis=1)
    times = mechanics.time_step * np.arange(1, len(distance) + 1)
    release = load_steps * mechanics.time_step
    if not np.isfinite(distance).all():
        return Settling("not finite", None, release, None, None)
    peak = float(distance.max())
    if peak == 0:
        return Settling("no motion", 0.0, release, None, None)
    end = float(distance[-1]) / peak
    if load_steps >= len(distance):
        return Settling("no release", peak, release, None, end)
    start = max(load_steps - 1, 0)  # index whose time is the release
    outside = np.flatnonzero(distance[start:] > SETTLED_FRACTION * peak)
    if len(outside) == 0:
        return Settling("settled", peak, release, 0.0, end)
    first_inside = start + outside[-1] + 1
    if first_inside == len(distance):
        return Settling("not reached", peak, release, None, end)
    return Settling("settled", peak, release, float(times[first_inside] - release), end)


@dataclass(frozen=True)
class SettlingSummary:
    """Settling of all test trajectories of one regime."""

    counts: dict[str, int]
    """Trajectories by state."""
    median_s: float | None
    """Median settling time of those that settled [s]."""
    longest_s: float | None
    """Longest settling time of those that settled [s]."""


def summarise_settling(results: list[Settling]) -> SettlingSummary:
    """Counts by state, and the settling times of those that settled."""
    times = [result.after_release_s for result in results if result.after_release_s is not None]
    return SettlingSummary(
        counts={state: sum(result.state == state for result in results) for state in STATES},
        median_s=float(np.median(times)) if times else None,
        longest_s=max(times) if times else None,
    )
