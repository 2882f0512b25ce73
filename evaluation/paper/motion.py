"""Simulated motions: when the released tissue comes to rest (Bini 2026, section 4.2), and which are not credible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from palpate.data.contact.interaction import Interaction
from palpate.evaluation.paper.baselines import simulate_contacts
from palpate.physics.mechanics import Mechanics

SETTLED_FRACTION = 0.05
"""At rest means a displacement of at most this fraction of the trajectory's peak."""
STATES = ("settled", "not reached", "no release", "no motion", "not finite")
"""`settled`, or why there is no settling time: `not reached` within the horizon, `no release` within the horizon."""
SCENE_SIZE = 1.0
"""The deepest point of a scene lies at 1 scene unit: a larger displacement leaves the scene."""
PERTURBATION = 1e-4
"""Relative change of F in the test for chaos."""
CHAOTIC_AMPLIFICATION = 100.0
"""A trajectory that changes by more than this times the relative change of F can't be predicted in float32."""
CHECKED_CONTACTS = 16
"""Most test contacts simulated again to look for chaotic motion, evenly spaced over those available."""


def settle(trajectories: np.ndarray, load_steps: np.ndarray, mechanics: Mechanics) -> pd.DataFrame:
    """Find when simulated displacements enter the 5 % band after release for good.

    Args:
        trajectories: displacement of the contact vertex after steps 1..T, shape [n, T, 3] [scene units].
        load_steps: number of steps under load, shape [n]; release is at load_steps·Δt.
        mechanics: time step of the rollout.

    Returns:
        One row a trajectory: `state` (one of `STATES`), `settling_time_s` (from release until the displacement stays
        within 5 % of the peak; 0 where it already was), `release_s` (since first contact), `peak` [scene units] and
        `end_fraction_of_peak` (displacement at the end of the horizon). What doesn't exist is not a number.
    """
    distance = np.linalg.norm(np.asarray(trajectories, dtype=float), axis=2)
    distance[~np.isfinite(distance).all(axis=1)] = np.nan
    peak, step = distance.max(axis=1), np.arange(1, distance.shape[1] + 1)
    outside = (distance > SETTLED_FRACTION * peak[:, None]) & (step >= load_steps[:, None])
    last = (outside * step).max(axis=1)
    reasons = [np.isnan(peak), peak == 0, load_steps >= len(step), last == len(step)]
    state = np.select(reasons, ["not finite", "no motion", "no release", "not reached"], "settled")
    seconds = mechanics.time_step * np.where(last > 0, last + 1 - load_steps, 0)
    return pd.DataFrame(
        {
            "state": state,
            "settling_time_s": np.where(state == "settled", seconds, np.nan),
            "release_s": mechanics.time_step * load_steps,
            "peak": peak,
            "end_fraction_of_peak": distance[:, -1] / np.where(peak > 0, peak, np.nan),
        }
    )


def median_share(trajectories: np.ndarray) -> float:
    """How high the median displacement rises, as a share of the highest peak of all (Bini 2026, figure 3b).

    Args:
        trajectories: as in `settle`; those that aren't finite are left out.
    """
    distance = np.linalg.norm(np.asarray(trajectories, dtype=float), axis=2)
    distance = distance[np.isfinite(distance).all(axis=1)]
    peak = distance.max(initial=0.0)
    return float(np.median(distance, axis=0).max() / peak) if peak > 0 else np.nan


def amplification(theta: np.ndarray, contacts: Sequence[Interaction], mechanics: Mechanics) -> np.ndarray:
    """How much a trajectory changes with a minute change of F, shape [n]; about 1 where the motion is regular.

    Largest displacement between the trajectories of F and F·(1 + 1e-4), relative to the peak and to 1e-4; infinite
    where a trajectory isn't finite.
    """
    first, _ = simulate_contacts(theta, contacts, mechanics)
    second, _ = simulate_contacts(theta * np.array([1.0, 1.0, 1.0 + PERTURBATION]), contacts, mechanics)
    peak = np.linalg.norm(first.astype(float), axis=2).max(axis=1)
    change = np.linalg.norm(second.astype(float) - first, axis=2).max(axis=1)
    gain = change / (PERTURBATION * np.where(peak > 0, peak, 1.0))
    return np.where(np.isfinite(gain), gain, np.inf)


def motion_row(
    settling: pd.DataFrame, theta: np.ndarray, contacts: Sequence[Interaction], mechanics: Mechanics
) -> dict[str, object]:
    """One regime's motions in numbers, for reading.

    Args:
        settling: from `settle`.
        theta: simulated parameters, shape [n, 3].
        contacts: the n contacts.
        mechanics: the rollout's constants.
    """
    chosen = np.linspace(0, len(contacts) - 1, min(CHECKED_CONTACTS, len(contacts))).round().astype(int)
    gain = amplification(theta[chosen], [contacts[i] for i in chosen], mechanics)
    return {
        "median settling time [s]": settling["settling_time_s"].median(),
        "longest [s]": settling["settling_time_s"].max(),
        **{state: int((settling["state"] == state).sum()) for state in STATES},
        "peak over 1 scene unit": int((settling["peak"] > SCENE_SIZE).sum()),
        "chaotic, of those checked": f"{np.count_nonzero(gain > CHAOTIC_AMPLIFICATION)} of {len(chosen)}",
    }
