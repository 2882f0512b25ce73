"""Simulated motions, and the baselines that an estimate has to beat: one constant θ for everything, and no motion.

A predictor that has collapsed to a constant looks good against badly chosen constants, so the constant here is the best
one for the training contacts. Motions are described by when the released tissue comes to rest (Bini 2026, section 4.2),
and which leave the scene.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from scipy.optimize import minimize
from scipy.stats import qmc
from torch import Tensor

from palpate.data.contact.interaction import Interaction
from palpate.physics.mechanics import Bounds, Mechanics
from palpate.physics.msd import rollout
from palpate.physics.msd.batch import ObservationBatch
from palpate.physics.msd.likelihoods import displacement_error

MAX_ITERATIONS = 10
"""Most L-BFGS-B iterations for each of these."""


def no_motion_errors(contacts: Sequence[Interaction], mechanics: Mechanics) -> np.ndarray:
    """Return displacement errors [n] when nothing moves, F = 0 [scene units²]."""
    return displacement_error(torch.zeros(len(contacts), mechanics.steps, 3), _observed(contacts)).double().numpy()


def _observed(contacts: Sequence[Interaction]) -> ObservationBatch:
    return ObservationBatch.of([contact.observation for contact in contacts], contacts[0].time_step)


def _rolled_out(theta: Tensor, contacts: Sequence[Interaction], mechanics: Mechanics) -> Tensor:
    """Return contact-vertex displacements [n, T, 3] of every contact with its own θ [n, 3]."""
    return rollout(theta, [contact.mesh for contact in contacts], [contact.load for contact in contacts], mechanics)


@torch.no_grad()
def simulate_contacts(
    theta: np.ndarray, contacts: Sequence[Interaction], mechanics: Mechanics
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate every contact with its own θ.

    Args:
        theta: parameters, shape [n, 3], or [3] for one θ in all contacts.
        contacts: the n contacts.
        mechanics: the rollout's constants.

    Returns:
        Contact-vertex displacements [n, T, 3] [scene units] and displacement errors [n] [scene units²].
    """
    trajectories = _rolled_out(torch.tensor(theta, dtype=torch.float32).expand(len(contacts), 3), contacts, mechanics)
    return trajectories.numpy(), displacement_error(trajectories, _observed(contacts)).double().numpy()


def _warped_box(bounds: Bounds) -> tuple[Tensor, Tensor, Tensor]:
    """Return the scale [3] at which each parameter's search turns from even to exponential, and the box in its
    coordinates."""
    lower, upper = torch.tensor([bounds.lower, bounds.upper], dtype=torch.float64)
    scale = torch.maximum(lower.abs(), upper.abs()) / 1000.0
    return scale, torch.asinh(lower / scale), torch.asinh(upper / scale)


def to_theta(unit: Tensor, bounds: Bounds) -> Tensor:
    """Return θ of search coordinates in [0, 1]³.

    Displacements that fit real scenes lie at a small fraction of the paper's ranges, so coordinates are spread
    exponentially away from 0; both ends stay reachable.
    """
    scale, low, high = _warped_box(bounds)
    return scale * torch.sinh(low + (high - low) * unit)


def to_unit(theta: Tensor, bounds: Bounds) -> Tensor:
    """Return search coordinates of θ, the inverse of `to_theta`."""
    scale, low, high = _warped_box(bounds)
    return (torch.asinh(theta / scale) - low) / (high - low)


def fit_constant_theta(contacts: list[Interaction], bounds: Bounds, mechanics: Mechanics) -> tuple[np.ndarray, float]:
    """Find the constant θ in the admissible box with the lowest mean displacement error over the training contacts.

    θ₀ and Sobol points over the box are tried, and the best of them refined with L-BFGS-B through the rollout's
    gradient. Deterministic.

    Returns:
        The constant (k_s, k_d, F), F signed, and its mean displacement error [scene units²]; not a number without
        contacts.
    """
    if not contacts:
        return np.full(3, np.nan), np.nan
    observed = _observed(contacts)
    # The error of "nothing moves" sets the scale, so that the optimiser's tolerances mean the same in every scene.
    scale = max(float(no_motion_errors(contacts, mechanics).sum()), 1e-30)

    def objective(unit: np.ndarray) -> tuple[float, np.ndarray]:
        leaf = torch.tensor(unit, requires_grad=True)
        theta = to_theta(leaf, bounds).float().expand(len(contacts), 3)
        error = displacement_error(_rolled_out(theta, contacts, mechanics), observed).sum() / scale
        error.backward()
        total = error.item()
        slope = torch.zeros(3) if leaf.grad is None else leaf.grad
        if not (np.isfinite(total) and slope.isfinite().all()):
            # Large enough for the line search to shorten its step.
            return 1e12, np.zeros(3)
        return total, slope.numpy()

    starts = qmc.Sobol(3, scramble=False).random(8)
    starts[0] = to_unit(torch.tensor(bounds.initial, dtype=torch.float64), bounds)  # instead of the box's corner
    values = [objective(start)[0] for start in starts]
    refined = [
        minimize(
            objective, starts[index], jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * 3,
            options={"maxiter": MAX_ITERATIONS, "maxfun": 2 * MAX_ITERATIONS},
        )
        for index in np.argsort(values, kind="stable")[:2]
    ]  # fmt: skip
    best = min(refined, key=lambda result: result.fun)
    return to_theta(torch.from_numpy(best.x), bounds).numpy(), float(best.fun) * scale / len(contacts)


def distances(trajectories: np.ndarray) -> np.ndarray:
    """Return lengths [n, T] of displacements [n, T, 3]; not a number throughout a trajectory that isn't finite."""
    found = np.linalg.norm(np.asarray(trajectories, dtype=float), axis=2)
    return np.where(np.isfinite(found).all(axis=1, keepdims=True), found, np.nan)


def settle(trajectories: np.ndarray, load_steps: np.ndarray, mechanics: Mechanics) -> pd.DataFrame:
    """Find when simulated displacements enter the 5 % band after release for good.

    Args:
        trajectories: displacement of the contact vertex after steps 1..T, shape [n, T, 3] [scene units].
        load_steps: number of steps under load, shape [n]; release is at load_steps·Δt.
        mechanics: time step of the rollout.

    Returns:
        One row a trajectory: `state` (`settled`, or why there is no settling time: `not reached` or `no release` within
        the horizon), `settling_time_s` (from release until the displacement stays within 5 % of the peak; 0 where it
        already was), `release_s` (since first contact), `peak` [scene units] and `end_fraction_of_peak` (displacement
        at the end of the horizon). What doesn't exist is not a number.
    """
    distance = distances(trajectories)
    peak, step = distance.max(axis=1), np.arange(1, distance.shape[1] + 1)
    outside = (distance > 0.05 * peak[:, None]) & (step >= load_steps[:, None])
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
    """Return the height to which the median displacement rises, as a share of the highest peak of all (Bini 2026,
    figure 3b).

    Args:
        trajectories: as in `settle`; those that aren't finite are left out.
    """
    distance = distances(trajectories)
    distance = distance[~np.isnan(distance[:, 0])]
    peak = distance.max(initial=0.0)
    return float(np.median(distance, axis=0).max() / peak) if peak > 0 else np.nan


def motion_row(settling: pd.DataFrame) -> dict[str, object]:
    """Summarise one regime's motions, as `settle` gives them, in numbers for reading."""
    states = "settled", "not reached", "no release", "no motion", "not finite"
    return {
        "median settling time [s]": settling["settling_time_s"].median(),
        "longest [s]": settling["settling_time_s"].max(),
        **{state: int((settling["state"] == state).sum()) for state in states},
        "peak over 1 scene unit": int((settling["peak"] > 1.0).sum()),
    }
