"""Amortised posterior of one contact: mean and covariance of (log k_s, log k_d, log |F|) given its observation.

A residual network on the contact's features (`data.contact.features`). A picture's features may be added through a
projection that starts at zero.
"""

import math

import torch
from torch import Tensor, nn

from palpate.physics.identifiability import LIMIT

FACTOR_NUMBERS = 6
"""Count of numbers in a factor of a covariance: its diagonal's logarithms, and its slopes."""


class ResidualLayer(nn.Module):
    """x + W₂·gelu(W₁·norm(x)); keeps the shape [B, width]."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, hidden: Tensor) -> Tensor:
        return hidden + self.layers(hidden)


def covariance_factor(raw: Tensor) -> Tensor:
    """Lower triangular L of the covariance L·Lᵀ, shape [B, 3, 3], from a network's numbers [B, FACTOR_NUMBERS].

    Numbers below the diagonal are in units of their column's diagonal, so that a correlation doesn't depend on scale.
    """
    diagonal = torch.exp(raw[:, :3].clamp(-5, 1))  # standard deviations between 0.7 % and a factor e^2.7
    places = torch.eye(9)[[3, 6, 7]].view(3, 3, 3).to(raw)  # of the three below the diagonal, row by row
    return (torch.eye(3).to(raw) + torch.einsum("bk,kij->bij", raw[:, 3:], places)) * diagonal[:, None]


class ExpectedBound(nn.Module):
    """Factor L of a covariance L·Lᵀ whose standard deviations are about the medians of the Cramér–Rao bounds.

    The bounds are those of k_s, k_d, |F| and of the ratios k_s/k_d and F/k_d, between 0.07 and 2.7. Other directions
    of the covariance are not learnt.

    Args:
        features: length of the contact's vector.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(features, 128),
            ResidualLayer(128),
            ResidualLayer(128),
            nn.LayerNorm(128),
            last := nn.Linear(128, FACTOR_NUMBERS),
        )
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias[:3] = math.log(LIMIT)

    def forward(self, contact: Tensor) -> Tensor:
        """Standardised features [B, features] → L [B, 3, 3]."""
        return covariance_factor(self.layers(contact))


class ContactPosterior(nn.Module):
    """q(φ | contact) = N(mean, L·Lᵀ) for φ = (log k_s, log k_d, log |F|), its mean inside the admissible box.

    Args:
        features: length of the contact's vector.
        box: lower and upper φ, shape [2, 3].
        width: size of the hidden layers.
        blocks: number of residual layers.
        picture: number of channels of the encoder's features; 0 = no picture.
    """

    lower: Tensor
    upper: Tensor
    centre: Tensor
    scale: Tensor

    def __init__(self, features: int, box: Tensor, width: int = 256, blocks: int = 4, picture: int = 0) -> None:
        super().__init__()
        self.entry = nn.Linear(features, width)
        self.blocks = nn.Sequential(*(ResidualLayer(width) for _ in range(blocks)))
        self.exit = nn.Sequential(nn.LayerNorm(width), last := nn.Linear(width, 3 + FACTOR_NUMBERS))
        self.picture = nn.Linear(picture, width) if picture else None
        self.expected_bound = ExpectedBound(features)
        box = torch.as_tensor(box, dtype=torch.float32)
        self.register_buffer("lower", box[0])
        self.register_buffer("upper", box[1])
        self.register_buffer("centre", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias[3:6] = math.log(0.5)
            if self.picture is not None:
                nn.init.zeros_(self.picture.weight)
                nn.init.zeros_(self.picture.bias)

    def standardise(self, features: Tensor, least: float = 1e-2, first: int = 0) -> None:
        """Set centre and scale, `least` or more, of the inputs from the `first` on, from examples [N, features]."""
        self.centre[first:] = features.mean(dim=0)[first:]
        self.scale[first:] = features.std(dim=0).clamp(min=least)[first:]

    def forward(self, contact: Tensor, picture: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Contact features [B, features] and pooled picture features [B, picture] → mean [B, 3], factor L [B, 3, 3]."""
        hidden = self.entry((contact - self.centre) / self.scale)
        if self.picture is not None and picture is not None:
            hidden = hidden + self.picture(picture)
        raw = self.exit(self.blocks(hidden))
        mean = self.lower + (self.upper - self.lower) * torch.sigmoid(raw[:, :3])
        return mean, covariance_factor(raw[:, 3:])

    def expected_bound_factor(self, contact: Tensor) -> Tensor:
        """Contact features [B, features] → factor [B, 3, 3] of `ExpectedBound`, which has a loss of its own."""
        return self.expected_bound((contact - self.centre) / self.scale)


def evidence_loss(mean: Tensor, factor: Tensor, gradient: Tensor, information: Tensor, weight: Tensor) -> Tensor:
    """Negative evidence bound of Gaussian posteriors, up to a constant, with the likelihood linearised at the mean.

    The loss is -E_q[log p(d|φ)] + KL(q‖prior) for d = Φ(φ) + noise, with Φ linear within the posterior's width. Its
    gradient by the mean is that of misfit and prior, that by the covariance Σ is that of ½ tr(ΣH) - ½ log det Σ, with H
    the Fisher information plus the prior's precision. The rollout's exact Jacobian gives both without sampling.

    Args:
        mean, factor: mean and covariance factor L of q, shapes [B, 3] and [B, 3, 3].
        gradient: derivative of misfit and prior by φ at the mean, shape [B, 3], a constant.
        information: H there, shape [B, 3, 3], a constant.
        weight: weight of every sample's mean, shape [B].

    Returns:
        Scalar with the gradient of the negative bound.
    """
    spread = 0.5 * (factor.transpose(1, 2) @ information @ factor).diagonal(dim1=1, dim2=2).sum(1)
    entropy = torch.log(factor.diagonal(dim1=1, dim2=2)).sum(1)
    return (weight * (gradient * mean).sum(1) + spread - entropy).mean()
