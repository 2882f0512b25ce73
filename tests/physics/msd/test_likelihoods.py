"""The displacement error against computations by hand, and batches against single samples."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from physics.likelihood import Likelihood
from physics.mechanics import Mechanics
from physics.msd import rollout_sensitivities
from physics.msd.batch import ObservationBatch
from physics.msd.likelihoods import displacement_error, linearise
from physics.observation import Observation
from tests.physics.batches import batch_of
from tests.physics.sheets import pressed, sheet


def observation(steps, displacement, weight) -> ObservationBatch:
    return ObservationBatch(torch.tensor(steps), torch.tensor(displacement), torch.tensor(weight))


def test_final_observation_is_the_squared_norm_of_the_difference():
    trajectory = torch.zeros(1, 5, 3)
    trajectory[0, 4] = torch.tensor([1.0, 2.0, 3.0])
    seen = observation([[4]], [[[0.0, 0.0, 1.0]]], [[1.0]])
    torch.testing.assert_close(displacement_error(trajectory, seen), torch.tensor([1.0 + 4.0 + 4.0]))


def test_weights_average_and_padding_counts_nothing():
    trajectory = torch.arange(12.0).reshape(1, 4, 3).requires_grad_()
    nan = float("nan")
    seen = observation([[0, 2, 3]], [[[0.0, 1.0, 0.0], [6.0, 7.0, 6.0], [nan, nan, nan]]], [[1.0, 3.0, 0.0]])
    error = displacement_error(trajectory, seen)
    torch.testing.assert_close(error, torch.tensor([(1 * 4.0 + 3 * 4.0) / 4]))  # both differ by 2 along z
    error.sum().backward()
    expected = torch.zeros(1, 4, 3)
    expected[0, 0, 2], expected[0, 2, 2] = 2 * 2 / 4, 3 * 2 * 2 / 4
    torch.testing.assert_close(trajectory.grad, expected)


def test_a_sample_without_observation_has_no_error():
    trajectory = torch.ones(2, 3, 3, requires_grad=True)
    seen = observation([[0], [0]], [[[0.0, 0.0, 0.0]]] * 2, [[0.0], [1.0]])
    error = displacement_error(trajectory, seen)
    torch.testing.assert_close(error, torch.tensor([0.0, 3.0]))
    error.sum().backward()
    assert trajectory.grad[0].abs().sum() == 0


def test_shapes_are_named():
    seen = observation([[0]], [[[0.0, 0.0]]], [[1.0]])
    with pytest.raises(ValueError, match=r"displacement has shape \(1, 1, 2\); give \(1, 1, 3\)"):
        displacement_error(torch.zeros(1, 2, 3), seen)


def test_a_batch_is_linearised_as_each_sample_is():
    meshes, vertices = [sheet(8, 9), sheet(8, 9, keep=0.5)], [30, 12]
    mesh, load = batch_of(meshes, vertices, [40, 20], 100)
    observations = [
        Observation.of_point(at, np.array([0.1, 0.2, 0.4]), np.full((3, 3), 1e-3 * at), np.nan) for at in vertices
    ]
    seen = ObservationBatch.of(observations, 0.005)
    seen.weight[1, 1], seen.displacement[1, 1] = 0, float("nan")
    theta, noise = torch.tensor([[0.5, 0.08, -0.1], [0.3, 0.1, -0.2]]), torch.tensor([1e-3, 2e-3])
    path, slopes = rollout_sensitivities(theta, mesh, load)
    found = linearise(path, slopes, theta, seen, noise)
    for index, kept in enumerate(([0, 1, 2], [0, 2])):
        own = observations[index].chosen(np.array(kept))
        own = own.moved(own.displacement, float(noise[index]))
        press = pressed(meshes[index], vertices[index], [40, 20][index], 100)
        logs = theta[index].abs().log().double().numpy()
        expected = Likelihood(meshes[index], press, own, Mechanics(), np.float32).linearise(logs)
        for value, other in zip(found, (expected.misfit, expected.gradient, expected.information), strict=True):
            np.testing.assert_allclose(value[index], other, atol=1e-5 * np.abs(other).max())
    seen.weight[1] = 0
    assert not any(value[1].any() for value in linearise(path, slopes, theta, seen, noise))
