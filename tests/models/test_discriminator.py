"""PatchGAN: receptive field and shapes (Bini 2026, section 3.4.1)."""

import pytest
import torch
from torch import nn

from palpate.models.discriminator import PatchDiscriminator


def test_receptive_field_is_70_pixels():
    """Input pixels with a gradient from one patch's score; instance norm is left out, for it sees the whole picture."""
    discriminator = PatchDiscriminator(width=4)
    layers = nn.Sequential(*(layer for layer in discriminator.layers if not isinstance(layer, nn.InstanceNorm2d)))
    picture = torch.rand(1, 1, 200, 200, requires_grad=True)
    scores = layers(picture)
    scores[0, 0, scores.shape[2] // 2, scores.shape[3] // 2].backward()
    touched = picture.grad[0, 0].nonzero()
    assert (touched.amax(0) - touched.amin(0) + 1).tolist() == [70, 70]


def test_paper_size_and_score_map():
    discriminator = PatchDiscriminator()
    convolutions = [layer for layer in discriminator.layers if isinstance(layer, nn.Conv2d)]
    assert [layer.out_channels for layer in convolutions] == [64, 128, 256, 512, 1]
    assert discriminator(torch.rand(1, 1, 120, 214)).shape == (1, 1, 13, 24)


def test_small_pictures_are_refused():
    with pytest.raises(ValueError, match="depth is 31×64"):
        PatchDiscriminator(width=2)(torch.rand(1, 1, 31, 64))
