"""Batches against observations: the paper's squared error.

Source: Bini 2026, equation 14 (the squared 2-norm of a displacement's difference), extended to several time stamps.
"""

import torch
from torch import Tensor

from palpate.physics.msd.batch import ObservationBatch


def displacement_error(trajectory: Tensor, observation: ObservationBatch) -> Tensor:
    """Weighted mean of squared distances, Σ_m w_m ‖u(t_m) − d_m‖² / Σ_m w_m (Bini 2026, equation 14, with M = 1).

    Args:
        trajectory: displacement of the contact vertex, shape [B, T, 3] [scene units].
        observation: observed motion; padding may hold anything, also NaN.

    Returns:
        Shape [B] [scene units²]; 0 for a sample without any observation.
    """
    weight = observation.weight.clamp(min=0.0)
    total = weight.sum(dim=1)
    steps = observation.steps.clamp(0, trajectory.shape[1] - 1)
    simulated = torch.gather(trajectory, 1, steps[..., None].expand(-1, -1, 3))
    difference = torch.where((weight > 0)[..., None], simulated - observation.displacement, 0.0)
    return (weight * difference.square().sum(dim=-1)).sum(dim=1) / torch.where(total > 0, total, 1.0)
