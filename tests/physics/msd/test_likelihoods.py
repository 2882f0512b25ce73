"""The displacement error against computations by hand."""

import torch

from palpate.physics.msd import ObservationBatch
from palpate.physics.msd.likelihoods import displacement_error


def observation(steps, displacement, weight) -> ObservationBatch:
    return ObservationBatch(torch.tensor(steps), torch.tensor(displacement), torch.tensor(weight))


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
