"""Where the time of a training step goes, and what share of it is physics.

    python -m benchmarks.training_step

Runs `train.py fit` for a few steps of paper.yaml, recommended.yaml and smoke.yaml on synthetic clips, on the CPU, and
times every training step, the rollouts forward, and their gradient. An epoch is the paper's 415 steps: 830 pairs, 2 a
step (Bini 2026, section 3.1). The first step is left out: it compiles and warms up.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import torch

from palpate.benchmarks.shared import command_line, machine, print_table, timed
from palpate.command.train import main as train
from palpate.data.synthetic.__main__ import main as make_clips
from palpate.models.generator import HeadOutput
from palpate.models.module import PhysicsInformedGAN

PAPER_STEPS = 415
CONFIGURATIONS = tuple(Path("configs", f"{name}.yaml") for name in ("paper", "recommended", "smoke"))
STEPS = 5
COLUMNS = ("configuration", "a step", "of it physics", f"{PAPER_STEPS} steps (the paper's epoch)")


def measure(config: Path, folder: Path) -> list[str]:
    """Train a few steps of a configuration on the clips of `folder` and return its row of the table.

    Raises:
        RuntimeError: the training ended without the steps that were asked for.
    """
    steps, physics, gradients = [], [], []
    training_step, physics_loss = PhysicsInformedGAN.training_step, PhysicsInformedGAN._physics

    def timed_physics(module: PhysicsInformedGAN, ab: HeadOutput, ba: HeadOutput, batch: dict) -> torch.Tensor:
        loss, forward = timed(physics_loss, module, ab, ba, batch)
        heads = [answer.theta if answer.mean is None else answer.mean for answer in (ab, ba)]
        _, gradient = timed(lambda: torch.autograd.grad(loss, heads, retain_graph=True, allow_unused=True))
        physics.append(forward + gradient)
        gradients.append(gradient)
        return loss

    def timed_step(module: PhysicsInformedGAN, batch: dict, batch_index: int) -> None:
        _, elapsed = timed(training_step, module, batch, batch_index)
        steps.append(elapsed - gradients[-1])  # less what the measurement itself added

    arguments = {
        "trainer.default_root_dir": folder / config.stem,
        "trainer.accelerator": "cpu",
        "trainer.max_epochs": 1000,
        "trainer.max_steps": 3 * (STEPS + 1),  # Lightning counts three optimisers
        "trainer.num_sanity_val_steps": 0,
        "trainer.limit_val_batches": 0,
        "trainer.enable_progress_bar": False,
        "trainer.enable_model_summary": False,
        "data.root": folder / "clips",
        "data.cache": folder / "cache",
        "data.depth.source": "stored",
        "data.loading.fractions": "[0.5, 0.25, 0.25]",
        "tracking": False,
    }
    with (
        patch.object(PhysicsInformedGAN, "training_step", timed_step),
        patch.object(PhysicsInformedGAN, "_physics", timed_physics),
    ):
        status = train(["fit", "-c", str(config), *(f"--{key}={value}" for key, value in arguments.items())])
    if status != 0 or len(steps) < STEPS + 1:
        raise RuntimeError(f"{config}: training ended with status {status} after {len(steps)} steps.")
    step, share = np.median(steps[1:]), np.median(physics[1:]) / np.median(steps[1:])
    return [config.name, f"{step / 1e3:.2f} s", f"{share:.1%}", f"{step * PAPER_STEPS / 3.6e6:.2f} h"]


def main() -> None:
    """Measure and print the table."""
    command_line(__doc__).parse_args()
    with TemporaryDirectory() as folder:
        make_clips(["--output", str(Path(folder, "clips")), "--clips", "4", "--frames", "32", "--seed", "1"])
        print(f"medians of {STEPS} steps; {machine()}\n")
        print_table(COLUMNS, [measure(config, Path(folder)) for config in CONFIGURATIONS])


if __name__ == "__main__":
    run_door(main)
