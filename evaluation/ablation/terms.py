"""What each term of the loss, the picture and the decoder are worth: the same short training without it.

A row is `train.py fit -c configs/smoke.yaml`, from the shipped head, with one setting changed. Every trained generator
is judged on the same clips of SUITES: its θ after the whole contact, and the picture that it makes of the frames under
the tool (as `evaluation.ablation.next_depth` counts). What a row is worth is its error over that of the whole system,
with an interval over resamples of clips and seeds that both have.

rows:
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from rich.progress import Progress

from palpate.common.options import require_within
from palpate.common.settings import LARGEST
from palpate.estimators.network.training import LEAST_STEPS, TrainingError
from palpate.evaluation.ablation.generated import TrainedGenerator
from palpate.evaluation.ablation.next_depth import absolute_errors, copies
from palpate.evaluation.ablation.watched import WatchedClip, watch
from palpate.evaluation.harness import Experiment, Report, Row
from palpate.evaluation.recovery.bounds import MECHANICS
from palpate.evaluation.recovery.suites import suite_clip_seed
from palpate.models.checkpoint import CheckpointError
from palpate.physics.mechanics import PARAMETERS
from palpate.results.store import OutputError, writing

ROOT = Path(__file__).resolve().parents[2]
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
DOCUMENTATION = f"{__doc__}" + "\n".join(f"  {name:20s}{what}" for name, (what, _) in ROWS.items())
SUITES = ("clean", "noisy")
"""The judged clips'."""
FRACTIONS = "[0.84,0.08,0.08]"
"""Shares of clips to train, validate and test; the judged ones are others."""
EVERY = 2
"""Every so many of the frames under the tool are predicted from."""
RESAMPLES = 10_000
COLUMNS = (
    "suite", "row", "seeds", "error", "error_low", "error_high", *(f"spread_{name}" for name in PARAMETERS),
    "depth_copy", "depth", "depth_low", "depth_high",
)  # fmt: skip


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


def judge(generator: TrainedGenerator, clips: Sequence[WatchedClip]) -> Row:
    """What a generator says of C clips of a suite.

    Returns:
        `truth` and `estimate`, log |θ|, shape [C, 3]; and summed errors of both copies of earlier maps, `copied`, shape
        [C, 2], and of its pictures, `generated`, shape [C] [scene units].
    """
    truth, estimate, totals = [], [], []
    for clip in clips:
        frames = range(clip.motion.onset_frame, len(clip.frames))
        last = max(frame for frame in frames if clip.since(frame) <= MECHANICS.seconds)
        total = np.zeros(3)
        for now in clip.instants(generator.horizon)[::EVERY]:
            made = [*copies(clip, now), generator.picture(clip, now, generator.estimate(clip, now))]
            total += absolute_errors(clip, now, generator.horizon, made)[1]
        truth.append(np.log(np.abs(clip.motion.theta)))
        estimate.append(np.log(np.abs(generator.estimate(clip, last))))
        totals.append(total)
    errors = np.array(totals)
    found = {"truth": np.array(truth), "estimate": np.array(estimate)}
    return found | {"copied": errors[:, :2], "generated": errors[:, 2]}


@functools.cache
def judged_clips(seed: int, count: int) -> dict[str, list[WatchedClip]]:
    """Clips of every suite, of the validation stream."""
    seeds = [suite_clip_seed("validation", seed, index) for index in range(count)]
    found = {suite: [watch(suite, *clip) for clip in enumerate(seeds)] for suite in SUITES}
    return {suite: [clip for clip in clips if clip is not None] for suite, clips in found.items()}


def train_and_judge(case: tuple[Terms, tuple[str, int]]) -> list[Row]:
    """A row a suite of one training.

    Raises:
        CheckpointError: its checkpoint can't be used.
        OutputError: the folder can't be.
        TrainingError: the training did not succeed.
    """
    asked, (row, turn) = case
    generator = TrainedGenerator(train(row, turn, asked.clips, asked.steps, asked.output))
    watched, named = judged_clips(asked.seed, asked.held_out), {"row": row, "turn": turn}
    return [named | {"suite": suite} | judge(generator, watched[suite]) for suite in SUITES]


@dataclass(frozen=True)
class Terms(Experiment):
    """What is trained, and on which clips it is judged."""

    clips: Path
    """folder of clips with truth that generators are trained on, as python -m data.synthetic writes"""
    rows: tuple[str, ...] = tuple(ROWS)
    """what is left out (default: each)"""
    seeds: int = 3
    """trainings of every row"""
    steps: int = 50
    """steps of every training"""
    held_out: int = 15
    """clips of each suite to judge on"""
    seed: int = 0
    """another seed gives other judged clips"""

    keys: ClassVar = ("row", "turn", "suite")
    work: ClassVar = staticmethod(train_and_judge)
    refused: ClassVar = (CheckpointError, TrainingError)

    def __post_init__(self) -> None:
        """Raise a ValueError where an option can't be used."""
        ranges = {"seeds": (1, LARGEST), "steps": (LEAST_STEPS, LARGEST), "held_out": (1, LARGEST)}
        require_within(self, seed=(0, LARGEST), **ranges)
        if not set(self.rows) <= set(ROWS):
            raise ValueError(f"--rows {' '.join(self.rows)}: give some of {', '.join(ROWS)}.")
        if not self.clips.is_dir():
            raise ValueError(f"{self.clips} is not a folder; give clips of python -m data.synthetic as --clips.")

    def record(self) -> Mapping[str, Any]:
        """What the results depend on."""
        names = sorted(path.name for path in self.clips.iterdir() if path.is_dir())
        return {"clips": names, "steps": self.steps, "held_out": self.held_out, "seed": self.seed}

    def cases(self, done: Mapping[tuple, Row], progress: Progress) -> tuple[list[Any], int]:
        """One seed of all rows after the other."""
        wanted = [(row, turn) for turn in range(self.seeds) for row in ROWS if row in self.rows]
        left = [pair for pair in wanted if any((*pair, suite) not in done for suite in SUITES)]
        return [self.case(pair) for pair in left], len(wanted)

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """A row a suite and what is left out."""
        frame = table([row for row in rows.values() if row["row"] in self.rows and row["turn"] < self.seeds])
        return Report({"table.csv": frame}, [frame])


def table(found: Sequence[Row]) -> pd.DataFrame:
    """`table.csv`, by COLUMNS: what is relative to FULL is missing without it.

    Args:
        found: a row a training and suite.
    """
    by = {(each["suite"], each["row"], each["turn"]): each for each in found}
    rows = []
    for suite in SUITES:
        for row in ROWS:
            own = [each for each in found if (each["suite"], each["row"]) == (suite, row)]
            if not own:
                continue
            with np.errstate(invalid="ignore"):  # one clip alone has none
                spread = np.mean([each["estimate"].std(axis=0) / own[0]["truth"].std(axis=0) for each in own], axis=0)
            copied = np.sum([each["copied"] for each in own], axis=(0, 1)).min()
            line: Row = {"suite": suite, "row": row, "seeds": len(own)}
            line |= dict(zip((f"spread_{name}" for name in PARAMETERS), spread.tolist(), strict=True))
            line["depth_copy"] = float(np.sum([each["generated"] for each in own]) / copied)
            shared = [each["turn"] for each in own if (suite, FULL, each["turn"]) in by]
            if shared and row != FULL:
                sides = [[by[suite, name, turn] for turn in shared] for name in (row, FULL)]
                errors = np.sqrt(compared(*(squared_errors(side) for side in sides)))
                pictures = compared(*(np.array([each["generated"] for each in side]) for side in sides))
                for name, values in (("error", errors), ("depth", pictures)):
                    line |= dict(zip((name, f"{name}_low", f"{name}_high"), values.tolist(), strict=True))
            rows.append(line)
    return pd.DataFrame(rows, columns=COLUMNS)


def squared_errors(judged: Sequence[Row]) -> np.ndarray:
    """Squared errors of log θ, summed over its parameters, by seed and clip, shape [S, C]."""
    return np.array([np.square(each["estimate"] - each["truth"]).sum(axis=1) for each in judged])


def compared(row: np.ndarray, full: np.ndarray) -> np.ndarray:
    """Ratio of two sums over seeds and clips [S, C], and its 95 % interval over resamples of both, shape [3].

    Both sides of a resample have the same seeds and clips. A percentile interval: there are few of either.
    """
    generator = np.random.default_rng(0)
    seeds, clips = (generator.integers(count, size=(RESAMPLES, count)) for count in row.shape)
    sums = [values[seeds[:, :, None], clips[:, None, :]].sum(axis=(1, 2)) for values in (row, full)]
    ratio = row.sum() / full.sum()
    return np.array([ratio, *np.quantile(sums[0] / sums[1], [0.025, 0.975])])
