"""U-Net of residual convolutions that outlines instruments at half of its input's size."""

import torch
from torch import Tensor, nn

WIDTHS = (16, 24, 40, 64, 96)
"""Channels at 1/2, 1/4, 1/8, 1/16 and 1/32 of the input's size."""
REPEATS = (0, 2, 2, 3, 2)
"""Residual blocks of the encoder at each of these sizes."""


def convolution(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution with batch normalisation and ReLU."""
    conv = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class Residual(nn.Module):
    """Two convolutions with a shortcut (He 2016), the second without activation before the sum."""

    def __init__(self, width: int) -> None:
        super().__init__()
        half = width // 2
        self.reduce = convolution(width, half)
        self.expand = nn.Sequential(nn.Conv2d(half, width, 3, padding=1, bias=False), nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.expand(self.reduce(x)))


class InstrumentNet(nn.Module):
    """Logits of an instrument from an RGB picture.

    Input [B, 3, H, W] in [0, 1], H and W multiples of 32; output [B, 1, H/2, W/2].
    """

    def __init__(self) -> None:
        super().__init__()
        self.mean: Tensor
        self.register_buffer("mean", torch.tensor([0.45, 0.3, 0.27]).view(1, 3, 1, 1))
        self.levels = nn.ModuleList()
        for before, width, repeats in zip((3, *WIDTHS), WIDTHS, REPEATS, strict=False):
            down = convolution(before, width, 5 if before == 3 else 3, stride=2)
            self.levels.append(nn.Sequential(down, *(Residual(width) for _ in range(repeats))))
        self.context = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(WIDTHS[-1], WIDTHS[-1], 1), nn.Hardsigmoid())
        self.merges = nn.ModuleList()
        for fine, coarse in zip(WIDTHS[-2::-1], WIDTHS[:0:-1], strict=True):
            after = [Residual(fine)] if fine > WIDTHS[0] else []
            self.merges.append(nn.Sequential(convolution(fine + coarse, fine, 1), convolution(fine, fine), *after))
        self.head = nn.Conv2d(WIDTHS[0], 1, 3, padding=1)
        nn.init.constant_(self.head.bias, -2.0)  # ty: ignore[invalid-argument-type]  it has one

    def forward(self, picture: Tensor) -> Tensor:
        """Logits [B, 1, H/2, W/2] of a picture [B, 3, H, W]."""
        x = (picture - self.mean) * 4
        kept = []
        for level in self.levels:
            x = level(x)
            kept.append(x)
        x = x * self.context(x)
        for merge, skip in zip(self.merges, kept[-2::-1], strict=True):
            up = nn.functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
            x = merge(torch.cat([up, skip], dim=1))
        return self.head(x)
