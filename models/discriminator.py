"""PatchGAN discriminator with a receptive field of 70×70 pixels.

Source: Bini 2026, section 3.4.1; the 70×70 layout is that of Isola 2017 (pix2pix).
"""

from torch import Tensor, nn


class PatchDiscriminator(nn.Module):
    """Scores overlapping 70×70 patches of a depth map as real (1) or generated (0).

    Four 4×4 blocks, width→2→4→8 times width. The paper has stride 2 for all four, which gives a receptive field of 94.
    Here the fourth block has stride 1, which gives the paper's 70.

    Args:
        width: channels of the first block (the paper has 64).
    """

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv2d(1, width, 4, stride=2, padding=1), nn.LeakyReLU(0.2)]
        for factor, stride in ((1, 2), (2, 2), (4, 1)):
            layers += [
                nn.Conv2d(factor * width, 2 * factor * width, 4, stride=stride, padding=1),
                nn.InstanceNorm2d(2 * factor * width),
                nn.LeakyReLU(0.2),
            ]
        layers.append(nn.Conv2d(8 * width, 1, 4, stride=1, padding=1))
        self.layers = nn.Sequential(*layers)

    def forward(self, depth: Tensor) -> Tensor:
        """Depth [B, 1, H, W] → one score a patch, shape [B, 1, H//8 − 2, W//8 − 2].

        Raises:
            ValueError: a picture under 32 pixels a side.
        """
        if min(depth.shape[2:]) < 32:
            raise ValueError(f"depth is {depth.shape[2]}×{depth.shape[3]}; the discriminator needs 32 pixels a side.")
        return self.layers(depth)
