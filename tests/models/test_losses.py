"""Each loss term against a computation by hand (Bini 2026, section 3.4.2)."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from palpate.models import losses
from palpate.physics.mechanics import Bounds, Mechanics
from palpate.physics.msd import rollout

MECHANICS = Mechanics(steps=24, load_steps=8)


def picture(*values: float) -> torch.Tensor:
    return torch.tensor(values).reshape(1, 1, 1, -1)


def test_adversarial_terms():
    assert losses.generator_adversarial_loss(torch.tensor([1.0, 0.5, -1.0])).item() == pytest.approx((0 + 0.25 + 4) / 3)
    value = losses.discriminator_loss(torch.tensor([1.0, 0.0]), torch.tensor([0.5, -0.5, 0.0, 1.0]))
    assert value.item() == pytest.approx((0 + 1) / 2 + (0.25 + 0.25 + 0 + 1) / 4)


def test_masked_l1_leaves_out_pixels_without_a_measurement():
    assert losses.masked_l1(picture(0.5, 0.9, 0.1), picture(0.25, 0.0, 0.2)).item() == pytest.approx((0.25 + 0.1) / 2)
    assert losses.masked_l1(picture(0.5, 0.9), picture(0.0, 0.0)).item() == 0
    prediction = picture(0.5, 0.9).requires_grad_()
    losses.masked_l1(prediction, picture(0.25, 0.0)).backward()
    assert prediction.grad.flatten().tolist() == [1.0, 0.0]


def test_cycle_is_half_of_both_directions_and_identity_has_null_parameters():
    value = losses.cycle_loss(picture(0.5, 0.5), picture(0.4, 0.6), picture(0.3), picture(0.7))
    assert value.item() == pytest.approx(0.5 * (0.1 + 0.4))
    assert losses.identity_loss(picture(0.5, 0.2), picture(0.4, 0.4)).item() == pytest.approx(0.15)
    theta = torch.tensor([[0.4, 0.2, -3.0]], requires_grad=True)
    null = losses.null_parameters(theta)
    assert null.tolist() == [[pytest.approx(0.4), pytest.approx(0.2), 0.0]]
    assert not null.requires_grad


def test_physics_is_the_squared_distance_at_the_observed_step(make_batch):
    batch = make_batch()
    theta = torch.tensor([[0.5, 0.05, -0.02], [0.3, 0.1, -0.05]])
    trajectory = rollout(theta, batch.a.meshes, batch.a.loads, MECHANICS)
    expected = sum(float(((trajectory[i, 7] - torch.tensor([0, 0, 0.02])) ** 2).sum()) for i in range(2)) / 2
    value = losses.physics_loss(theta, batch.a.meshes, batch.a.loads, batch.a.observation, MECHANICS)
    assert value.item() == pytest.approx(expected, rel=1e-5)
    assert expected > 0


def test_regularisation_is_a_squared_hinge():
    theta = torch.tensor([[1.5, -0.2, -12.0], [0.5, 0.5, 1.0]])
    assert losses.regularisation_loss(theta, Bounds()).item() == pytest.approx(((0.25 + 0.04 + 4) + 1) / 2)


@given(place=st.lists(st.floats(0, 1, width=32), min_size=3, max_size=3))
def test_regularisation_is_exactly_zero_inside_the_box(place: list[float]):
    bounds = Bounds(stiffness=(0.05, 0.9), damping=(0.0, 0.3), force=(-0.3, 0.0), initial=(0.5, 0.1, -0.1))
    lower, upper = torch.tensor(bounds.lower), torch.tensor(bounds.upper)
    theta = torch.clamp(lower + (upper - lower) * torch.tensor(place), lower, upper)[None]
    assert losses.regularisation_loss(theta, bounds).item() == 0


def test_total_uses_the_paper_s_weights():
    weights = losses.LossWeights()
    for values, expected in (
        ([1.0] * 5, 1 + 10 + 1 + 2 + 0.1),
        ([0.1, 0.2, 0.3, 0.4, 0.5], 0.1 + 2 + 0.3 + 0.8 + 0.05),
    ):
        terms = dict(zip(vars(weights), torch.tensor(values), strict=True))
        assert losses.total(terms, weights).item() == pytest.approx(expected)


def test_impossible_weights_are_refused():
    with pytest.raises(ValueError, match=r"weights\.physics is -1"):
        losses.LossWeights(physics=-1)
    with pytest.raises(ValueError, match="weights are all 0"):
        losses.LossWeights(gan=0, cycle=0, identity=0, physics=0, regularisation=0)
