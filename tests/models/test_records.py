"""Records of the test pairs: errors, baselines and sensitivity by hand."""

import numpy as np
import pytest
import torch

from palpate.models.generator import Generator
from palpate.models.records import farthest_corner, pair_records, with_reference_tissue
from palpate.physics.mechanics import Bounds, Mechanics
from palpate.physics.msd import rollout

MECHANICS = Mechanics(steps=24, load_steps=8)
BOUNDS = Bounds(force=(-0.3, 0.0), initial=(0.5, 0.1, -0.05))


def test_reference_keeps_the_force_and_the_farthest_corner_is_that_of_the_box():
    theta = torch.tensor([[0.5, 0.1, -3.0]])
    assert with_reference_tissue(theta).tolist() == [[pytest.approx(5.34), pytest.approx(0.127), -3.0]]
    theta = torch.tensor([[0.4, 0.9, -1.0]])
    corner = farthest_corner(theta, torch.tensor([0.0, 0.0, -10.0]), torch.tensor([1.0, 1.0, 0.0]))
    assert corner.tolist() == [[1.0, 0.0, -10.0]]


def test_records_hold_what_their_names_say(make_batch):
    torch.manual_seed(0)
    batch = make_batch()
    batch.a.observation.weight = torch.tensor([[1.0], [1.0]])
    generator = Generator(width=4, residual_blocks=1, bounds=BOUNDS)
    first, second = pair_records(batch, generator, MECHANICS)
    assert (first["clip"], first["frame"], second["clip"], second["frame"]) == ("one", 3, "two", 7)
    assert first["theta"].shape == (3,)
    assert first["trajectory"].shape == first["reference_trajectory"].shape == (24, 3)
    assert first["load"].factor.tolist() == [1] * 8 + [0] * 16
    seen = first["observation"]
    np.testing.assert_allclose(seen.displacement, [[[0, 0, 0.02]]])
    for name, trajectory in (("error_predicted", "trajectory"), ("error_reference", "reference_trajectory")):
        distance = first[trajectory][seen.steps(MECHANICS.time_step)] - seen.displacement[0]
        assert first[name] == pytest.approx(float((distance**2).sum()), rel=1e-4)
    now, later = batch.a.window[0, -1], batch.b.window[0, -1]
    valid = (now > 0) & (later > 0)
    assert first["copy_error"] == pytest.approx((now - later).abs()[valid].mean().item(), rel=1e-4)
    predicted = generator.generate(batch.a.window, torch.from_numpy(np.stack([first["theta"], second["theta"]])))
    assert first["next_depth_error"] == pytest.approx((predicted[0, 0] - later).abs()[valid].mean().item(), rel=1e-3)
    theta = torch.from_numpy(np.stack([first["theta"], second["theta"]]))
    corner = farthest_corner(theta, generator.head.lower, generator.head.upper)
    moved = (generator.generate(batch.a.window, corner) - predicted)[0, 0].abs()
    assert first["theta_sensitivity"] == pytest.approx(moved[predicted[0, 0] > 0].mean().item(), rel=1e-3)
    assert first["theta_sensitivity"] > 0


def test_a_record_simulates_to_its_trajectory(make_batch):
    _, record = pair_records(make_batch(), Generator(width=4, residual_blocks=1, bounds=BOUNDS), MECHANICS)
    trajectory = rollout(torch.from_numpy(record["theta"])[None], [record["mesh"]], [record["load"]], MECHANICS)
    np.testing.assert_allclose(trajectory[0].numpy(), record["trajectory"], atol=1e-6)


def test_padding_is_left_out_of_the_record(make_batch):
    batch = make_batch()
    observation = batch.a.observation
    observation.steps = torch.tensor([[7, 0], [3, 7]])
    observation.displacement = torch.full((2, 2, 3), 0.01)
    observation.weight = torch.tensor([[1.0, 0.0], [1.0, 1.0]])
    first, second = pair_records(batch, Generator(width=4, residual_blocks=1, bounds=BOUNDS), MECHANICS)
    assert first["observation"].steps(MECHANICS.time_step).tolist() == [7]
    assert second["observation"].steps(MECHANICS.time_step).tolist() == [3, 7]
