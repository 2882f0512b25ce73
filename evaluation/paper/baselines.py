"""What an estimate has to beat: one constant θ for everything, no motion at all, and the literature's constants.

A predictor that has collapsed to a constant looks good against badly chosen constants, so the constant here is the best
one that the training contacts allow. This is the only module of the package that runs the simulator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.stats import qmc

from data.contact.interaction import Interaction
from physics.mechanics import REFERENCE_DAMPING, REFERENCE_STIFFNESS, Bounds, Mechanics
from physics.msd import rollout
from physics.msd.batch import MeshBatch, ObservationBatch, PressBatch
from physics.msd.likelihoods import displacement_error
from physics.observation import Observation

WARP = float(np.log(1000.0))
"""How strongly the search spreads its coordinates towards the end of each range that lies nearest to 0."""
NOT_FINITE_ERROR = 1e12
"""Objective where the simulation isn't finite: high enough for the line search to turn back."""
PERTURBATION = 1e-4
"""Relative change of F in the test for chaos."""
CHAOTIC_AMPLIFICATION = 100.0
"""A trajectory that changes by more than this times the relative change of F can't be predicted in float32."""


@dataclass(frozen=True)
class ConstantThetaSettings:
    """Budget of the constant-θ fit."""

    contacts: int = 8
    """Most training contacts used, evenly spaced over those available."""
    starts: int = 8
    """Starting points tried: θ₀ and a Sobol sequence over the admissible box."""
    refined: int = 2
    """Best starting points that are refined with L-BFGS-B."""
    iterations: int = 10
    """Most L-BFGS-B iterations for each of them."""
    batch_size: int = 2
    """Contacts simulated together."""

    def __post_init__(self) -> None:
        for name in ("contacts", "starts", "refined", "iterations", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"constant-θ setting {name} is {getattr(self, name)}; give at least 1.")


@dataclass(frozen=True)
class ConstantTheta:
    """The constant that explains the training contacts best."""

    theta: tuple[float, float, float]
    """(k_s, k_d, F), F signed."""
    training_error: float
    """Mean displacement error over the contacts used [scene units²]."""
    contacts_used: int
    contacts_available: int
    evaluations: int
    """Times that all contacts used were simulated."""
    not_finite: int
    """How many of those evaluations weren't finite."""


def reference_theta(theta: np.ndarray) -> np.ndarray:
    """θ [n, 3] with k_s and k_d replaced by the literature values, F kept (Bini 2026, section 4.1)."""
    result = np.array(theta, dtype=float)
    result[:, 0], result[:, 1] = REFERENCE_STIFFNESS, REFERENCE_DAMPING
    return result


def no_motion_error(observation: Observation) -> float:
    """Displacement error when nothing moves (F = 0), the mean of ‖d‖² [scene units²]; 0 where nothing was seen."""
    moved = observation.displacement[0].astype(float)
    seen = np.isfinite(moved).all(axis=1)
    return float(np.square(moved[seen]).sum(axis=1).mean()) if seen.any() else 0.0


Batch = tuple[slice, MeshBatch, PressBatch, ObservationBatch]


def _batches(contacts: Sequence[Interaction], batch_size: int) -> Iterator[Batch]:
    """Contacts in simulator batches; the slice says which contacts a batch holds."""
    for start in range(0, len(contacts), batch_size):
        part = slice(start, min(start + batch_size, len(contacts)))
        members = contacts[part]
        yield (
            part,
            MeshBatch.from_meshes([contact.mesh for contact in members]),
            PressBatch.of([contact.load for contact in members]),
            ObservationBatch.of([contact.observation for contact in members], members[0].time_step),
        )


def simulate_contacts(
    theta: np.ndarray, contacts: Sequence[Interaction], mechanics: Mechanics, batch_size: int = 2
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate every contact with its own θ.

    Args:
        theta: parameters, shape [n, 3], or [3] for the same in all contacts.
        contacts: the n contacts.

    Returns:
        Contact-vertex displacements [n, T, 3] [scene units] and displacement errors [n] [scene units²].
    """
    theta = np.broadcast_to(np.asarray(theta, dtype=np.float32), (len(contacts), 3))
    trajectories = np.empty((len(contacts), mechanics.steps, 3), dtype=np.float32)
    errors = np.empty(len(contacts))
    with torch.no_grad():
        for part, mesh, load, observation in _batches(contacts, batch_size):
            trajectory = rollout(torch.tensor(theta[part]), mesh, load, mechanics)
            trajectories[part] = trajectory.numpy()
            errors[part] = displacement_error(trajectory, observation).numpy()
    return trajectories, errors


def amplification(theta: np.ndarray, contacts: Sequence[Interaction], mechanics: Mechanics) -> np.ndarray:
    """How much a trajectory answers to a minute change of F, shape [n]; about 1 where the motion is regular.

    Largest displacement between the trajectories of F and F·(1 + 1e-4), relative to the peak and to 1e-4; infinite
    where a trajectory isn't finite.
    """
    theta = np.asarray(theta, dtype=float)
    nudged = theta * np.array([1.0, 1.0, 1.0 + PERTURBATION])
    first, _ = simulate_contacts(theta, contacts, mechanics)
    second, _ = simulate_contacts(nudged, contacts, mechanics)
    result = np.full(len(contacts), np.inf)
    for row, (one, other) in enumerate(zip(first.astype(float), second.astype(float), strict=True)):
        if np.isfinite(one).all() and np.isfinite(other).all():
            peak = np.linalg.norm(one, axis=1).max()
            change = np.linalg.norm(other - one, axis=1).max()
            result[row] = change / (PERTURBATION * peak) if peak > 0 else 0.0
    return result


def _ends(bounds: Bounds) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The end of each range nearest to 0, the other end, and whether the range lies on one side of 0."""
    lower, upper = np.array(bounds.lower), np.array(bounds.upper)
    upper_is_near = np.abs(upper) < np.abs(lower)
    near, far = np.where(upper_is_near, upper, lower), np.where(upper_is_near, lower, upper)
    return near, far, lower * upper >= 0


def _to_theta(unit: np.ndarray, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """θ and dθ/d(unit) of search coordinates in [0, 1]³.

    Displacements that fit real scenes lie at a small fraction of the paper's ranges, so coordinates are spread
    exponentially from the end nearest to 0; both ends stay reachable. A range that crosses 0 is spread evenly.
    """
    near, far, one_sided = _ends(bounds)
    fraction = np.where(one_sided, np.expm1(WARP * unit) / np.expm1(WARP), unit)
    slope = np.where(one_sided, WARP * np.exp(WARP * unit) / np.expm1(WARP), 1.0)
    return near + (far - near) * fraction, (far - near) * slope


def _to_unit(theta: np.ndarray, bounds: Bounds) -> np.ndarray:
    """Search coordinates of θ, the inverse of `_to_theta`."""
    near, far, one_sided = _ends(bounds)
    fraction = (np.asarray(theta) - near) / (far - near)
    return np.where(one_sided, np.log1p(fraction * np.expm1(WARP)) / WARP, fraction)


class _Objective:
    """Mean displacement error of a constant θ over fixed contacts, with its gradient in search coordinates."""

    def __init__(self, contacts: Sequence[Interaction], bounds: Bounds, mechanics: Mechanics, batch_size: int) -> None:
        self.batches = list(_batches(contacts, batch_size))
        self.count, self.bounds, self.mechanics = len(contacts), bounds, mechanics
        self.evaluations = self.not_finite = 0
        # The error of "nothing moves" sets the scale, so that the optimiser's tolerances mean the same in every scene.
        self.scale = max(float(np.mean([no_motion_error(contact.observation) for contact in contacts])), 1e-30)

    def __call__(self, unit: np.ndarray, gradient: bool = True) -> tuple[float, np.ndarray]:
        self.evaluations += 1
        theta, slope = _to_theta(unit, self.bounds)
        leaf = torch.tensor(theta, dtype=torch.float32, requires_grad=gradient)
        total, slopes = 0.0, np.zeros(3)
        for part, mesh, load, observation in self.batches:
            with torch.set_grad_enabled(gradient):
                trajectory = rollout(leaf.expand(part.stop - part.start, 3), mesh, load, self.mechanics)
                error = displacement_error(trajectory, observation).sum()
            if gradient:
                slopes += torch.autograd.grad(error, leaf)[0].numpy()
            total += float(error.detach())
        total, slopes = total / self.count / self.scale, slopes * slope / self.count / self.scale
        if not (np.isfinite(total) and np.isfinite(slopes).all()):
            self.not_finite += 1
            return NOT_FINITE_ERROR, np.zeros(3)
        return total, slopes


def fit_constant_theta(
    contacts: Sequence[Interaction], bounds: Bounds, mechanics: Mechanics, settings: ConstantThetaSettings | None = None
) -> ConstantTheta | None:
    """Find the constant θ in the admissible box with the lowest mean displacement error over the training contacts.

    θ₀ and Sobol points over the box are tried, and the best of them refined with L-BFGS-B through the rollout's
    gradient. Deterministic.

    Returns:
        The constant, or None when there are no contacts.
    """
    settings = settings or ConstantThetaSettings()
    if not contacts:
        return None
    count = min(settings.contacts, len(contacts))
    chosen = np.unique(np.linspace(0, len(contacts) - 1, count).round().astype(int))
    objective = _Objective([contacts[i] for i in chosen], bounds, mechanics, settings.batch_size)
    points = qmc.Sobol(3, scramble=False).random_base2(int(np.ceil(np.log2(settings.starts + 1))))
    # The first Sobol point is the corner of the box; θ₀ takes its place.
    starts = [_to_unit(np.array(bounds.initial), bounds), *points[1 : settings.starts]]
    values = [objective(start, gradient=False)[0] for start in starts]
    order = np.argsort(values, kind="stable")
    best_value, best_unit = values[order[0]], starts[order[0]]
    for index in order[: settings.refined]:
        result = minimize(
            objective, starts[index], jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * 3,
            options={"maxiter": settings.iterations, "maxfun": 2 * settings.iterations},
        )  # fmt: skip
        if result.fun < best_value:
            best_value, best_unit = float(result.fun), result.x
    theta, _ = _to_theta(np.asarray(best_unit), bounds)
    return ConstantTheta(
        theta=(float(theta[0]), float(theta[1]), float(theta[2])),
        training_error=best_value * objective.scale,
        contacts_used=len(chosen),
        contacts_available=len(contacts),
        evaluations=objective.evaluations,
        not_finite=objective.not_finite,
    )
