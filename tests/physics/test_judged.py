"""What was asked of the rollout as a whole: memory, several processes, bounds."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import torch

from palpate.benchmarks.rollout import make_task, memory_above, take_turn
from palpate.physics.msd.rollouts import rollout
from tests.physics.batches import batch_of
from tests.physics.sheets import sheet

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="memory is read from Linux' /proc")
@pytest.mark.parametrize("name", ["numba exact", "numba window"])
def test_forward_and_gradient_of_two_meshes_take_under_40_mb(name):
    task = make_task(2, 1)
    assert min(len(mesh.vertices) for mesh in task.meshes) > 14_000
    take_turn(name, 2, task)
    assert memory_above(take_turn, name, 2, task) < 40


def test_distributed_training_has_the_gradient_of_one_process(tmp_path):
    code = textwrap.dedent(f"""
        import os, sys; sys.path.insert(0, {str(ROOT)!r})
        import torch
        import torch.distributed as distributed
        from torch.nn.parallel import DistributedDataParallel
        from tests.physics.batches import batch_of
        from tests.physics.sheets import sheet
        from palpate.physics.msd.rollouts import rollout

        rank = int(sys.argv[1])
        store = "file://" + sys.argv[2]
        distributed.init_process_group("gloo", init_method=store, rank=rank, world_size=2)
        torch.set_num_threads(2)
        head = torch.nn.Linear(1, 3, bias=False)
        with torch.no_grad():
            head.weight.copy_(torch.tensor([[0.7], [0.05], [-0.1]]))
        mesh, load = batch_of([sheet(9, 8)] * 2, [[30, 31], [20, 37]][rank])
        everywhere = DistributedDataParallel(head)
        theta = everywhere(torch.ones(2, 1))
        (1e3 * rollout(theta, mesh, load).square().mean()).backward()
        print(head.weight.grad.ravel().tolist(), flush=True)
        distributed.barrier()
        os._exit(0)  # gloo's threads may abort an interpreter that ends as usual
    """)
    command, pipes = [sys.executable, "-c", code], {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen([*command, str(rank), str(tmp_path / "store")], **pipes) for rank in range(2)]
    gradients = []
    for process in processes:
        output, errors = process.communicate(timeout=240)
        assert process.returncode == 0, errors
        gradients.append(torch.tensor(eval(output.splitlines()[-1])))

    theta = torch.tensor([[0.7, 0.05, -0.1]], requires_grad=True)
    mesh, load = batch_of([sheet(9, 8)] * 4, [30, 31, 20, 37])
    (1e3 * rollout(theta.expand(4, 3), mesh, load).square().mean()).backward()
    for gradient in gradients:
        torch.testing.assert_close(gradient, theta.grad[0], rtol=1e-4, atol=1e-7)


def test_no_index_leaves_its_array(tmp_path):
    # numba's own check, which raises where an index lies outside, over all meshes and random masks.
    chosen = ["tests/physics/msd/test_simulation.py", "-k", "any_mask or (compiled_equals_plain and default)"]
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-p", "no:cacheprovider", *chosen]
    checked = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    result = subprocess.run(command, cwd=ROOT, env=checked, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stdout
    assert "passed" in result.stdout
