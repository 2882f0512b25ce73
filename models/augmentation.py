"""Optional disturbances of the input windows during training: sensor noise and erased regions. Off by default."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from kornia.augmentation import RandomErasing, RandomGaussianNoise
from torch import Tensor, nn


@dataclass(frozen=True)
class AugmentationSettings:
    """How the windows that the networks see are disturbed; what they are compared with never is."""

    noise: float = 0.0
    """Standard deviation of Gaussian noise on every valid depth pixel [scene units]; 0 = none."""
    erasing: float = 0.0
    """Probability that a window has a rectangle erased (made invalid) in all its frames; 0 = never."""
    erased_area: tuple[float, float] = (0.02, 0.1)
    """Smallest and largest erased part of the picture."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.noise) and self.noise >= 0):
            raise ValueError(f"augmentation.noise is {self.noise}; give a standard deviation of at least 0.")
        if not 0 <= self.erasing <= 1:
            raise ValueError(f"augmentation.erasing is {self.erasing}; give a probability between 0 and 1.")
        low, high = self.erased_area
        if not 0 < low <= high < 1:
            raise ValueError(f"augmentation.erased_area is [{low}, {high}]; give two parts of the picture in order.")


class WindowAugmentation(nn.Module):
    """Disturbs windows of depth maps, reproducibly: the same seed gives the same disturbance."""

    def __init__(self, settings: AugmentationSettings) -> None:
        super().__init__()
        self.settings = settings
        self.noise = RandomGaussianNoise(mean=0.0, std=settings.noise, p=1.0)
        self.erasing = RandomErasing(scale=settings.erased_area, value=0.0, p=settings.erasing)

    def forward(self, window: Tensor, seed: int) -> Tensor:
        """Window [B, K, H, W] with 0 = invalid → the disturbed window; invalid pixels stay invalid.

        The global random state is left as it was, so that a resumed training sees what an uninterrupted one saw.
        """
        if not (self.settings.noise or self.settings.erasing):
            return window
        devices = [window.device] if window.device.type == "cuda" else []
        with torch.random.fork_rng(devices=devices):
            torch.manual_seed(seed)
            disturbed = window
            if self.settings.noise:
                disturbed = self.noise(disturbed).clamp(0.0, 1.0) * (window > 0)
            return self.erasing(disturbed) if self.settings.erasing else disturbed
