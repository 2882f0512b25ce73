"""How the generators are trained, ablated: `train.py` on the same clips, equally many steps, judged by the benchmark.

Every row is a training of its own process, with a small network. θ is judged on validation clips of the benchmark's
clean suite by the last checkpoint's exported file, the decoder by the test clips' next depth.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from estimators.onset import STAMP
from estimators.open import EstimatorOptions
from evaluation import calibration
from evaluation.ablations.rows import Row
from evaluation.ablations.scores import numbers
from evaluation.recovery.evaluate import OK, ClipTask, evaluate_clip
from evaluation.recovery.scores import TO_QUANTITIES, measure_noise, score
from evaluation.recovery.suites import suite_clip_seed

ROOT = Path(__file__).resolve().parents[2]
SUITE, SPLIT = "clean", "validation"
EPOCH = 50
"""Steps after which the order of the samples is drawn anew."""
FRACTIONS = "[0.7,0.1,0.2]"
"""Of the clips: training, validation, test."""


class RowFailed(RuntimeError):
    """A row gave no numbers; the message says which step of it ended how."""


@dataclass(frozen=True)
class TrainingSettings:
    """What all trainings share."""

    steps: int
    """Steps of the generators' optimiser, a multiple of EPOCH."""
    width: int
    residual_blocks: int
    training_clips: int
    """Synthetic clips that are read; training takes seven of ten."""
    clips: int
    """Validation clips."""
    seed: int
    """Of all clips."""


def clips_folder(folder: Path, settings: TrainingSettings) -> Path:
    """Where the clips of some settings lie."""
    return folder / f"clips-{settings.training_clips}-{settings.seed}"


def write_clips(folder: Path, count: int, seed: int) -> None:
    """Synthetic clips with the noise of the clean suite; those that are there stay.

    Raises:
        RowFailed: they can't be written.
    """
    options = ("--size", "small", "--depth-noise", "0.001", "--clips", str(count), "--seed", str(seed))
    _run(("-m", "data.synthetic", "--output", str(folder), *options), folder.with_suffix(".log"))


def train_row(row: Row, folder: Path, weights: Path, settings: TrainingSettings, constant: np.ndarray) -> dict:
    """Train, test, export and judge a row; returns its numbers.

    Args:
        row: what is changed.
        folder: of the ablations; holds the clips.
        weights: pretrained contact posterior.
        settings: what all rows share.
        constant: mean log θ of another split, shape [3].

    Raises:
        RowFailed: a step of it failed.
    """
    run = folder / "training" / row.name
    shutil.rmtree(run, ignore_errors=True)  # what a killed run left
    run.mkdir(parents=True)
    model, found = run / "parameters.onnx", {}
    if row.trained:
        common = ("-c", row.config, *row.options, *_common(folder, run, settings))
        start = ("--model.pretrained", str(weights.resolve())) if row.pretrained else ()
        last = ("--ckpt_path", "last")
        for command in (("fit", *common, *start), ("test", *common, *last), ("export", *common, *last)):
            output = ("--output", str(model)) if command[0] == "export" else ()
            _run(("train.py", *command, *output), run / f"{command[0]}.log")
            if command[0] == "fit":
                require_steps(run / "checkpoints" / "last.ckpt", settings.steps)
        found["next_depth_over_copy"] = next_depth(run / "evaluation" / "evaluation.json")
    elif calibration.main(["--weights", str(weights), "--output", str(model)]):
        raise RowFailed(f"{weights} could not be exported.")
    name = "gan" if row.config.endswith("paper.yaml") else "network"
    return judge(EstimatorOptions(name, model, STAMP, threads=1), settings, constant) | found


def require_steps(checkpoint: Path, steps: int) -> None:
    """Refuse a training that made fewer steps than all others: an epoch ends with its clips.

    Raises:
        RowFailed: it did.
    """
    loops = torch.load(checkpoint, map_location="cpu", weights_only=True)["loops"]
    done = loops["fit_loop"]["epoch_loop.batch_progress"]["total"]["completed"]
    if done != steps:
        raise RowFailed(f"{done} of {steps} steps were made; give more --training-clips.")


def next_depth(path: Path) -> float:
    """The decoder's mean error of the next depth over that of repeating the last frame, from an `evaluation.json`."""
    depth = json.loads(path.read_text(encoding="utf-8"))["depth"]
    return depth["decoder"]["mean"]["value"] / depth["copy"]["mean"]["value"]


def judge(candidate: EstimatorOptions, settings: TrainingSettings, constant: np.ndarray) -> dict[str, float | None]:
    """Numbers of an exported network on the validation clips.

    Raises:
        RowFailed: no clip gave an estimate.
    """
    rows = []
    for index in range(settings.clips):
        seed = suite_clip_seed(SPLIT, settings.seed, index)
        rows += evaluate_clip(ClipTask(index, seed, ((SUITE, (candidate,)),)))
    if not any(row.status == OK for row in rows):
        raise RowFailed(f"no validation clip gave an estimate: {rows[0].reason}")
    scores = score(rows, measure_noise(rows))
    return numbers(scores.errors, TO_QUANTITIES @ constant - scores.truth, scores.bounds, scores.sd)


def _common(folder: Path, run: Path, settings: TrainingSettings) -> tuple[str, ...]:
    """Options of all trainings."""
    values = {
        "tracking": "false",
        "data.root": clips_folder(folder, settings),
        "data.cache": folder / "cache",
        "data.loading.fractions": FRACTIONS,
        "model.width": settings.width,
        "model.residual_blocks": settings.residual_blocks,
        "trainer.default_root_dir": run,
        "trainer.max_epochs": settings.steps // EPOCH,
        "trainer.limit_train_batches": EPOCH,
        "trainer.limit_val_batches": 1,  # the last checkpoint is judged, not the best
        "trainer.num_sanity_val_steps": 0,
        "trainer.enable_progress_bar": "false",
        "trainer.enable_model_summary": "false",
    }
    paths = {name: value.resolve() if isinstance(value, Path) else value for name, value in values.items()}
    return tuple(part for name, value in paths.items() for part in (f"--{name}", str(value)))


def _run(arguments: Sequence[str], log: Path) -> None:
    """Run Python in the checkout; its output goes to `log`.

    Raises:
        RowFailed: it ends with another status than 0.
    """
    with log.open("wb") as output, _interruptible():
        process = subprocess.Popen([sys.executable, *arguments], cwd=ROOT, stdout=output, stderr=subprocess.STDOUT)
    try:
        status = process.wait()
    finally:
        process.kill()
    if status:
        said = log.read_text(encoding="utf-8", errors="replace").split("\n")
        last = next((line for line in reversed(said) if line.strip()), "")
        raise RowFailed(f"{' '.join(arguments[:2])} ended with status {status}: {last.strip()} (see {log})")


@contextlib.contextmanager
def _interruptible() -> Generator[None]:
    """Let a process that starts now end with Ctrl-C, although a worker itself ignores it."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
