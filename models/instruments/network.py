"""U-Net on EfficientNet-Lite0 that outlines instruments at half of its input's size, by two looks at a picture."""

import itertools
import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

STAGES = (
    *((1, 3, 1, 16, 1), (6, 3, 2, 24, 2), (6, 5, 2, 40, 2), (6, 3, 2, 80, 3)),
    *((6, 5, 1, 112, 3), (6, 5, 2, 192, 4), (6, 3, 1, 320, 1)),
)
"""Widening, kernel, stride, channels and blocks (Tan 2019, table 1, without squeeze and excitation)."""
TAPS = {0: 16, 1: 24, 2: 32, 4: 48, 6: 64}
"""Decoder's channels by the stage whose output it reads, at 1/2, 1/4, …, 1/32 of the input's size."""
FROZEN = 3
"""Stages after the stem that keep their pretrained weights: a third of the work of a training step."""


def convolution(inputs: int, outputs: int, kernel: int = 1, stride: int = 1, groups: int = 1) -> nn.Sequential:
    """Convolution and batch normalisation, padded as in the encoder's pretraining by TensorFlow."""
    before, after = (kernel - 2) // 2, (kernel - 1) // 2
    pad = nn.ZeroPad2d((before, after, before, after)) if stride == 2 else nn.Identity()
    inside = 0 if stride == 2 else kernel // 2
    conv = nn.Conv2d(inputs, outputs, kernel, stride, inside, groups=groups, bias=False)
    return nn.Sequential(pad, conv, nn.BatchNorm2d(outputs, eps=1e-3))


def activated(*shape: int) -> nn.Sequential:
    """Return the activation with ReLU6, whose range suits 8-bit numbers."""
    return nn.Sequential(convolution(*shape), nn.ReLU6(inplace=True))


class InvertedResidual(nn.Module):
    """Widening, convolution of each channel, and narrowing (Sandler 2018), with a shortcut where the shape stays."""

    def __init__(self, inputs: int, outputs: int, widening: int, kernel: int, stride: int) -> None:
        super().__init__()
        wide = inputs * widening
        first = [activated(inputs, wide)] if widening > 1 else []
        self.body = nn.Sequential(*first, activated(wide, wide, kernel, stride, wide), convolution(wide, outputs))
        self.shortcut = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x) if self.shortcut else self.body(x)


class InstrumentNet(nn.Module):
    """Logits of an instrument from an RGB picture.

    Input [B, 3, H, W] in [0, 1], H and W multiples of 32; output [B, 1, H/2, W/2].
    """

    def __init__(self) -> None:
        super().__init__()
        stages, width = [activated(3, 32, 3, 2)], 32
        for widening, kernel, stride, channels, blocks in STAGES:
            shapes = [(width, channels, widening, kernel, stride)]
            shapes += [(channels, channels, widening, kernel, 1)] * (blocks - 1)
            stages.append(nn.Sequential(*(InvertedResidual(*shape) for shape in shapes)))
            width = channels
        self.encoder = nn.Sequential(*stages)
        self.laterals = nn.ModuleList(activated(STAGES[stage][3], channels) for stage, channels in TAPS.items())
        fine = list(TAPS.values())
        self.merges = nn.ModuleList(
            nn.Sequential(activated(here + coarser, here), activated(here, here, 3))
            for here, coarser in itertools.pairwise(fine)
        )
        self.head = nn.Conv2d(fine[0], 1, 3, padding=1)
        nn.init.constant_(self.head.bias, -2.0)  # ty: ignore[invalid-argument-type]  it has one
        self._pretrained = False

    def load_encoder(self, weights: Mapping[str, Tensor]) -> None:
        """Take over ImageNet weights of EfficientNet-Lite0, in the order of the layers, and keep its first stages.

        Raises:
            RuntimeError, ValueError: they are of another network.
        """
        own = self.encoder.state_dict()
        given = [weight for name, weight in weights.items() if not name.startswith(("_conv_head", "_bn1", "_fc"))]
        self.encoder.load_state_dict(dict(zip(own, given, strict=True)))
        self.freeze()

    def freeze(self) -> None:
        """Freeze the stem, the first stages and all of the encoder's statistics."""
        self._pretrained = True
        self.encoder[: FROZEN + 1].requires_grad_(False)
        self.train(self.training)

    def train(self, mode: bool = True) -> "InstrumentNet":
        super().train(mode)
        if self._pretrained:
            self.encoder.eval()
        return self

    def forward(self, picture: Tensor) -> Tensor:
        """Logits [B, 1, H/2, W/2] of a picture [B, 3, H, W]."""
        x = (picture * 255 - 127) / 128
        kept: list[Tensor] = []
        for index, stage in enumerate(self.encoder.children(), start=-1):
            x = stage(x)
            if index in TAPS:
                kept.append(self.laterals[len(kept)](x))
        x = kept.pop()
        for merge in list(self.merges)[::-1]:
            up = nn.functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
            x = merge(torch.cat([up, kept.pop()], dim=1))
        return self.head(x)


COARSE = (160, 256)
"""Height and width of a picture's coarser look [px], in which instruments that fill the view are found."""
SURE = 0.8
"""Probability above which one look alone makes an instrument: of two looks one is wrong more often than of one."""


class TwoLooks(nn.Module):
    """Logits of an instrument from two looks of a network at a picture: the larger ones, less those of `SURE`.

    Args:
        network: an `InstrumentNet`.

    Input [B, 3, H, W] in [0, 1], H and W multiples of 32; output [B, 1, H/2, W/2].
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, picture: Tensor) -> Tensor:
        """Logits [B, 1, H/2, W/2] of a picture [B, 3, H, W]."""
        fine = self.network(picture)
        small = nn.functional.interpolate(picture, COARSE, mode="bilinear", align_corners=False)
        coarse = nn.functional.interpolate(self.network(small), fine.shape[2:], mode="bilinear", align_corners=False)
        return torch.maximum(fine, coarse) - math.log(SURE / (1 - SURE))
