"""How well a contact's parameters can be known, as far as what was seen of it tells: the covariance of its verdict.

The Cramér–Rao bound depends on θ, which is uncertain itself, and a posterior is narrow where the prior helps although
the motion tells nothing. So the bound is estimated for itself: the median of what it is among contacts that look alike.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from physics.identifiability import LIMIT, RATIOS, bounds, ratio_bounds

FARTHEST = 2.0
"""Bounds farther from the limit than this, in logarithms, count as so far away: no verdict depends on them."""


def bound_loss(factor: Tensor, information: np.ndarray) -> Tensor:
    """Mean absolute error of log bounds, which is least where they are medians.

    Of those of k_s, k_d, |F|, k_s/k_d and F/k_d, and of the two that decide a verdict: the worst parameter's and the
    worse ratio's.

    Args:
        factor: of `models.posterior.ExpectedBound`, shape [B, 3, 3].
        information: Fisher information of what was seen, shape [B, 3, 3].
    """
    rows = torch.cat([torch.eye(3), torch.from_numpy(RATIOS).float()]).to(factor)
    expected = _with_worst(torch.log((rows @ factor).square().sum(dim=2).sqrt()))
    true = np.log(np.concatenate([bounds(information), ratio_bounds(information)], axis=-1))
    wanted = _with_worst(torch.from_numpy(true).to(factor))
    middle = math.log(LIMIT)
    return (expected - wanted.clamp(middle - FARTHEST, middle + FARTHEST)).abs().mean()


def _with_worst(logs: Tensor) -> Tensor:
    """Of the bounds of all quantities [B, 5]: these, the largest parameter's and the larger ratio's, shape [B, 7]."""
    return torch.cat([logs, logs[:, :3].amax(1, keepdim=True), logs[:, 3:].amax(1, keepdim=True)], dim=1)
