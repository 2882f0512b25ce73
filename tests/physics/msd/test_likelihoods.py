"""The displacement error against computations by hand, and batches against single samples."""

import numpy as np
import torch

from palpate.physics.msd import DepthBatch, ObservationBatch
from palpate.physics.msd.likelihoods import displacement_error, linearise_depth


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


class View:
    """Pixels that each show one vertex."""

    def __init__(self, along: np.ndarray) -> None:
        self.along, self.vertices = along, np.zeros(len(along), np.int64)

    def seen(self, moved: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.einsum("nvc,vc->nv", moved, self.along), np.einsum("nvcd,vc->nvd", slopes, self.along)


def depths(generator: np.random.Generator) -> tuple[DepthBatch, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Two samples of four vertices at three instants, a third of it unseen, with the motion, its slopes and θ."""
    count, instants, vertices = 2, 3, 4
    weight = torch.from_numpy((generator.random((count, instants, vertices)) > 1 / 3).astype(np.float32))
    seen = DepthBatch(
        views=[View(generator.normal(size=(vertices, 3))) for _ in range(count)],
        vertices=torch.zeros(count, vertices, dtype=torch.int64),
        steps=torch.tensor([[0, 2, 5], [1, 3, 4]]),
        change=weight * torch.from_numpy(generator.normal(0, 1e-2, weight.shape).astype(np.float32)),
        weight=weight,
        noise=torch.tensor([1e-3, 4e-3]),
        common=torch.from_numpy(0.1 * generator.normal(size=(vertices, 2)).astype(np.float32)),
    )
    path = torch.from_numpy(generator.normal(0, 1e-2, (count, 6, vertices, 3)))
    slopes = torch.from_numpy(generator.normal(0, 1e-2, (count, 6, vertices, 3, 3)))
    return seen, path, slopes, torch.tensor([[0.4, 0.05, -0.1], [0.6, 0.02, -0.05]], dtype=torch.float64)


def test_depth_is_weighed_by_the_whole_covariance() -> None:
    """Independent errors of every pixel, and some that all instants share."""
    seen, path, slopes, theta = depths(np.random.default_rng(0))
    misfit, gradient, information = linearise_depth(path, slopes, theta, seen)
    for index in range(2):
        kept = seen.weight[index].flatten() > 0
        assert 4 < kept.sum() < 12
        steps, along = seen.steps[index], torch.from_numpy(seen.views[index].along)
        residual = torch.einsum("npc,pc->np", path[index, steps], along) - seen.change[index]
        jacobian = torch.einsum("npcd,pc->npd", slopes[index, steps], along) * theta[index]
        residual, jacobian = residual.flatten()[kept], jacobian.reshape(-1, 3)[kept]
        common = seen.common.double().repeat(3, 1)[kept]
        covariance = (torch.eye(len(common)) + common @ common.T) * seen.noise[index].double() ** 2
        weighed = torch.linalg.solve(covariance, torch.cat([residual[:, None], jacobian], dim=1))
        torch.testing.assert_close(misfit[index], 0.5 * residual @ weighed[:, 0], rtol=1e-6, atol=0)
        torch.testing.assert_close(gradient[index], jacobian.T @ weighed[:, 0], rtol=1e-5, atol=1e-8)
        torch.testing.assert_close(information[index], jacobian.T @ weighed[:, 1:], rtol=1e-5, atol=1e-8)


def test_pixels_that_show_nothing_known_do_not_count_and_where_none_was_seen_nothing_is_known() -> None:
    seen, path, slopes, theta = depths(np.random.default_rng(3))
    seen.views[0].along[1] = np.nan
    hidden = linearise_depth(path, slopes, theta, seen)
    seen.views[0].along[1] = 0
    seen.weight[0, :, 1] = 0
    for found, expected in zip(hidden, linearise_depth(path, slopes, theta, seen), strict=True):
        assert found.isfinite().all()
        torch.testing.assert_close(found, expected)
    seen.weight[0] = 0
    seen.change[0] = 0
    misfit, gradient, information = linearise_depth(path, slopes, theta, seen)
    assert (float(misfit[0]), gradient[0].tolist()) == (0.0, [0.0] * 3)
    assert not information[0].any()
    assert misfit[1] > 0
