"""The head that says how sure it is: its box, where it starts, what the decoder is given of it."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.models.generator import ContactHead, Generator
from palpate.physics.mechanics import Bounds

BOUNDS = Bounds(stiffness=(0.05, 1.0), damping=(0.005, 0.5), force=(-0.3, -0.01), initial=(0.4, 0.08, -0.1))
SMALL = {"width": 4, "residual_blocks": 1, "bounds": BOUNDS, "head": "posterior", "contact_features": 6}


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        (Bounds(), r"bounds\.stiffness starts at 0\.0"),
        (Bounds(stiffness=(0.05, 1.0), damping=(0.0, 1.0)), r"bounds\.damping starts at 0\.0"),
        (Bounds(stiffness=(0.05, 1.0), damping=(0.01, 1.0)), r"bounds\.force ends at 0\.0.*such as -0\.01"),
    ],
)
def test_a_box_without_logarithms_is_refused(bounds: Bounds, message: str):
    with pytest.raises(ValueError, match=message):
        ContactHead(16, bounds, 6)


def test_without_the_contact_s_vector_a_sentence_says_what_to_set():
    with pytest.raises(ValueError, match=r"data\.samples\.observation to trajectory and data\.geometry\.smoothing"):
        Generator(**SMALL | {"contact_features": 0})


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10_000), size=st.sampled_from([1e-2, 1.0, 1e2, 1e6]))
def test_theta_never_leaves_the_box_and_the_covariance_is_one(seed: int, size: float):
    torch.manual_seed(seed)
    generator = Generator(**SMALL)
    with torch.no_grad():
        generator.head.posterior.exit[-1].weight.mul_(100)
        features = generator.encode(torch.rand(4, 1, 20, 24))
        theta, _, factor = generator.answer(features, size * torch.randn(4, 6))
    assert (theta >= torch.tensor(BOUNDS.lower)).all()
    assert (theta <= torch.tensor(BOUNDS.upper)).all()
    assert torch.equal(factor, factor.tril())
    assert (factor.diagonal(dim1=1, dim2=2) > 0).all()


def test_theta_is_that_of_the_mean_and_starts_near_the_configured_one():
    torch.manual_seed(0)
    generator = Generator(**SMALL)
    theta, mean, _ = generator.answer(generator.encode(torch.rand(8, 1, 16, 16)), torch.randn(8, 6))
    torch.testing.assert_close(theta, mean.exp() * torch.tensor([1.0, 1.0, -1.0]))
    places = generator.head.scaled(theta) - generator.head.scaled(torch.tensor([BOUNDS.initial]))
    assert places.abs().max() < 0.1
    assert (theta.std(dim=0) > 0).all()


def test_the_decoder_is_told_the_place_in_the_box_of_logarithms():
    generator, seen = Generator(**SMALL), []
    generator.decoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    middle = torch.from_numpy(BOUNDS.log_box).mean(dim=0).exp().float() * torch.tensor([1.0, 1.0, -1.0])
    for theta in (middle, torch.tensor(BOUNDS.lower), torch.tensor([0.05, 0.005, 0.0])):
        generator.generate(torch.rand(1, 1, 16, 16), theta[None])
    torch.testing.assert_close(torch.cat(seen), torch.tensor([[0.5, 0.5, 0.5], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))


def test_picture_changes_the_answer_only_once_its_projection_has_learnt():
    """Different pictures reach the projection as different vectors, so that it can learn from them."""
    torch.manual_seed(0)
    generator, contact = Generator(**SMALL), torch.randn(1, 6)
    depths = torch.rand(2, 1, 1, 24, 24) * torch.tensor([0.3, 1.0])[:, None, None, None, None]
    first, second = (generator.answer(generator.encode(depth), contact).mean for depth in depths)
    assert torch.equal(first, second)
    first.sum().backward()
    assert generator.head.posterior.picture.weight.grad.abs().sum() > 0
    with torch.no_grad():
        generator.head.posterior.picture.weight.normal_()
    first, second = (generator.answer(generator.encode(depth), contact).mean for depth in depths)
    assert (first - second).abs().max() > 1e-3
