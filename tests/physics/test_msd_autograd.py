"""The compiled rollout inside torch: derivatives, threads, workers, and what it refuses."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
import warnings
from pathlib import Path

import pytest
import torch
from batches import batch_of
from sheets import sheet
from torch.utils.data import DataLoader, Dataset

from physics import jit, msd_autograd
from physics.mechanics import Mechanics
from physics.msd import rollout, rollout_field, rollout_heterogeneous
from physics.msd_autograd import UnreliableGradient, cases
from physics.msd_compiled import contact_rollout

pytestmark = pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")

ROOT = Path(__file__).resolve().parents[2]
THETA = [[0.7, 0.05, -0.1], [0.2, 0.3, -0.4], [0.5, 0.5, -5.0]]


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
@pytest.mark.parametrize("keep", [1.0, 0.5])
def test_jacobian_equals_double_precision_autograd(scheme, keep):
    mesh, contact = batch_of([sheet(12, 12, keep=keep)] * 3, [40, 33, 20], [50, 20, 120])
    mechanics = Mechanics(scheme=scheme)
    theta = torch.tensor(THETA, dtype=torch.float64)
    columns = []
    for parameter in range(3):
        tangent = torch.zeros_like(theta)
        tangent[:, parameter] = 1
        columns.append(torch.func.jvp(lambda x: rollout(x, mesh, contact, mechanics, "torch"), (theta,), (tangent,))[1])
    expected = torch.stack(columns, dim=3)
    scale = expected.abs().amax(dim=(1, 2), keepdim=True)
    load = contact.profile(mechanics.steps)
    weights = torch.randn(3, 200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    for dtype, allowed in ((torch.float64, 1e-10), (torch.float32, 1e-4)):
        samples = cases(theta.to(dtype), mesh, contact, load, mechanics)
        seen = torch.stack([torch.from_numpy(contact_rollout(case, True)[1]) for case in samples]).double()
        assert ((seen - expected).abs() <= allowed * scale).all()
        leaf = theta.detach().clone().to(dtype).requires_grad_()
        (weights.to(dtype) * rollout(leaf, mesh, contact, mechanics, "numba")).sum().backward()
        projected = torch.einsum("btc,btcp->bp", weights, expected)
        torch.testing.assert_close(leaf.grad.double(), projected, rtol=10 * allowed, atol=10 * allowed)


def test_heterogeneous_tissue_has_the_gradients_of_autograd():
    mesh, contact = batch_of([sheet(9, 8), sheet(9, 8, keep=0.5)], [30, 5], [50, 20])
    generator = torch.Generator().manual_seed(0)
    count = len(mesh.vertices)
    stiffness = 0.5 + torch.rand(count, dtype=torch.float64, generator=generator)
    damping = 0.03 + 0.1 * torch.rand(count, dtype=torch.float64, generator=generator)
    parameters = [stiffness, damping, torch.tensor([-0.1, -0.3], dtype=torch.float64)]
    weights = torch.randn(2, 200, 3, dtype=torch.float64, generator=generator)
    results = []
    for backend in ("numba", "torch"):
        leaves = [value.clone().requires_grad_() for value in parameters]
        trajectory = rollout_heterogeneous(*leaves, mesh, contact, Mechanics(anchor=0.2), backend)
        results.append([trajectory, *torch.autograd.grad((weights * trajectory).sum(), leaves)])
    for seen, expected in zip(*results, strict=True):
        torch.testing.assert_close(seen, expected, rtol=1e-10, atol=1e-12)


def test_results_do_not_depend_on_the_number_of_threads():
    mesh, contact = batch_of([sheet(20, 20)] * 5, [200, 210, 190, 150, 250])
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            theta = torch.tensor([[0.7, 0.05, -0.1]] * 5, requires_grad=True)
            trajectory = rollout(theta, mesh, contact)
            trajectory.square().sum().backward()
            results.append((trajectory.detach(), theta.grad))
    finally:
        torch.set_num_threads(before)
    for trajectory, gradient in results[1:]:
        assert torch.equal(trajectory, results[0][0])
        torch.testing.assert_close(gradient, results[0][1], rtol=1e-6, atol=0)


class Rollouts(Dataset):
    """Two rollouts, each computed in the worker."""

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> torch.Tensor:
        torch.set_num_threads(2)  # workers start with one; a pool must work there too
        mesh, contact = batch_of([sheet(8, 8)] * 2, [27, 28])
        return rollout(torch.tensor(THETA[:2]), mesh, contact)


def test_workers_forked_from_a_process_with_threads_compute_the_same():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        expected = Rollouts()[0]  # the parent has its pool before it forks
        for seen in DataLoader(Rollouts(), batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=60):
            assert torch.equal(seen, expected)
    finally:
        torch.set_num_threads(before)


def test_ctrl_c_ends_a_long_rollout():
    code = """
        import sys; sys.path[:0] = ["tests/physics"]
        import torch
        from sheets import sheet
        from batches import batch_of
        from physics.mechanics import Mechanics
        from physics.msd import rollout
        torch.set_num_threads(2)
        mesh, contact = batch_of([sheet(8, 8)] * 2, [27, 28])
        theta = torch.tensor([[0.7, 0.05, -0.1]] * 2)
        rollout(theta, mesh, contact)
        print("ready", flush=True)
        while True:
            rollout(theta, mesh, contact)
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode != 0
    assert "KeyboardInterrupt" in errors


def test_second_derivatives_are_refused_with_a_sentence():
    mesh, contact = batch_of([sheet(6, 6)], [14])
    theta = torch.tensor(THETA[:1], requires_grad=True)
    (gradient,) = torch.autograd.grad(
        rollout(theta, mesh, contact, backend="numba").square().sum(), theta, create_graph=True
    )
    with pytest.raises(RuntimeError, match="first derivatives only; pass backend='torch'"):
        gradient.sum().backward()


def test_chaotic_motion_has_no_gradient_and_says_so():
    mesh, contact = batch_of([sheet(21, 21)] * 2, [220, 220])
    mechanics = Mechanics(boundary="free")
    regular = torch.tensor([[0.7, 0.05, -0.1]] * 2, requires_grad=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rollout(regular, mesh, contact, mechanics).square().sum().backward()
    theta = torch.tensor([[0.7, 0.05, -0.1], [5.34, 0.0, -1.0]], requires_grad=True)
    with pytest.warns(UnreliableGradient, match=r"k_s = 5\.34, k_d = 0, F = -1 is chaotic"):
        rollout(theta, mesh, contact, mechanics).square().sum().backward()
    assert not theta.grad[1].any()
    torch.testing.assert_close(theta.grad[0], regular.grad[0])


def test_whole_field_has_gradients_through_torch_only():
    mesh, contact = batch_of([sheet(6, 6)], [14])
    theta = torch.tensor(THETA[:1], requires_grad=True)
    rollout_field(theta, mesh, contact).square().sum().backward()
    assert theta.grad.abs().min() > 0
    with pytest.raises(ValueError, match="pass backend='torch' or detach"):
        rollout_field(theta, mesh, contact, backend="numba")


def test_nan_parameters_are_not_hidden():
    mesh, contact = batch_of([sheet(6, 6)] * 2, [14, 14])
    theta = torch.tensor([[0.7, 0.05, -0.1], [float("nan"), 0.05, -0.1]])
    for mechanics in (Mechanics(), Mechanics(window_error=1e-4)):
        seen = rollout(theta, mesh, contact, mechanics)
        assert torch.isfinite(seen[0]).all()
        assert torch.isnan(seen[1, 50:]).all()


def test_backends_that_cannot_do_it_say_so(monkeypatch):
    mesh, contact = batch_of([sheet(6, 6)], [14])
    theta = torch.tensor(THETA[:1])
    with pytest.raises(ValueError, match="choose auto, numba or torch"):
        rollout(theta, mesh, contact, backend="jax")
    with pytest.raises(ValueError, match="computes on the CPU"):
        rollout(theta.to("meta"), mesh, contact, backend="numba")
    contact.vertex = torch.tensor([36])
    with pytest.raises(ValueError, match="vertex is 36; the mesh has 36"):
        rollout(theta, mesh, contact, backend="numba")
    monkeypatch.setattr(jit, "COMPILED", False)
    with pytest.raises(ValueError, match="isn't installed"):
        rollout(theta, mesh, contact, backend="numba")


def test_one_thread_needs_no_pool():
    msd_autograd._pool.cache_clear()
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        mesh, contact = batch_of([sheet(6, 6)] * 2, [14, 15])
        rollout(torch.tensor(THETA[:2]), mesh, contact)
    finally:
        torch.set_num_threads(before)
    assert msd_autograd._pool.cache_info().currsize == 0
