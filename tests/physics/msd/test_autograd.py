"""The compiled rollout inside torch: derivatives, threads, workers, and what it refuses."""

import dataclasses
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from palpate.common.doors import interruptible
from palpate.physics import Mechanics
from palpate.physics.msd import autograd as msd_autograd
from palpate.physics.msd import rollout
from palpate.physics.msd.autograd import UnreliableGradient
from tests.physics.batches import batch_of
from tests.physics.sheets import loose, sheet

THETA = [[0.7, 0.05, -0.1], [0.2, 0.3, -0.4], [0.5, 0.5, -5.0]]


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    """Chooses torch's number of threads for a test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def test_results_do_not_depend_on_the_number_of_threads(threads):
    mesh, load = batch_of([sheet(20, 20)] * 5, [200, 210, 190, 150, 250])
    results = []
    for count in (1, 2, 3):
        threads(count)
        theta = torch.tensor([[0.7, 0.05, -0.1]] * 5, requires_grad=True)
        trajectory = rollout(theta, mesh, load, Mechanics())
        trajectory.square().sum().backward()
        results.append((trajectory.detach(), theta.grad))
    for trajectory, gradient in results[1:]:
        assert torch.equal(trajectory, results[0][0])
        torch.testing.assert_close(gradient, results[0][1], rtol=1e-6, atol=0)


class Rollouts(Dataset):
    """Two rollouts, each computed in the worker."""

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> torch.Tensor:
        torch.set_num_threads(2)  # workers start with one; a pool must work there too
        mesh, load = batch_of([sheet(8, 8)] * 2, [27, 28])
        return rollout(torch.tensor(THETA[:2]), mesh, load, Mechanics())


def test_workers_forked_from_a_process_with_threads_compute_the_same(threads):
    threads(2)
    expected = Rollouts()[0]  # the parent has its pool before it forks
    for seen in DataLoader(Rollouts(), batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=60):
        assert torch.equal(seen, expected)


def test_ctrl_c_ends_a_long_rollout(threads):
    mesh, load = batch_of([sheet(8, 8)] * 2, [27, 28])
    threads(2)
    rollout(torch.tensor(THETA[:2]), mesh, load, Mechanics())  # compiled now
    begun = time.monotonic()

    @interruptible()
    def work() -> None:
        while time.monotonic() < begun + 30:
            rollout(torch.tensor(THETA[:2]), mesh, load, Mechanics())

    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        work()
    assert time.monotonic() < begun + 10


def test_second_derivatives_are_refused_with_a_sentence():
    mesh, load = batch_of([sheet(6, 6)], [14])
    theta = torch.tensor(THETA[:1], requires_grad=True)
    (gradient,) = torch.autograd.grad(rollout(theta, mesh, load, Mechanics()).square().sum(), theta, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        gradient.sum().backward()


def test_chaotic_motion_has_no_gradient_and_says_so():
    mesh, load = batch_of([loose(sheet(21, 21))] * 2, [220, 220])
    mechanics = Mechanics()
    regular = torch.tensor([[0.7, 0.05, -0.1]] * 2, requires_grad=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rollout(regular, mesh, load, mechanics).square().sum().backward()
    theta = torch.tensor([[0.7, 0.05, -0.1], [5.34, 0.0, -1.0]], requires_grad=True)
    with pytest.warns(UnreliableGradient, match=r"k_s = 5\.34, k_d = 0, F = -1 is chaotic"):
        rollout(theta, mesh, load, mechanics).square().sum().backward()
    assert not theta.grad[1].any()
    torch.testing.assert_close(theta.grad[0], regular.grad[0])


def test_nan_parameters_are_not_hidden():
    mesh, load = batch_of([sheet(6, 6)] * 2, [14, 14])
    theta = torch.tensor([[0.7, 0.05, -0.1], [float("nan"), 0.05, -0.1]])
    for mechanics in (Mechanics(), Mechanics(window_error=1e-4)):
        seen = rollout(theta, mesh, load, mechanics)
        assert torch.isfinite(seen[0]).all()
        assert torch.isnan(seen[1, 50:]).all()


def test_what_is_elsewhere_or_names_no_vertex_is_refused():
    mesh, load = batch_of([sheet(6, 6)], [14])
    theta = torch.tensor(THETA[:1])
    with pytest.raises(ValueError, match="computes on the CPU; move theta there"):
        rollout(theta.to("meta"), mesh, load, Mechanics())
    with pytest.raises(ValueError, match="names vertex 36; the mesh has 36"):
        rollout(theta, mesh, [dataclasses.replace(load[0], vertices=np.array([36]))], Mechanics())
    with pytest.raises(ValueError, match="watch names vertex -1; the mesh has 36"):
        rollout(theta, mesh, load, Mechanics(), watch=torch.tensor([[3, -1]]))
    with pytest.raises(ValueError, match=r"watch has shape \(2,\); give \[1, M\]"):
        rollout(theta, mesh, load, Mechanics(), watch=torch.tensor([3, 4]))


def test_one_thread_needs_no_pool(threads):
    msd_autograd._pool.cache_clear()
    threads(1)
    mesh, load = batch_of([sheet(6, 6)] * 2, [14, 15])
    rollout(torch.tensor(THETA[:2]), mesh, load, Mechanics())
    assert msd_autograd._pool.cache_info().currsize == 0
