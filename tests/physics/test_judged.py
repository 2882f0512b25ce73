"""What was asked of the rollout as a whole: memory, several processes, bounds."""

import ctypes
import gc
import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import nearest_vertex
from palpate.physics.msd.rollouts import rollout
from tests.physics.batches import batch_of
from tests.physics.sheets import sheet

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Two of torch's threads, and then as few as before: two processes with two each on two cores wait in loops."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="memory is read from Linux' /proc")
@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("window_error", [0.0, 1e-4])
def test_forward_and_gradient_of_two_meshes_take_under_40_mb(window_error: float):
    meshes = [sheet(110, 130, spacing=0.0027)] * 2
    mesh, load = batch_of(meshes, [nearest_vertex(each, each.vertices.mean(axis=0)) for each in meshes])
    assert min(len(each.vertices) for each in meshes) > 14_000

    def turn() -> None:
        theta = torch.tensor([[0.5, 0.09, -0.1], [0.55, 0.1, -0.11]], requires_grad=True)
        rollout(theta, mesh, load, Mechanics(window_error=window_error)).sum().backward()

    def resident(key: str) -> float:
        line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
        return int(line.split()[1]) / 1024

    turn()
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # forgets the highest mark
    before = resident("VmRSS")
    turn()
    assert resident("VmHWM") - before < 40


def test_distributed_training_has_the_gradient_of_one_process(tmp_path):
    code = textwrap.dedent(f"""
        import os, sys; sys.path.insert(0, {str(ROOT)!r})
        import torch
        import torch.distributed as distributed
        from torch.nn.parallel import DistributedDataParallel
        from tests.physics.batches import batch_of
        from tests.physics.sheets import sheet
        from palpate.physics.mechanics import Mechanics
        from palpate.physics.msd.rollouts import rollout

        child = os.fork()  # imports take longer than all the rest
        rank = int(child == 0)
        store = "file://" + sys.argv[1]
        distributed.init_process_group("gloo", init_method=store, rank=rank, world_size=2)
        torch.set_num_threads(1)
        head = torch.nn.Linear(1, 3, bias=False)
        with torch.no_grad():
            head.weight.copy_(torch.tensor([[0.7], [0.05], [-0.1]]))
        mesh, load = batch_of([sheet(9, 8)] * 2, [[30, 31], [20, 37]][rank])
        everywhere = DistributedDataParallel(head)
        theta = everywhere(torch.ones(2, 1))
        (1e3 * rollout(theta, mesh, load, Mechanics()).square().mean()).backward()
        os.write(1, (str(head.weight.grad.ravel().tolist()) + "\\n").encode())  # at once: both write there
        distributed.barrier()
        status = os.waitpid(child, 0)[1] if child else 0
        os._exit(status > 0)  # gloo's threads may abort an interpreter that ends as usual
    """)
    command, pipes = [sys.executable, "-c", code], {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    done = subprocess.run([*command, str(tmp_path / "store")], timeout=240, check=False, **pipes)
    assert done.returncode == 0, done.stderr
    gradients = [torch.tensor(eval(line)) for line in done.stdout.splitlines()]
    assert len(gradients) == 2

    theta = torch.tensor([[0.7, 0.05, -0.1]], requires_grad=True)
    mesh, load = batch_of([sheet(9, 8)] * 4, [30, 31, 20, 37])
    (1e3 * rollout(theta.expand(4, 3), mesh, load, Mechanics()).square().mean()).backward()
    for gradient in gradients:
        torch.testing.assert_close(gradient, theta.grad[0], rtol=1e-4, atol=1e-7)


@pytest.mark.acceptance
def test_no_index_leaves_its_array(tmp_path):
    # numba's own check, which raises where an index lies outside, over all meshes and random masks.
    chosen = ["tests/physics/msd/test_simulation.py", "-k", "any_mask or (compiled_equals_plain and default)"]
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-p", "no:cacheprovider", *chosen]
    checked = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    result = subprocess.run(command, cwd=ROOT, env=checked, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stdout
    assert "passed" in result.stdout
