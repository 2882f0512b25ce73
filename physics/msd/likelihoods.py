"""Batches against what was seen: the paper's squared error, and the likelihood around each sample's φ.

Source: Bini 2026, equation 14 (the squared 2-norm of a displacement's difference), extended to several time stamps.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from physics.likelihood import Likelihood, Linearised
from physics.mechanics import Mechanics
from physics.msd.autograd import map_samples
from physics.msd.batch import MeshBatch, ObservationBatch, PressBatch
from physics.observation import Observation


def displacement_error(trajectory: Tensor, observation: ObservationBatch) -> Tensor:
    """Weighted mean of squared distances, Σ_m w_m ‖u(t_m) − d_m‖² / Σ_m w_m (Bini 2026, equation 14, with M = 1).

    Args:
        trajectory: displacement of the contact vertex, shape [B, T, 3] [scene units].
        observation: what was seen; padding may hold anything, also NaN.

    Returns:
        Shape [B] [scene units²]; 0 for a sample without any observation.

    Raises:
        ValueError: shapes that don't belong together.
    """
    batch, count = observation.steps.shape
    for name, value, shape in (
        ("trajectory", trajectory, (batch, trajectory.shape[1], 3)),
        ("displacement", observation.displacement, (batch, count, 3)),
        ("weight", observation.weight, (batch, count)),
    ):
        if tuple(value.shape) != shape:
            raise ValueError(
                f"{name} has shape {tuple(value.shape)}; give {shape} for steps of shape {(batch, count)}."
            )
    seen = observation.weight > 0
    steps = observation.steps.clamp(0, trajectory.shape[1] - 1)
    simulated = torch.gather(trajectory, 1, steps[..., None].expand(-1, -1, 3))
    difference = torch.where(seen[..., None], simulated - observation.displacement, 0.0)
    weight = torch.where(seen, observation.weight, 0.0)
    total = weight.sum(dim=1)
    return (weight * difference.square().sum(dim=-1)).sum(dim=1) / torch.where(total > 0, total, 1.0)


def linearise_batch(
    mean: Tensor,
    noise: Tensor,
    mesh: MeshBatch,
    load: PressBatch,
    observation: ObservationBatch,
    mechanics: Mechanics,
) -> list[Linearised | None]:
    """Every sample's likelihood around its φ, on as many threads as torch uses; None where nothing was seen yet.

    Args:
        mean: φ, shape [B, 3].
        noise: σ of every observed coordinate, shape [B] [scene units].
        mesh, load: the tissue and what presses on it, as far as was seen.
        observation: what was seen of the load's first vertex; weight 0 is padding.
        mechanics: the rollout's constants.
    """
    logs, sigma = mean.detach().cpu().double().numpy(), noise.cpu().double().numpy()
    steps, displacement, weight = (
        values.cpu().numpy() for values in (observation.steps, observation.displacement, observation.weight)
    )
    samples = list(zip(mesh.split(), load.split(), logs, sigma, steps, displacement, weight > 0, strict=True))

    def linearised(sample: tuple) -> Linearised | None:
        single, press, at, deviation, steps, moved, seen = sample
        if not seen.any():
            return None
        times = (steps[seen] + 1) * mechanics.time_step
        observed = Observation.of_point(press.vertex, times, moved[seen], deviation)
        return Likelihood(single, press, observed, mechanics, np.float32).linearise(at)

    return map_samples(linearised, samples)
