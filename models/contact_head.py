"""The generator's parameter head with uncertainty: the posterior of the contact, with the picture as a second input."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import SIGNS, Bounds


class ContactHead(nn.Module):
    """q(φ | contact, picture) for φ = (log k_s, log k_d, log |F|), and θ = (e^φ₁, e^φ₂, -e^φ₃) at its mean.

    The picture comes in as in `models.generator.ParameterHead`: a convolution without instance norm, which would leave
    the average pool nothing but zeros, then ReLU and the pool.

    Args:
        channels: number of channels of the encoder's features.
        bounds: admissible box of θ and where the untrained head starts in it.
        contact_features: length of the contact's vector.
        picture: whether the head uses the encoder's features at all.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, channels: int, bounds: Bounds, contact_features: int, picture: bool = True) -> None:
        super().__init__()
        if contact_features < 1:
            raise ValueError(
                "head posterior needs the contact's motion and its noise; set data.samples.observation to "
                "trajectory and data.geometry.smoothing above 0, or choose head parameters."
            )
        self.convolution = nn.Conv2d(channels, channels, 3, stride=2, padding=1) if picture else None
        picture_channels = channels if picture else 0
        self.posterior = ContactPosterior(contact_features, torch.from_numpy(bounds.log_box), picture=picture_channels)
        self.register_buffer("lower", torch.tensor(bounds.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(bounds.upper), persistent=False)
        with torch.no_grad():
            place = self.scaled(torch.tensor([bounds.initial]))[0]
            self.posterior.exit.get_parameter("1.bias")[:3] = torch.logit(place)

    def scaled(self, theta: Tensor) -> Tensor:
        """θ [B, 3] in physical units → its place in the box of logarithms, [0, 1] inside.

        No force at all, as in the identity loss, has the place of the weakest.
        """
        low, high = self.posterior.lower, self.posterior.upper
        return (torch.log(theta.abs().clamp(min=torch.exp(low))) - low) / (high - low)

    def theta(self, mean: Tensor) -> Tensor:
        """φ [B, 3] → θ [B, 3] in physical units, F signed, never outside the box."""
        theta = torch.exp(mean) * mean.new_tensor(SIGNS)
        return torch.clamp(theta, self.lower, self.upper)  # rounding may carry it past a bound

    def forward(self, features: Tensor, contact: Tensor) -> tuple[Tensor, Tensor]:
        """Features [B, C, h, w] and the contact's vector [B, contact_features] → mean [B, 3], factor L [B, 3, 3]."""
        if self.convolution is None:
            return self.posterior(contact)
        picture = functional.relu(self.convolution(features)).mean(dim=(2, 3))
        return self.posterior(contact, picture)
