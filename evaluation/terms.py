"""What each term of the loss, the picture and the decoder are worth: the same short training without it.

A row is `train.py fit -c configs/smoke.yaml`, from the shipped head, with one setting changed. Every trained generator
is judged on the same clips of SUITES: its θ after the whole contact, and the picture that it makes of the frames under
the tool (as `evaluation.next_depth` counts). What a row is worth is its error over that of the whole system, with an
interval over resamples of clips and seeds that both have.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimators.network.training import TrainingError
from evaluation.generated import TrainedGenerator
from evaluation.next_depth import absolute_errors, copies
from evaluation.recovery.bounds import MECHANICS
from evaluation.recovery.store import replace_text
from evaluation.recovery.suites import suite_clip_seed
from evaluation.watched import WatchedClip, watch
from physics.files import as_json, read_file
from physics.mechanics import PARAMETERS
from results.store import OutputError, writing

ROOT = Path(__file__).resolve().parents[1]
CONFIGURATION = "configs/smoke.yaml"
FULL = "full"
ROWS = {
    FULL: (f"{CONFIGURATION} as it is", ()),
    "no-gan": ("without the adversary", ("--model.weights.gan", "0")),
    "no-cycle": ("without the cycle term", ("--model.weights.cycle", "0")),
    "no-identity": ("without the identity term", ("--model.weights.identity", "0")),
    "no-physics": ("without the evidence bound", ("--model.weights.physics", "0")),
    "no-regularisation": ("without the hinge outside the box", ("--model.weights.regularisation", "0")),
    "no-picture": ("its head without the encoder's features", ("--model.picture", "false")),
    "residual": ("its decoder starts from the last map", ("--model.decoder", "residual")),
    "direct": ("its decoder starts from nothing", ("--model.decoder", "direct")),
}
"""What the rows are, and their options of `train.py fit`, in the order of tables."""
SUITES = ("clean", "noisy")
"""The judged clips'."""
FRACTIONS = "[0.84,0.08,0.08]"
"""Shares of clips to train, validate and test; the judged ones are others."""
EVERY = 2
"""Every so many of the frames under the tool are predicted from."""
RESAMPLES = 10_000
JUDGED = "judged.json"
COLUMNS = (
    "suite", "row", "seeds", "error", "error_low", "error_high", *(f"spread_{name}" for name in PARAMETERS),
    "depth_copy", "depth", "depth_low", "depth_high",
)  # fmt: skip


@dataclass(frozen=True)
class Judged:
    """A trained generator on C clips of a suite."""

    suite: str
    truth: list[list[float]]
    """log |θ|, shape [C, 3]."""
    estimate: list[list[float]]
    """The same as it says, shape [C, 3]."""
    copied: list[list[float]]
    """Summed errors of both copies of earlier maps, shape [C, 2] [scene units]."""
    generated: list[float]
    """The same of its pictures, shape [C]."""


def folder_of(output: Path, row: str, seed: int) -> Path:
    """Run folder of a row's training."""
    return output / f"{row}-{seed}"


def train(row: str, seed: int, clips: Path, steps: int, output: Path) -> Path:
    """Train a row's generator, unless that is done; returns its checkpoint.

    Raises:
        OutputError: the folder can't be written, or something else is in its place.
        TrainingError: it did not succeed.
    """
    folder = folder_of(output, row, seed)
    checkpoint = folder / "checkpoints" / "last.ckpt"
    if checkpoint.is_file():
        return checkpoint
    if os.path.lexists(folder):
        raise OutputError(f"{folder}: holds no finished training; move it away or choose another --output.")
    with writing(output):
        output.mkdir(parents=True, exist_ok=True)
        # A name that is nobody else's: what an interruption leaves in it can be removed.
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=output, ignore_cleanup_errors=True) as partial:
            _train(row, seed, clips, steps, output, Path(partial) / folder.name)
            os.rename(Path(partial) / folder.name, folder)
    return checkpoint


def _train(row: str, seed: int, clips: Path, steps: int, output: Path, folder: Path) -> None:
    """Train a row's generator in a folder that is not there yet."""
    options = {
        "-c": CONFIGURATION,
        "--seed_everything": seed,
        "--data.loading.seed": seed,
        "--data.root": clips.resolve(),
        "--data.cache": (output / "cache").resolve(),
        "--data.loading.fractions": FRACTIONS,
        "--trainer.default_root_dir": folder.resolve(),
        "--trainer.max_epochs": 1,
        "--trainer.limit_train_batches": steps,
        "--trainer.limit_val_batches": 1,
        "--trainer.enable_progress_bar": "false",
        "--tracking": "false",
    }
    command = [sys.executable, "train.py", "fit", *(str(part) for option in options.items() for part in option)]
    done = subprocess.run([*command, *ROWS[row][1]], cwd=ROOT, capture_output=True, text=True, errors="replace")
    if done.returncode or not (folder / "checkpoints" / "last.ckpt").is_file():
        reason = (done.stderr.strip().splitlines() or ["it wrote no checkpoint"])[-1]
        raise TrainingError(f"{row}, seed {seed}: the training failed ({reason}).")


def judge(generator: TrainedGenerator, suite: str, clips: Sequence[WatchedClip]) -> Judged:
    """What a generator says of the clips of a suite."""
    truth, estimate, copied, generated = [], [], [], []
    for clip in clips:
        frames = range(clip.motion.onset_frame, len(clip.frames))
        last = max(frame for frame in frames if clip.since(frame) <= MECHANICS.seconds)
        total = np.zeros(3)
        for now in clip.instants(generator.horizon)[::EVERY]:
            made = [*copies(clip, now), generator.picture(clip, now, generator.estimate(clip, now))]
            total += absolute_errors(clip, now, generator.horizon, made)[1]
        truth.append(np.log(np.abs(clip.motion.theta)).tolist())
        estimate.append(np.log(np.abs(generator.estimate(clip, last))).tolist())
        copied.append(total[:2].tolist())
        generated.append(float(total[2]))
    return Judged(suite, truth, estimate, copied, generated)


def judged_clips(seed: int, count: int) -> dict[str, list[WatchedClip]]:
    """Clips of every suite, of the validation stream."""
    found = {
        suite: [watch(suite, index, suite_clip_seed("validation", seed, index)) for index in range(count)]
        for suite in SUITES
    }
    return {suite: [clip for clip in clips if clip is not None] for suite, clips in found.items()}


def results_of(path: Path, settings: Mapping[str, Any]) -> list[Judged] | None:
    """What was kept of a judged generator; None where nothing was.

    Raises:
        OutputError: it depends on other settings, or can't be read.
    """
    if not path.is_file():
        return None
    try:
        kept = json.loads(read_file(path))
        same, judged = kept["settings"] == dict(settings), [_judged(**suite) for suite in kept["suites"]]
    except (OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise OutputError(f"{path}: is not readable; remove it.") from error
    if not same:
        raise OutputError(f"{path}: is of other settings; run with the same arguments or choose another --output.")
    return judged


def _judged(suite: str, **numbers: Any) -> Judged:
    """What JSON kept; null there was not finite."""
    return Judged(suite, **{name: np.array(values, np.float64).tolist() for name, values in numbers.items()})


def measure(
    rows: Sequence[str], seeds: int, clips: Path, steps: int, held_out: int, seed: int, output: Path
) -> Iterator[tuple[str, int, list[Judged]]]:
    """Train and judge what is missing, one seed of all rows after the other; gives every row and seed.

    Raises:
        CheckpointError: a row's checkpoint can't be used.
        OutputError: the folder can't be, or is of other settings.
        TrainingError: a training did not succeed.
    """
    names = sorted(path.name for path in clips.iterdir() if path.is_dir())
    settings = {"clips": names, "steps": steps, "held_out": held_out, "seed": seed}
    watched: dict[str, list[WatchedClip]] = {}
    for turn in range(seeds):
        for row in rows:
            path = folder_of(output, row, turn) / JUDGED
            found = results_of(path, settings)
            if found is None:
                generator = TrainedGenerator(train(row, turn, clips, steps, output))
                watched = watched or judged_clips(seed, held_out)
                found = [judge(generator, suite, watched[suite]) for suite in SUITES]
                kept = {"settings": settings, "suites": [asdict(suite) for suite in found]}
                replace_text(path, as_json(kept) + "\n")
            yield row, turn, found


def table(found: Mapping[tuple[str, int], Sequence[Judged]]) -> list[dict[str, object]]:
    """Rows of `table.csv`, by COLUMNS: what is relative to FULL is missing without it.

    Args:
        found: by row and seed, by suite.
    """
    rows = []
    for place, suite in enumerate(SUITES):
        for row in ROWS:
            seeds = [turn for name, turn in found if name == row]
            own = [found[row, turn][place] for turn in seeds]
            if not own:
                continue
            truth = np.array(own[0].truth)
            with np.errstate(invalid="ignore"):  # one clip alone has none
                spread = np.mean([np.std(each.estimate, axis=0) / truth.std(axis=0) for each in own], axis=0)
            copied = np.sum([each.copied for each in own], axis=(0, 1)).min()
            line: dict[str, object] = {"suite": suite, "row": row, "seeds": len(seeds)}
            line |= dict(zip((f"spread_{name}" for name in PARAMETERS), spread.tolist(), strict=True))
            line["depth_copy"] = float(np.sum([each.generated for each in own]) / copied)
            shared = [turn for turn in seeds if (FULL, turn) in found]
            if shared and row != FULL:
                sides = [[found[name, turn][place] for turn in shared] for name in (row, FULL)]
                squares = [squared_errors(side) for side in sides]
                depths = [np.array([each.generated for each in side]) for side in sides]
                errors, pictures = np.sqrt(compared(*squares)), compared(*depths)
                for name, values in (("error", errors), ("depth", pictures)):
                    line |= dict(zip((name, f"{name}_low", f"{name}_high"), values.tolist(), strict=True))
            rows.append(line)
    return rows


def squared_errors(judged: Sequence[Judged]) -> np.ndarray:
    """Squared errors of log θ, summed over its parameters, by seed and clip, shape [S, C]."""
    return np.array([np.square(np.subtract(each.estimate, each.truth)).sum(axis=1) for each in judged])


def compared(row: np.ndarray, full: np.ndarray) -> np.ndarray:
    """Ratio of two sums over seeds and clips [S, C], and its 95 % interval over resamples of both, shape [3].

    Both sides of a resample have the same seeds and clips. A percentile interval: there are few of either.
    """
    generator = np.random.default_rng(0)
    seeds, clips = (generator.integers(count, size=(RESAMPLES, count)) for count in row.shape)
    sums = [values[seeds[:, :, None], clips[:, None, :]].sum(axis=(1, 2)) for values in (row, full)]
    ratio = row.sum() / full.sum()
    return np.array([ratio, *np.quantile(sums[0] / sums[1], [0.025, 0.975])])
