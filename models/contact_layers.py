"""What the networks on a contact's features are made of."""

from __future__ import annotations

import torch
from torch import Tensor, nn

LOG_SD_RANGE = (-5.0, 1.0)
"""Diagonal of a covariance's factor, in logarithms: standard deviations between 0.7 % and a factor e^2.7."""
FACTOR_NUMBERS = 6
"""Numbers that make a factor of a covariance: its diagonal's logarithms, and its slopes."""


class ResidualLayer(nn.Module):
    """x + W₂·gelu(W₁·norm(x)); keeps the shape [B, width]."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, width)
        )  # fmt: skip

    def forward(self, hidden: Tensor) -> Tensor:
        return hidden + self.layers(hidden)


def covariance_factor(raw: Tensor) -> Tensor:
    """Lower triangular L of the covariance L·Lᵀ, shape [B, 3, 3], from a network's numbers [B, FACTOR_NUMBERS]."""
    first, second, third = torch.exp(raw[:, :3].clamp(*LOG_SD_RANGE)).unbind(1)
    # Rows below the diagonal in units of their own diagonal, so that a correlation is one number whatever the size.
    zero = torch.zeros_like(first)
    slopes = raw[:, 3:]
    rows = (
        torch.stack([first, zero, zero], 1),
        torch.stack([slopes[:, 0] * first, second, zero], 1),
        torch.stack([slopes[:, 1] * first, slopes[:, 2] * second, third], 1),
    )
    return torch.stack(rows, dim=1)
