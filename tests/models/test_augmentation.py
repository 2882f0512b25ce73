"""Disturbed windows: reproducible, only where there is a measurement, off by default."""

import pytest
import torch

from palpate.models.module import PhysicsInformedGAN


def module(noise: float = 0.0) -> PhysicsInformedGAN:
    return PhysicsInformedGAN(width=2, residual_blocks=0, noise=noise)


def test_off_by_default():
    window = torch.rand(2, 3, 24, 32)
    assert module()._augmented(window, 1) is window


def test_same_seed_same_disturbance_and_the_global_random_state_is_left_alone():
    disturbing, window = module(noise=0.01), torch.rand(4, 2, 24, 32)
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first, again, other = (disturbing._augmented(window, direction) for direction in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_noise_has_the_given_spread_and_keeps_holes():
    window = torch.full((1, 1, 100, 100), 0.5)
    window[..., :10] = 0.0
    disturbed = module(noise=0.02)._augmented(window, 1)
    assert (disturbed[..., :10] == 0).all()
    assert (disturbed[..., 10:] - 0.5).std().item() == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("noise", [-1.0, float("nan"), float("inf")])
def test_an_impossible_noise_is_refused(noise: float):
    with pytest.raises(ValueError, match=f"noise is {noise}; give 0 or more"):
        module(noise)
