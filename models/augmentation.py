"""Optional sensor noise on the input windows during training. Off by default."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from kornia.augmentation import RandomGaussianNoise
from torch import Tensor, nn


@dataclass(frozen=True)
class AugmentationSettings:
    """Noise on the windows that enter the networks; the depth maps in the losses stay without it."""

    noise: float = 0.0
    """Standard deviation of Gaussian noise on every valid depth pixel [scene units]; 0 = none."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.noise) and self.noise >= 0):
            raise ValueError(f"augmentation.noise is {self.noise}; give a standard deviation of at least 0.")


class WindowAugmentation(nn.Module):
    """Adds noise to windows of depth maps, reproducibly: the same seed gives the same noise."""

    def __init__(self, settings: AugmentationSettings) -> None:
        super().__init__()
        self.settings = settings
        self.noise = RandomGaussianNoise(mean=0.0, std=settings.noise, p=1.0)

    def forward(self, window: Tensor, seed: int) -> Tensor:
        """Window [B, K, H, W] with 0 = invalid → the window with noise; invalid pixels stay invalid.

        The global random state is left as it was, so that a resumed training gets the noise of an uninterrupted one.
        """
        if not self.settings.noise:
            return window
        with torch.random.fork_rng(devices=[window.device] if window.device.type == "cuda" else []):
            torch.manual_seed(seed)
            return self.noise(window).clamp(0.0, 1.0) * (window > 0)
