"""The displacement error against computations by hand, and batches against single samples."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from physics.likelihood import Likelihood
from physics.mechanics import Mechanics
from physics.msd.batch import ObservationBatch
from physics.msd.likelihoods import displacement_error, linearise_batch
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
    mean, noise = torch.tensor([[0.5, 0.08, 0.1], [0.3, 0.1, 0.2]]).log(), torch.tensor([1e-3, 2e-3])
    found = linearise_batch(mean, noise, mesh, load, seen, Mechanics())
    for index, kept in enumerate(([0, 1, 2], [0, 2])):
        own = observations[index].chosen(np.array(kept))
        own = own.moved(own.displacement, float(noise[index]))
        press = pressed(meshes[index], vertices[index], [40, 20][index], 100)
        expected = Likelihood(meshes[index], press, own, Mechanics(), np.float32).linearise(
            mean[index].double().numpy()
        )
        np.testing.assert_allclose(found[index].residual, expected.residual, rtol=1e-5)
        np.testing.assert_allclose(
            found[index].jacobian, expected.jacobian, atol=1e-5 * np.abs(expected.jacobian).max()
        )
    seen.weight[1] = 0
    assert linearise_batch(mean, noise, mesh, load, seen, Mechanics())[1] is None
