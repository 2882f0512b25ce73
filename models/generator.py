"""Dual-mode conditional generator: one encoder, a parameter head, and a decoder conditioned on the parameters.

Source: Bini 2026, section 3.4.1 and figure 2.
"""

from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import SIGNS, Bounds


class PictureHead(nn.Module):
    """Base of both heads: the box of θ, and the picture's features in one vector.

    Their convolution has no instance norm, with which the average pool would give only zeros.

    Args:
        channels: number of channels of the encoder's features.
        bounds: admissible box of θ and where the untrained head starts in it.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, channels: int, bounds: Bounds) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(channels, channels, 3, stride=2, padding=1)
        self.register_buffer("lower", torch.tensor(bounds.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(bounds.upper), persistent=False)

    def pooled(self, features: Tensor) -> Tensor:
        """Features [B, C, h, w] → their mean over the picture [B, C]."""
        return functional.relu(self.convolution(features)).mean(dim=(2, 3))


class ContactHead(PictureHead):
    """q(φ | contact, picture) for φ = (log k_s, log k_d, log |F|), and θ = (e^φ₁, e^φ₂, -e^φ₃) at its mean.

    Args:
        channels, bounds: arguments of `PictureHead`.
        contact_features: length of the contact's vector.
    """

    def __init__(self, channels: int, bounds: Bounds, contact_features: int) -> None:
        super().__init__(channels, bounds)
        if contact_features < 1:
            problem = "head posterior needs the contact's motion and its noise; set data.samples.observation to"
            raise ValueError(f"{problem} trajectory and data.geometry.smoothing above 0, or choose head parameters.")
        self.posterior = ContactPosterior(contact_features, torch.from_numpy(bounds.log_box), picture=channels)
        with torch.no_grad():
            place = self.scaled(torch.tensor([bounds.initial]))[0]
            self.posterior.exit.get_parameter("1.bias")[:3] = torch.logit(place)

    def scaled(self, theta: Tensor) -> Tensor:
        """θ [B, 3] in physical units → its place in the box of logarithms, [0, 1] inside.

        A force of 0, as in the identity loss, has the place of the weakest.
        """
        low, high = self.posterior.lower, self.posterior.upper
        return (torch.log(theta.abs().clamp(min=torch.exp(low))) - low) / (high - low)

    def theta(self, mean: Tensor) -> Tensor:
        """φ [B, 3] → θ [B, 3] in physical units, F signed, never outside the box."""
        theta = torch.exp(mean) * mean.new_tensor(SIGNS)
        return torch.clamp(theta, self.lower, self.upper)  # rounding may carry it past a bound

    def forward(self, features: Tensor, contact: Tensor) -> tuple[Tensor, Tensor]:
        """Features [B, C, h, w] and the contact's vector [B, contact_features] → mean [B, 3], factor L [B, 3, 3]."""
        return self.posterior(contact, self.pooled(features))


class HeadOutput(NamedTuple):
    """Output of a head for a batch."""

    theta: Tensor
    """[k_s, k_d, F], physical units, F signed, shape [B, 3]."""
    mean: Tensor | None = None
    """Mean of (log k_s, log k_d, log |F|), shape [B, 3]; none from head parameters."""
    factor: Tensor | None = None
    """Lower triangular L of their covariance L·Lᵀ, shape [B, 3, 3]; none from head parameters."""


def normalised_block(layer: nn.Conv2d) -> nn.Sequential:
    """Convolution, instance norm without learned scale, ReLU (Bini 2026, section 3.4.1)."""
    return nn.Sequential(layer, nn.InstanceNorm2d(layer.out_channels), nn.ReLU())


class ResidualBlock(nn.Module):
    """Two 3×3 convolutions with instance norm around an identity path; keeps the shape [B, C, h, w]."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            normalised_block(nn.Conv2d(channels, channels, 3, padding=1, padding_mode="reflect")),
            nn.Conv2d(channels, channels, 3, padding=1, padding_mode="reflect"),
            nn.InstanceNorm2d(channels),
        )

    def forward(self, features: Tensor) -> Tensor:
        return features + self.layers(features)


class ParameterHead(PictureHead):
    """θ = [k_s, k_d, F] from the encoder's features: sigmoid for k_s and k_d, tanh for F, scaled to the box."""

    def __init__(self, channels: int, bounds: Bounds) -> None:
        super().__init__(channels, bounds)
        self.layers = nn.Sequential(
            nn.Linear(channels, channels),
            nn.ReLU(),
            nn.Linear(channels, channels // 2),
            nn.ReLU(),
            last := nn.Linear(channels // 2, 3),
        )
        fraction = self.scaled(torch.tensor(bounds.initial))
        with torch.no_grad():  # untrained it gives θ₀, nearly: the small weights leave it a slope in its input
            last.weight.mul_(0.1)
            last.bias[:2] = torch.logit(fraction[:2])
            last.bias[2] = torch.atanh(2 * fraction[2] - 1)

    def scaled(self, theta: Tensor) -> Tensor:
        """θ [B, 3] in physical units → its place in the box, [0, 1] inside."""
        return (theta - self.lower) / (self.upper - self.lower)

    def forward(self, features: Tensor) -> Tensor:
        """Features [B, C, h, w] → θ [B, 3] in physical units, F signed, never outside the box."""
        raw = self.layers(self.pooled(features))
        fraction = torch.cat([torch.sigmoid(raw[:, :2]), 0.5 * (torch.tanh(raw[:, 2:]) + 1)], dim=1)
        # Rounding may carry the scaled value past a bound by one unit in the last place.
        return torch.clamp(self.lower + (self.upper - self.lower) * fraction, self.lower, self.upper)


class Decoder(nn.Module):
    """Next depth map from features and θ: θ tiled onto the features, residual blocks, two upsamplings.

    Source: Bini 2026, section 3.4.1.
    Upsampling resizes to a given size before a 3×3 convolution, so that odd sizes are met exactly.
    Instance norm removes the level and the spread of a depth map before the decoder gets it, and the tiled θ can't
    bring them back. `physics` therefore adds the layers' output to the current frame carried along by the rollout of θ
    (`models.carried_depth`), in logit space. Its layers don't get θ as an input: they would undo a part of the change
    that the rollout of θ predicts.
    """

    def __init__(self, width: int, residual_blocks: int, kind: Literal["direct", "physics"]) -> None:
        super().__init__()
        self.kind = kind
        channels = 4 * width
        # No instance norm here: it would subtract a tiled constant, and θ would never reach the picture.
        self.condition = nn.Sequential(nn.Conv2d(channels + 3 * (kind == "direct"), channels, 1), nn.ReLU())
        self.blocks = nn.Sequential(*(ResidualBlock(channels) for _ in range(residual_blocks)))
        self.up_half = normalised_block(nn.Conv2d(channels, 2 * width, 3, padding=1, padding_mode="reflect"))
        self.up_full = normalised_block(nn.Conv2d(2 * width, width, 3, padding=1, padding_mode="reflect"))
        self.output = nn.Conv2d(width, 1, 7, padding=3, padding_mode="reflect")
        if kind == "physics":  # training starts at the carried frame
            nn.init.zeros_(self.output.weight)
            nn.init.zeros_(self.output.get_parameter("bias"))

    def forward(self, features: Tensor, scaled_theta: Tensor, current: Tensor) -> Tensor:
        """Features [B, 4·width, h, w], θ in [0, 1] [B, 3], current depth [B, 1, H, W] → the next, in (0, 1)."""
        size = (current.shape[2], current.shape[3])
        if self.kind == "direct":
            tiled = scaled_theta[:, :, None, None].expand(-1, -1, *features.shape[2:])
            features = torch.cat([features, tiled], dim=1)
        hidden = self.blocks(self.condition(features))
        hidden = self.up_half(functional.interpolate(hidden, size=(size[0] // 2, size[1] // 2)))
        hidden = self.up_full(functional.interpolate(hidden, size=size))
        change = self.output(hidden)
        if self.kind == "physics":
            # Depths are kept this far from 0 and 1 before their logit is taken.
            change = change + torch.logit(current, eps=1e-3)
        return torch.sigmoid(change)


class Generator(nn.Module):
    """G of Bini 2026, section 3.4.1; the defaults are the paper's.

    Depth is normalised by the clip's fixed scale, in [0, 1], with 0 where it is invalid. The window's last channel is
    the current frame. θ = [k_s, k_d, F] is in physical units with F signed.

    Args:
        channels: frames in the input window (K; the paper has 1).
        width: channels after the first convolution; the features have four times as many.
        residual_blocks: residual blocks of the decoder.
        bounds: admissible box of θ and where the head starts in it.
        decoder: direct (paper) or physics; see `Decoder`.
        head: parameters (paper): θ from the window alone; posterior: a Gaussian over log θ from the contact's vector
            and the window; see `models.generator.ContactHead`.
        contact_features: length of the contact's vector; head posterior needs it.
    """

    def __init__(
        self,
        channels: int = 1,
        width: int = 64,
        residual_blocks: int = 9,
        bounds: Bounds | None = None,
        decoder: Literal["direct", "physics"] = "direct",
        head: Literal["parameters", "posterior"] = "parameters",
        contact_features: int = 0,
    ) -> None:
        super().__init__()
        # Four times the paper's width has half a billion weights.
        if not (channels >= 1 and 1 <= width <= 256 and 0 <= residual_blocks <= 64):
            problem = f"channels is {channels}, width {width} and residual_blocks {residual_blocks}; give 1 channel"
            raise ValueError(f"{problem} or more, a width of 1 to 256 and 0 to 64 blocks.")
        self.channels = channels
        self.encoder = nn.Sequential(
            normalised_block(nn.Conv2d(channels, width, 7, padding=3, padding_mode="reflect")),
            # 4×4 kernels turn 120×214 into the paper's 30×53; 3×3 would give 30×54.
            normalised_block(nn.Conv2d(width, 2 * width, 4, stride=2, padding=1)),
            normalised_block(nn.Conv2d(2 * width, 4 * width, 4, stride=2, padding=1)),
        )
        bounds = bounds or Bounds()
        self.head: ParameterHead | ContactHead
        if head == "posterior":
            self.head = ContactHead(4 * width, bounds, contact_features)
        else:
            self.head = ParameterHead(4 * width, bounds)
        self.decoder = Decoder(width, residual_blocks, decoder)

    @property
    def posterior(self) -> ContactPosterior:
        """The posterior within head posterior; ValueError with head parameters, which has none."""
        if not isinstance(self.head, ContactHead):
            raise ValueError("head parameters has no posterior; choose head posterior.")
        return self.head.posterior

    def encode(self, depth: Tensor) -> Tensor:
        """Window of depth maps [B, K, H, W] → features [B, 4·width, H//4, W//4] (256×30×53 for 120×214).

        Raises:
            ValueError: a picture under 16 pixels a side.
        """
        if min(depth.shape[2:]) < 16:  # the features need a variance to normalise by
            raise ValueError(f"depth is {depth.shape[2]}×{depth.shape[3]}; give 16 pixels a side or more.")
        return self.encoder(depth)

    def answer(self, features: Tensor, contact: Tensor | None = None) -> HeadOutput:
        """The head's output for features [B, 4·width, H//4, W//4].

        Args:
            features: output of `encode`.
            contact: the contact's vector, shape [B, contact_features]; head parameters ignores it.
        """
        if isinstance(self.head, ParameterHead):
            return HeadOutput(self.head(features))
        assert contact is not None
        mean, factor = self.head(features, contact)
        return HeadOutput(self.head.theta(mean), mean, factor)

    def estimate(self, depth: Tensor, contact: Tensor | None = None) -> Tensor:
        """P(E(D)): window [B, K, H, W] and contact's vector → θ [B, 3] (Bini 2026, below equation 12)."""
        return self.answer(self.encode(depth), contact).theta

    def decode(self, features: Tensor, theta: Tensor, current: Tensor) -> Tensor:
        """Next depth map from encoded features.

        Args:
            features: output of `encode`, shape [B, 4·width, H//4, W//4].
            theta: [k_s, k_d, F], physical units, shape [B, 3].
            current: the current frame's depth, with decoder physics carried along by the rollout of θ, shape
                [B, 1, H, W]. Its invalid pixels (0) stay invalid: a filled hole would give every fake away.

        Returns:
            Depth in [0, 1], shape [B, 1, H, W].
        """
        return self.decoder(features, self.head.scaled(theta), current) * (current > 0)

    def generate(self, depth: Tensor, theta: Tensor, start: Tensor | None = None) -> Tensor:
        """G(D, θ): window [B, K, H, W] and θ [B, 3] → predicted next depth [B, 1, H, W], exactly the input's size.

        `start` is `decode`'s `current`, by default the window's last map.
        """
        return self.decode(self.encode(depth), theta, depth[:, -1:] if start is None else start)
