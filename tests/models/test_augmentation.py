"""Disturbed windows: reproducible, only where there is a measurement, off by default."""

import pytest
import torch

from palpate.models.module import AugmentationSettings, WindowAugmentation


def test_off_by_default():
    window = torch.rand(2, 3, 24, 32)
    assert WindowAugmentation(AugmentationSettings())(window, seed=1) is window


def test_same_seed_same_disturbance_and_the_global_random_state_is_left_alone():
    augmentation = WindowAugmentation(AugmentationSettings(noise=0.01))
    window = torch.rand(4, 2, 24, 32)
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first, again, other = augmentation(window, 1), augmentation(window, 1), augmentation(window, 2)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_noise_has_the_given_spread_and_keeps_holes():
    window = torch.full((1, 1, 100, 100), 0.5)
    window[..., :10] = 0.0
    disturbed = WindowAugmentation(AugmentationSettings(noise=0.02))(window, seed=3)
    assert (disturbed[..., :10] == 0).all()
    assert (disturbed[..., 10:] - 0.5).std().item() == pytest.approx(0.02, rel=0.05)


def test_an_impossible_noise_is_refused():
    with pytest.raises(ValueError, match=r"augmentation\.noise is -1\.0"):
        AugmentationSettings(noise=-1.0)
