"""How well a contact's parameters can be known from its observation: the covariance behind its verdict.

The Cramér–Rao bound depends on θ, which is uncertain itself, and a posterior is narrow where the prior helps although
the motion holds no information. So the bound has an estimate of its own: its median over contacts with equal features.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from palpate.physics.identifiability import LIMIT, RATIOS, bounds, ratio_bounds

MAX_LOG_DISTANCE = 2.0
"""Log bounds farther than this from the limit are clipped to it: no verdict depends on them."""


def bound_loss(factor: Tensor, information: np.ndarray) -> Tensor:
    """Mean absolute error of log bounds, which is least where they are medians.

    The bounds are those of k_s, k_d, |F|, k_s/k_d and F/k_d, and the two that decide a verdict: the worst parameter's
    and the worse ratio's.

    Args:
        factor: output of `models.posterior.ExpectedBound`, shape [B, 3, 3].
        information: Fisher information of the observations, shape [B, 3, 3].
    """
    rows = torch.cat([torch.eye(3), torch.from_numpy(RATIOS).float()]).to(factor)
    expected = _with_worst(torch.log((rows @ factor).square().sum(dim=2).sqrt()))
    true = np.log(np.concatenate([bounds(information), ratio_bounds(information)], axis=-1))
    wanted = _with_worst(torch.from_numpy(true).to(factor))
    middle = math.log(LIMIT)
    return (expected - wanted.clamp(middle - MAX_LOG_DISTANCE, middle + MAX_LOG_DISTANCE)).abs().mean()


def _with_worst(logs: Tensor) -> Tensor:
    """Log bounds [B, 5], followed by the largest parameter's and the larger ratio's, shape [B, 7]."""
    return torch.cat([logs, logs[:, :3].amax(1, keepdim=True), logs[:, 3:].amax(1, keepdim=True)], dim=1)
