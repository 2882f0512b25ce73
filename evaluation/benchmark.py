"""How well θ is recovered on synthetic clips with known truth, against the best that is possible.

    python -m evaluation.benchmark --suite clean --estimator direct --clips 60 --seed 0 --output runs/benchmark

Clips are made in memory and thrown away. Results are appended to DIR/results.jsonl as they come; the same command
continues an interrupted run, and a later one may add suites, estimators or clips. Writes table.csv, details.csv
(see `evaluation.recovery_details`) and figures/. A clip that can't be estimated is counted and shown. In table.csv
constant_rmse_log is the error of the best constant for exactly the clips of a row; the estimator constant, whose θ is
the mean over another split, can't reach it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from data.samples import PRESS
from estimators.direct import LEAST_SIGMA
from estimators.onset import ONSETS, STAMP
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.benchmark_output import show, write_results
from evaluation.constant import draw_truths
from evaluation.recovery import OK, ClipTask, Recovery, evaluate_clip
from evaluation.recovery_estimators import NAMES, NEEDS_MODEL, EstimatorSpec, check_model
from evaluation.recovery_scores import score_all
from evaluation.recovery_store import RecoveryStore
from evaluation.result_store import OutputError
from evaluation.run_record import sha256_of
from evaluation.suites import FITTED_ON, LARGEST_SEED, SPLITS, SUITES, suite_clip_seed
from models.onnx_session import ModelFileError

CONSTANT_CLIPS = 60
"""Truths whose mean the estimator `constant` answers: over all clips its error is then within 1 % of the least."""
INTERRUPTED = 130
LEAST_SEEN = 3
"""Fewer frames after the onset are refused by `direct`."""


class UsageError(ValueError):
    """Options that can't be used; the message is a sentence."""


class RateColumn(ProgressColumn):
    """Clips a minute, averaged over the last ones."""

    def render(self, task: Task) -> Text:
        """Text of the column."""
        return Text(f"{60 * task.speed:.1f} clips/min" if task.speed else "", style="progress.data.speed")


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="suites:\n"
        + "\n".join(f"  {suite.name:12s}{suite.reason}" for suite in SUITES.values())
        + "\n\nExit status: 0 done, also where clips could not be estimated; 1 nothing could be; 2 wrong usage; "
        "130 interrupted.",
    )
    add = parser.add_argument
    several = {"nargs": "+", "action": "extend"}
    add("--suite", **several, choices=[*SUITES, "all"], metavar="SUITE", help="suites, or all (default clean)")
    add("--estimator", **several, choices=NAMES, metavar="NAME", help=f"{', '.join(NAMES)} (default direct)")
    add("--model", type=Path, metavar="FILE", help="ONNX file of the estimator network")
    add("--paper-model", type=Path, metavar="FILE", help="ONNX file of the estimator paper: one estimate a frame")
    add("--noise", type=float, metavar="SIGMA", help="σ that direct is told [scene units] (default: the clip's own)")
    add(
        "--clips", type=int, default=60, metavar="N", help="clips of each suite, a third a regime (default %(default)s)"
    )
    add("--seed", type=int, default=0, metavar="N", help="another seed gives other clips (default %(default)s)")
    add("--split", choices=list(SPLITS), default="test", help="stream of seeds (default %(default)s)")
    text = "only the first N frames after the onset are seen, or with 'press' those in contact (default: one second)"
    add("--seen", type=_seen, metavar="N", help=text)
    text = "when direct and network take a press to begin: at a frame's stamp (default, as in most suites) or between"
    add("--onset", choices=ONSETS, default=STAMP, help=text)
    add("--output", type=Path, required=True, metavar="DIR", help="folder of the results")
    add("--workers", type=int, default=2, metavar="N", help="processes; 0 = in this one (default %(default)s)")
    text = "truths of another split whose mean the estimator constant answers (default %(default)s)"
    add("--constant-clips", type=int, default=CONSTANT_CLIPS, metavar="N", help=text)
    return parser


def _seen(text: str) -> int | str:
    if text == PRESS or (text.isascii() and text.isdigit() and int(text) >= LEAST_SEEN):
        return PRESS if text == PRESS else int(text)
    raise argparse.ArgumentTypeError(f"{text} is no part of a contact; give at least {LEAST_SEEN} frames, or {PRESS}")


def check_options(options: argparse.Namespace) -> None:
    """Fill in what was left out, and refuse what can't be used.

    Raises:
        UsageError: an option is out of range or lacks its file.
    """
    chosen = dict.fromkeys(options.suite or ["clean"])
    options.suite = [name for name in SUITES if "all" in chosen or name in chosen]
    options.estimator = [name for name in NAMES if name in (options.estimator or ["direct"])]
    for name, lowest in (("clips", 1), ("seed", 0), ("workers", 0), ("constant_clips", 2)):
        if getattr(options, name) < lowest:
            value = getattr(options, name)
            raise UsageError(f"--{name.replace('_', '-')} is {value}; give a whole number of at least {lowest}.")
    if options.seed > LARGEST_SEED:
        raise UsageError(f"--seed is {options.seed}; give at most {LARGEST_SEED}.")
    if options.noise is not None and not LEAST_SIGMA <= options.noise < math.inf:
        raise UsageError(f"--noise is {options.noise}; give {LEAST_SIGMA:g} scene units or more, or leave it out.")
    if options.seen is not None and "paper" in options.estimator:
        raise UsageError("--seen is of no use to paper, which sees single frames; leave one of the two out.")
    for name, option in NEEDS_MODEL.items():
        given = getattr(options, option[2:].replace("-", "_"))
        if name in options.estimator and given is None:
            raise UsageError(f"--estimator {name} needs a network; give its file as {option} FILE.")
        if name not in options.estimator and given is not None:
            raise UsageError(f"{option} {given} is of no use without --estimator {name}; add that or leave it out.")


def estimator_specs(options: argparse.Namespace) -> list[EstimatorSpec]:
    """What is compared, every network opened once; `constant` gets its numbers later.

    Raises:
        ModelFileError: a network can't be used.
    """
    specs = []
    for name in options.estimator:
        option = NEEDS_MODEL.get(name)
        path = getattr(options, option[2:].replace("-", "_")) if option else None
        if path is not None and not path.is_file():
            raise ModelFileError(f"{path} is not a file; give the file that was exported as {option}.")
        spec = EstimatorSpec(
            name,
            model=str(path or ""),
            model_sha256=sha256_of(path) if path else "",
            noise=options.noise if name == "direct" else None,
            seen=options.seen,
            onset=options.onset if name in ("direct", "network") else STAMP,
        )
        specs.append(spec if path is None else check_model(spec))
    return specs


class Benchmark:
    """One run: what is left to do of it, and what comes out."""

    def __init__(self, options: argparse.Namespace, specs: Sequence[EstimatorSpec], console: Console) -> None:
        self.options, self.specs, self.console = options, list(specs), console
        wanted = {
            "seed": options.seed,
            "split": options.split,
            "constant_clips": options.constant_clips,
            "seen": options.seen,
            "suites": {name: SUITES[name].describe() for name in options.suite},
            "estimators": {spec.name: spec.describe() for spec in specs},
        }
        self.store = RecoveryStore(options.output, wanted)
        if self.store.outdated:
            text = (
                "Results of another version of the program are kept; give another --output to measure all of this one."
            )
            console.print(text, style="yellow")

    def run(self) -> None:
        """Do what is left."""
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            RateColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=self.console) as progress:
            tasks = self._tasks(self._moments(progress))
            bar = progress.add_task("clips", total=self.options.clips, completed=self.options.clips - len(tasks))
            for rows in run_tasks(evaluate_clip, tasks, self.options.workers):
                self.store.append(rows)
                progress.advance(bar)

    def chosen(self) -> list[Recovery]:
        """Results that this run's options ask for, those of earlier runs included, in the order of tables."""
        options = self.options
        rows = [
            row
            for row in self.store.rows
            if row.suite in options.suite and row.estimator in options.estimator and row.index < options.clips
        ]
        places = list(SUITES)
        return sorted(rows, key=lambda row: (NAMES.index(row.estimator), places.index(row.suite), row.index))

    def _moments(self, progress: Progress) -> tuple[tuple[float, ...], ...]:
        """What the estimator `constant` answers: mean and covariance of log θ, shape [4][3]; empty without it."""
        if "constant" not in self.options.estimator:
            return ()
        logs = self._fitted_on(progress)
        return tuple(map(tuple, np.vstack((logs.mean(axis=0), np.cov(logs.T))).tolist()))

    def _fitted_on(self, progress: Progress) -> np.ndarray:
        """True log θ of the split on which the estimator `constant` is fitted, shape [n, 3]."""
        options = self.options
        split, count = FITTED_ON[options.split], options.constant_clips
        stored = self.store.constant(split, count)
        if stored is not None:
            return stored
        found = draw_truths(split, options.seed, count, options.workers, progress)
        self.store.keep_constant(split, count, found)
        return found

    def _tasks(self, moments: tuple[tuple[float, ...], ...]) -> list[ClipTask]:
        """Clips of which something is left to do, and what."""
        options, done = self.options, self.store.done
        specs = [
            EstimatorSpec("constant", constant=moments) if spec.name == "constant" else spec for spec in self.specs
        ]
        tasks = []
        for index in range(options.clips):
            left = ((suite, tuple(s for s in specs if (suite, index, s.name) not in done)) for suite in options.suite)
            wanted = tuple((suite, some) for suite, some in left if some)
            if wanted:
                tasks.append(ClipTask(index, suite_clip_seed(options.split, options.seed, index), wanted, options.seen))
        return tasks


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark that the command line asks for; returns the exit status."""
    console = Console(stderr=True)
    options = build_parser().parse_args(arguments)
    try:
        check_options(options)
        benchmark = Benchmark(options, estimator_specs(options), console)
    except (UsageError, ModelFileError, OutputError) as error:
        console.print(str(error), style="red", markup=False, highlight=False, soft_wrap=True)
        return 2
    status = 0
    try:
        benchmark.run()
    except KeyboardInterrupt:
        console.print("Interrupted; finished clips are kept, and the same command continues.", style="yellow")
        status = INTERRUPTED
    except (OutputError, WorkerLost) as error:
        console.print(f"{error} Finished clips are kept.", style="red", markup=False, highlight=False, soft_wrap=True)
        status = 1
    return finish(benchmark, status)


def finish(benchmark: Benchmark, status: int) -> int:
    """Write and print what there is; returns the exit status.

    Args:
        status: exit status so far.
    """
    options, console = benchmark.options, benchmark.console
    rows = benchmark.chosen()
    if not rows:
        return status or 1
    scores = score_all(rows)
    try:
        table = write_results(options.output, scores)
    except OutputError as error:
        console.print(str(error), style="red", markup=False, highlight=False, soft_wrap=True)
        return 1
    show(table, scores, console)
    console.print(f"written: {options.output}/table.csv, details.csv, figures/", markup=False, highlight=False)
    if not any(row.status == OK for row in rows):
        console.print("No clip could be estimated.", style="red")
        return status or 1
    return status


if __name__ == "__main__":
    sys.exit(main())
