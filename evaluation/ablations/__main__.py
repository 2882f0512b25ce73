"""What every choice is worth: one row each with one thing changed, all rows of a family with the same compute.

    python -m evaluation.ablations --output runs/ablations --weights runs/contact/posterior.pt [--rows K=4 no-gan …]

Two families. Observation: the contact posterior alone, trained on K frames after the onset, or on one; beside it a
twin that is told the true θ, which no real clip has. Training: the generators of configs/recommended.yaml at a small
width, each loss term off, and configs/paper.yaml beside them.
Contacts, clips and finished rows are kept in DIR, and the same command continues; a row that fails is reported and the
others go on. Writes ablations.csv, ablations.md and ablations.png.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from data.command_line import path_option, progress_bars, say, whole_number
from estimators.network.training import LEAST_STEPS, TrainingError
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.ablations import observation as ablation_observation
from evaluation.ablations import training as ablation_training
from evaluation.ablations.output import FAILED, Result, keep, kept, write_all
from evaluation.ablations.rows import OBSERVATION, ROWS, TRAINING, Row
from evaluation.ablations.training import EPOCH, SPLIT, RowFailed, TrainingSettings
from evaluation.recovery.constant import kept_truths
from evaluation.recovery.suites import FITTED_ON
from models.checkpoint import CheckpointError
from results.record import sha256_of
from results.store import OutputError

CONSTANT_CLIPS = 30
"""Truths of another split whose mean is the constant of the trainings."""


@dataclass(frozen=True)
class Task:
    """One row and all that it needs; goes to another process."""

    row: Row
    folder: Path
    weights: Path
    settings: dict[str, Any]
    constant: tuple[float, ...]
    """Mean log θ that trainings are compared with; empty for observations."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.ablations",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="rows:\n"
        + "\n".join(f"  {row.name:20s}{row.what}" for row in ROWS.values())
        + "\n\nExit status: 0 done; 1 some rows failed; 2 wrong usage; 130 interrupted.",
    )
    add = parser.add_argument
    add("--output", type=path_option, required=True, metavar="DIR", help="folder of the results")
    add(
        "--weights", type=path_option, required=True, metavar="FILE", help="posterior.pt of estimators.network.training"
    )
    add("--rows", nargs="+", action="extend", choices=list(ROWS), metavar="ROW", help="rows (default: all)")
    numbers = (
        ("workers", 2, 0, "rows at a time, of one thread each; 0 = in this process"),
        ("seed", 0, 0, "another seed gives other contacts and clips"),
        ("contacts", 4000, 1, "simulated contacts that observations are trained on"),
        ("held-out", 600, 1, "simulated contacts that they are judged on"),
        ("observation-steps", 3000, LEAST_STEPS, "steps of an observation's row"),
        ("training-clips", 16, 4, "synthetic clips that trainings read"),
        ("training-steps", 400, EPOCH, f"steps of a training's row, a multiple of {EPOCH}"),
        ("width", 8, 1, "channels of the generators' first layer"),
        ("residual-blocks", 2, 0, "residual blocks of their decoders"),
        ("validation-clips", 40, 1, "clips that trainings are judged on"),
    )
    for name, default, least, text in numbers:
        kind = whole_number(least)
        add(f"--{name}", type=kind, default=default, metavar="N", help=f"{text} (default %(default)s)")
    return parser


def settings_of(row: Row, options: argparse.Namespace, weights_sha256: str) -> dict[str, Any]:
    """What decides a row's numbers."""
    common = {"seed": options.seed, "weights_sha256": weights_sha256}
    if row.family == OBSERVATION:
        return common | {
            "steps": options.observation_steps, "contacts": options.contacts, "held_out": options.held_out
        }  # fmt: skip
    return common | asdict(training_settings(options))


def training_settings(options: argparse.Namespace) -> TrainingSettings:
    """What all trainings share."""
    return TrainingSettings(
        steps=options.training_steps,
        width=options.width,
        residual_blocks=options.residual_blocks,
        training_clips=options.training_clips,
        clips=options.validation_clips,
        seed=options.seed,
    )


def measure(task: Task) -> Result:
    """A row's result; what goes wrong becomes one that says so."""
    start = time.perf_counter()
    try:
        found = _numbers(task)
    except Exception as error:  # a row that breaks is a result, and the others go on
        reason = str(error) if isinstance(error, RowFailed) else f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - start
        return Result(task.row.name, task.settings, FAILED, " ".join(reason.split()), seconds)
    return Result(task.row.name, task.settings, seconds=time.perf_counter() - start, numbers=found)


def _numbers(task: Task) -> dict[str, float | None]:
    settings = task.settings
    if task.row.family == OBSERVATION:
        material = ablation_observation.read_material(_contacts(task.folder, settings))
        return ablation_observation.train_row(task.row.observation, material, settings["steps"], settings["seed"])
    names = TrainingSettings.__dataclass_fields__
    training = TrainingSettings(**{name: settings[name] for name in names})
    return ablation_training.train_row(task.row, task.folder, task.weights, training, np.array(task.constant))


def _contacts(folder: Path, settings: dict[str, Any]) -> Path:
    """File of the contacts, by what decides them."""
    parts = settings["contacts"], settings["held_out"], settings["seed"], settings["weights_sha256"][:8]
    return folder / f"material-{'-'.join(map(str, parts))}.npz"


def prepare(left: list[Row], options: argparse.Namespace, sha256: str, progress: Progress) -> tuple[float, ...]:
    """Make what the rows that are left share, where it is not there; returns the trainings' constant."""
    if any(row.family == OBSERVATION for row in left):
        row = next(row for row in left if row.family == OBSERVATION)
        path = _contacts(options.output, settings_of(row, options, sha256))
        if not path.is_file():
            ablation_observation.write_material(
                path, options.weights, options.contacts, options.held_out, options.seed, progress, options.workers
            )
    if not any(row.family == TRAINING for row in left):
        return ()
    bar = progress.add_task("clips", total=None)
    folder = ablation_training.clips_folder(options.output, training_settings(options))
    ablation_training.write_clips(folder, options.training_clips, options.seed)
    progress.update(bar, total=1, completed=1)
    path = options.output / f"constant-{options.seed}.json"
    truths = kept_truths(path, FITTED_ON[SPLIT], options.seed, CONSTANT_CLIPS, options.workers, progress)
    return tuple(truths.mean(axis=0).tolist())


@contextmanager
def _one_thread() -> Generator[None]:
    """Trainings are processes of workers and inherit this."""
    before = os.environ.get("OMP_WAIT_POLICY")
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    try:
        yield
    finally:
        os.environ.pop("OMP_WAIT_POLICY") if before is None else os.environ.update(OMP_WAIT_POLICY=before)


def run(options: argparse.Namespace, console: Console) -> list[Result]:
    """Measure the rows that are left; returns all chosen ones' results."""
    sha256, folder = sha256_of(options.weights), options.output / "rows"
    chosen = [row for name, row in ROWS.items() if options.rows is None or name in options.rows]
    found = {row.name: kept(row.name, settings_of(row, options, sha256), folder) for row in chosen}
    results = [result for result in found.values() if result is not None]
    left = [row for row in chosen if found[row.name] is None]
    with progress_bars(console) as progress, _one_thread():
        constant = prepare(left, options, sha256, progress)
        bar = progress.add_task("rows", total=len(chosen), completed=len(results))
        tasks = [
            Task(row, options.output, options.weights, settings_of(row, options, sha256), constant) for row in left
        ]
        for result in run_tasks(measure, tasks, options.workers):
            results.append(result)
            if result.status == FAILED:
                say(console, f"{result.row} failed: {result.reason}", "red")
            else:
                keep(result, folder)
                say(console, f"{result.row}: {result.seconds:.0f} s")
            write_all(results, options.output)
            progress.advance(bar)
    return results


def main(arguments: list[str] | None = None) -> int:
    """Run the ablations that the command line asks for; returns the exit status."""
    console, options = Console(stderr=True), build_parser().parse_args(arguments)
    problem = None
    if options.training_steps % EPOCH:
        problem = f"--training-steps is {options.training_steps}; give a multiple of {EPOCH}."
    elif not options.weights.is_file():
        problem = f"{options.weights} is not a file; give posterior.pt of estimators.network.training as --weights."
    if problem:
        say(console, problem, "red")
        return 2
    try:
        options.output.mkdir(parents=True, exist_ok=True)
        results = run(options, console)
        write_all(results, options.output)
    except KeyboardInterrupt:
        say(console, "Interrupted; finished rows are kept, and the same command continues.", "yellow")
        return INTERRUPTED
    except (CheckpointError, OSError, OutputError, RowFailed, TrainingError, WorkerLost) as error:
        say(console, f"{error} Finished rows are kept.", "red")
        return 1
    table = (options.output / "ablations.md").read_text(encoding="utf-8")
    console.print(table, markup=False, highlight=False, soft_wrap=True)
    return int(any(result.status == FAILED for result in results))


if __name__ == "__main__":
    run_door(main)
