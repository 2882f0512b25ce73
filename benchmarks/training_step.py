"""Where the time of a training step goes, and what share of it is physics.

    python -m benchmarks.training_step

Runs `train.py fit` for a few steps of paper.yaml and smoke.yaml on synthetic clips and times every training step, the
rollouts forward, and their gradient. An epoch is the paper's 415 steps: 830 pairs, 2 a step (Bini 2026, section 3.1).
The first step is left out: it compiles and warms up.
"""

from __future__ import annotations

import argparse
import platform
import shutil
import statistics
import time
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from data.synthetic.__main__ import main as make_clips
from models.generator import Answer
from models.module import PhysicsInformedGAN
from train import main as train

PAPER_STEPS = 415
FOLDER = Path("runs/bench/training_step")
CONFIGURATIONS = (Path("configs/smoke.yaml"), Path("configs/paper.yaml"))
STEPS = 5


class StepTimer:
    """Times the steps of every `PhysicsInformedGAN` that trains while it is active; all times in milliseconds."""

    def __init__(self) -> None:
        self.steps: list[float] = []
        """Duration of each step, without what the measurement itself added."""
        self.forward: list[float] = []
        """Rollouts of each step, forward, both directions of time."""
        self.gradient: list[float] = []
        """Gradient of those rollouts in θ, or in the mean of log θ."""
        self._originals = PhysicsInformedGAN.training_step, PhysicsInformedGAN._physics

    def __enter__(self) -> StepTimer:
        training_step, physics = self._originals

        def timed_step(module: PhysicsInformedGAN, batch: dict, batch_index: int) -> None:
            (_, elapsed) = timed(lambda: training_step(module, batch, batch_index))
            self.steps.append(elapsed - self.gradient[-1])

        def timed_physics(module: PhysicsInformedGAN, ab: Answer, ba: Answer, batch: dict):
            loss, forward = timed(lambda: physics(module, ab, ba, batch))
            if loss.requires_grad:
                heads = [answer.theta if answer.mean is None else answer.mean for answer in (ab, ba)]
                _, gradient = timed(lambda: torch.autograd.grad(loss, heads, retain_graph=True, allow_unused=True))
                self.forward.append(forward)
                self.gradient.append(gradient)
            return loss

        PhysicsInformedGAN.training_step, PhysicsInformedGAN._physics = timed_step, timed_physics  # ty: ignore[invalid-assignment]  put back below
        return self

    def __exit__(self, *_: object) -> None:
        PhysicsInformedGAN.training_step, PhysicsInformedGAN._physics = self._originals


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Result of a call and its duration [ms], the GPU's work included."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    start = time.perf_counter()
    result = work()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return result, 1e3 * (time.perf_counter() - start)


def measure(config: Path, root: Path) -> dict[str, object]:
    """Train a few steps of a configuration and return its row of the table.

    Raises:
        RuntimeError: the training ended without the steps that were asked for.
    """
    run = FOLDER / config.stem
    shutil.rmtree(run, ignore_errors=True)
    arguments = {
        "trainer.default_root_dir": run,
        "trainer.max_epochs": 1000,
        "trainer.max_steps": 3 * (STEPS + 1),  # Lightning counts three optimisers
        "trainer.num_sanity_val_steps": 0,
        "trainer.limit_val_batches": 0,
        "trainer.enable_progress_bar": False,
        "trainer.enable_model_summary": False,
        "data.root": root,
        "data.cache": FOLDER / "cache",
        "data.loading.fractions": "[0.5, 0.25, 0.25]",
        "tracking": False,
    }
    with StepTimer() as timer:
        status = train(["fit", "-c", str(config), *(f"--{key}={value}" for key, value in arguments.items())])
    if status != 0 or len(timer.steps) < STEPS + 1:
        raise RuntimeError(f"{config}: training ended with status {status} after {len(timer.steps)} steps.")
    step, forward, gradient = (statistics.median(times[1:]) for times in (timer.steps, timer.forward, timer.gradient))
    return {
        "config": config.name,
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
        "step_ms": round(step, 1),
        "step_min_ms": round(min(timer.steps[1:]), 1),
        "step_max_ms": round(max(timer.steps[1:]), 1),
        "rollout_ms": round(forward, 1),
        "rollout_gradient_ms": round(gradient, 1),
        "physics_share": round((forward + gradient) / step, 4),
        "paper_epoch_h": round(step * PAPER_STEPS / 3.6e6, 3),
    }


def main() -> None:
    """Measure and print the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    root = FOLDER / "clips"
    make_clips(["--output", str(root), "--clips", "4", "--frames", "32", "--seed", "1"])
    rows = [measure(config, root) for config in CONFIGURATIONS]
    title = f"medians of {STEPS} steps, batch of the configuration; {platform.machine()}, {date.today()}"
    table = Table(*rows[0], title=title)
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console(width=200).print(table)


if __name__ == "__main__":
    main()
