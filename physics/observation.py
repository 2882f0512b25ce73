"""How far a simulated trajectory is from what was seen.

Source: Bini 2026, equation 14 (the squared 2-norm of a displacement's difference), extended to several time stamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class ObservationBatch:
    """Observed displacements of the contact point, up to M a sample."""

    steps: Tensor
    """Index into the trajectory that each observation belongs to, shape [B, M], int64."""
    displacement: Tensor
    """Observed displacement from rest, shape [B, M, 3], float32 [scene units]."""
    weight: Tensor
    """Weight of each observation, 0 for padding, shape [B, M], float32."""


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
