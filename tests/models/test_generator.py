"""The generator against the paper's shapes and ranges (Bini 2026, section 3.4.1)."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.models.discriminator import PatchDiscriminator
from palpate.models.generator import Generator
from palpate.physics.mechanics import Bounds

SMALL = {"width": 4, "residual_blocks": 1}


def test_paper_configuration_has_the_paper_s_shapes_and_size():
    generator, discriminator = Generator(), PatchDiscriminator()
    parameters = sum(p.numel() for module in (generator, discriminator) for p in module.parameters())
    assert parameters == 15_170_757
    assert abs(parameters / 15.2e6 - 1) < 0.02
    with torch.inference_mode():
        depth = torch.rand(1, 1, 120, 214)
        features = generator.encode(depth)
        assert features.shape == (1, 256, 30, 53)
        assert generator.generate(depth, generator.estimate(depth)).shape == (1, 1, 120, 214)


@settings(deadline=None, max_examples=15)
@given(height=st.integers(16, 61), width=st.integers(16, 61), channels=st.integers(1, 3))
def test_decoder_gives_exactly_the_input_s_size(height: int, width: int, channels: int):
    generator = Generator(channels, **SMALL)
    with torch.inference_mode():
        depth = torch.rand(2, channels, height, width)
        predicted = generator.generate(depth, generator.estimate(depth))
    assert predicted.shape == (2, 1, height, width)
    assert predicted.min() >= 0
    assert predicted.max() <= 1


@settings(deadline=None, max_examples=50)
@given(raw=st.lists(st.floats(-1e4, 1e4, width=32), min_size=3, max_size=3))
def test_theta_never_leaves_the_box(raw: list[float]):
    bounds = Bounds(stiffness=(0.05, 0.9), damping=(0.001, 0.3), force=(-0.3, 0.1), initial=(0.5, 0.1, -0.1))
    generator = Generator(**SMALL, bounds=bounds)
    with torch.no_grad():
        generator.head.layers[-1].bias.copy_(torch.tensor(raw))
        theta = generator.estimate(torch.rand(2, 1, 16, 16))
    assert (theta >= torch.tensor(bounds.lower)).all()
    assert (theta <= torch.tensor(bounds.upper)).all()


def test_untrained_head_starts_at_the_configured_theta_and_still_looks_at_its_input():
    bounds = Bounds(force=(-0.3, 0.0), initial=(0.3, 0.1, -0.05))
    torch.manual_seed(0)
    generator = Generator(**SMALL, bounds=bounds)
    depth = torch.rand(8, 1, 24, 32) * torch.linspace(0.1, 1, 8)[:, None, None, None]
    theta = generator.estimate(depth)
    box = torch.tensor(bounds.upper) - torch.tensor(bounds.lower)
    assert ((theta - torch.tensor(bounds.initial)).abs() < 0.03 * box).all()
    assert (theta.std(dim=0) > 0).all()


def test_theta_reaches_the_picture():
    """A tiled constant is exactly what instance norm subtracts; θ must come through all the same."""
    torch.manual_seed(0)
    generator = Generator(width=8, residual_blocks=2)
    depth = torch.rand(1, 1, 32, 40)
    with torch.inference_mode():
        soft = generator.generate(depth, torch.tensor([[0.1, 0.1, -9.0]]))
        stiff = generator.generate(depth, torch.tensor([[0.9, 0.9, -1.0]]))
    assert (soft - stiff).abs().mean() > 1e-3


def test_a_decoder_of_physics_starts_as_the_carried_map_and_leaves_theta_to_the_rollout():
    torch.manual_seed(0)
    generator = Generator(width=4, residual_blocks=1, decoder="physics")
    depth, carried = 0.2 + 0.6 * torch.rand(2, 2, 1, 32, 40)
    theta = torch.tensor([[0.5, 0.1, -1.0], [0.9, 0.01, -5.0]])
    assert torch.allclose(generator.generate(depth, theta, carried), carried, atol=1e-6)
    with torch.no_grad():
        generator.decoder.output.weight.normal_()
    grown = generator.generate(depth, theta, carried)
    assert (grown - carried).abs().max() > 0.01
    assert torch.equal(grown, generator.generate(depth, theta.flip(0), carried))


def test_the_decoder_is_conditioned_on_theta_s_place_in_the_box():
    bounds = Bounds(stiffness=(0.2, 0.6), force=(-0.3, 0.1), initial=(0.4, 0.1, -0.1))
    generator, seen = Generator(**SMALL, bounds=bounds), []
    generator.decoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    generator.generate(torch.rand(1, 1, 16, 16), torch.tensor([[0.3, 0.5, -0.2]]))
    torch.testing.assert_close(seen[0], torch.tensor([[0.25, 0.5, 0.25]]))


def test_holes_of_the_current_frame_stay_holes():
    generator = Generator(2, **SMALL)
    depth = torch.rand(1, 2, 20, 24) + 0.1
    depth[:, 1, 3:6, 4:9] = 0.0
    depth[:, 0, 10:12] = 0.0
    predicted = generator.generate(depth, generator.estimate(depth))
    assert (predicted[0, 0, 3:6, 4:9] == 0).all()
    assert (predicted[0, 0, 10:12] > 0).all()


def test_what_cannot_be_is_refused_with_a_sentence():
    with pytest.raises(ValueError, match="16 pixels a side"):
        Generator(**SMALL).encode(torch.rand(1, 1, 8, 32))
