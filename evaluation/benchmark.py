"""How well θ is recovered on synthetic clips with known truth, against the best that is possible.

    python -m evaluation.benchmark --suite clean --estimator direct --clips 60 --seed 0 --output runs/benchmark

Clips are made in memory and thrown away. Results are appended to DIR/results.jsonl as they come; the same command
continues an interrupted run, and a later one may add suites, estimators or clips. Writes table.csv, details.csv
(see `evaluation.recovery.details`) and figures/. A clip that can't be estimated is counted and shown. In table.csv
constant_rmse_log is the error of the best constant for exactly the clips of a row; the estimator constant, whose θ is
the mean over another split, can't reach it.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from data.command_line import path_option, progress_bars, real_number, say, whole_number
from data.contact.interaction import PRESS
from estimators.direct.estimator import LEAST_SIGMA
from estimators.onset import ONSETS, STAMP
from estimators.open import EstimatorOptions
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.recovery.constant import kept_truths
from evaluation.recovery.estimators import NAMES, NEEDS_MODEL, Candidate, ConstantOptions, describe, opened
from evaluation.recovery.evaluate import OK, ClipTask, Recovery, evaluate_clip
from evaluation.recovery.output import show, write_results
from evaluation.recovery.scores import score_all
from evaluation.recovery.store import RecoveryStore
from evaluation.recovery.suites import FITTED_ON, LARGEST_SEED, SPLITS, SUITES, suite_clip_seed
from models.onnx_session import ModelFileError
from results.store import OutputError

CONSTANT_CLIPS = 60
"""Truths whose mean the estimator `constant` answers: over all clips its error is then within 1 % of the least."""
LEAST_SEEN = 3
"""Fewer frames after the onset are refused by `direct`."""


class UsageError(ValueError):
    """Options that can't be used; the message is a sentence."""


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
    several: dict[str, Any] = {"nargs": "+", "action": "extend"}
    add("--suite", **several, choices=[*SUITES, "all"], metavar="SUITE", help="suites, or all (default clean)")
    add("--estimator", **several, choices=NAMES, metavar="NAME", help=f"{', '.join(NAMES)} (default direct)")
    add("--model", type=path_option, metavar="FILE", help="ONNX file of the estimator network")
    add("--gan-model", type=path_option, metavar="FILE", help="ONNX file of the estimator gan: one estimate a frame")
    noise = real_number(f"a noise above the simulator's own error; give {LEAST_SIGMA:g} or more", LEAST_SIGMA)
    add("--noise", type=noise, metavar="SIGMA", help="σ that direct is told [scene units] (default: the clip's own)")
    text = "clips of each suite, a third a regime (default %(default)s)"
    add("--clips", type=whole_number(1), default=60, metavar="N", help=text)
    text = "another seed gives other clips (default %(default)s)"
    add("--seed", type=whole_number(0, LARGEST_SEED), default=0, metavar="N", help=text)
    add("--split", choices=list(SPLITS), default="test", help="stream of seeds (default %(default)s)")
    text = "only the first N frames after the onset are seen, or with 'press' those in contact (default: one second)"
    add("--seen", type=_seen, metavar="N", help=text)
    text = "when direct and network take a press to begin: at a frame's stamp (default, as in most suites) or between"
    add("--onset", choices=ONSETS, default=STAMP, help=text)
    add("--output", type=path_option, required=True, metavar="DIR", help="folder of the results")
    text = "processes; 0 = in this one (default %(default)s)"
    add("--workers", type=whole_number(0), default=2, metavar="N", help=text)
    return parser


def _seen(text: str) -> int | str:
    if text == PRESS or (text.isascii() and text.isdigit() and int(text) >= LEAST_SEEN):
        return PRESS if text == PRESS else int(text)
    raise argparse.ArgumentTypeError(f"{text} is no part of a contact; give at least {LEAST_SEEN} frames, or {PRESS}")


def check_options(options: argparse.Namespace) -> None:
    """Fill in what was left out, and refuse what can't be used.

    Raises:
        UsageError: options that don't belong together, or one that lacks its file.
    """
    chosen = dict.fromkeys(options.suite or ["clean"])
    options.suite = [name for name in SUITES if "all" in chosen or name in chosen]
    options.estimator = [name for name in NAMES if name in (options.estimator or ["direct"])]
    if options.seen is not None and "gan" in options.estimator:
        raise UsageError("--seen is of no use to gan, which sees single frames; leave one of the two out.")
    for name, option in NEEDS_MODEL.items():
        given = getattr(options, option[2:].replace("-", "_"))
        if name in options.estimator and given is None:
            raise UsageError(f"--estimator {name} needs a network; give its file as {option} FILE.")
        if name not in options.estimator and given is not None:
            raise UsageError(f"{option} {given} is of no use without --estimator {name}; add that or leave it out.")


def candidates_of(options: argparse.Namespace) -> list[Candidate]:
    """What is compared, every network opened once; `constant` gets its numbers later.

    Raises:
        ModelFileError: a network can't be used.
    """
    found: list[Candidate] = []
    for name in options.estimator:
        if name == "constant":
            found.append(ConstantOptions())
            continue
        option = NEEDS_MODEL.get(name)
        candidate = EstimatorOptions(
            name,
            model=getattr(options, option[2:].replace("-", "_")) if option else None,
            onset=None if name == "gan" else options.onset,
            noise=options.noise if name == "direct" else None,
            horizon=options.seen,
            threads=1,
        )
        opened(candidate)
        found.append(candidate)
    return found


class Benchmark:
    """One run: what is left to do of it, and what comes out."""

    def __init__(self, options: argparse.Namespace, candidates: Sequence[Candidate], console: Console) -> None:
        self.options, self.candidates, self.console = options, list(candidates), console
        wanted = {
            "seed": options.seed,
            "split": options.split,
            "seen": options.seen,
            "suites": {name: SUITES[name].describe() for name in options.suite},
            "estimators": {candidate.name: describe(candidate) for candidate in candidates},
        }
        self.store = RecoveryStore(options.output, wanted)
        if self.store.outdated:
            text = "Results of another version of the program are kept; give another --output to measure this one."
            say(console, text, "yellow")

    def run(self) -> None:
        """Do what is left."""
        with progress_bars(self.console) as progress:
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
        options = self.options
        place = options.output / "constant.json"
        logs = kept_truths(place, FITTED_ON[options.split], options.seed, CONSTANT_CLIPS, options.workers, progress)
        return tuple(map(tuple, np.vstack((logs.mean(axis=0), np.cov(logs.T))).tolist()))

    def _tasks(self, moments: tuple[tuple[float, ...], ...]) -> list[ClipTask]:
        """Clips of which something is left to do, and what."""
        options, done = self.options, self.store.done
        some = [ConstantOptions(moments) if item.name == "constant" else item for item in self.candidates]
        tasks = []
        for index in range(options.clips):
            left = ((suite, tuple(s for s in some if (suite, index, s.name) not in done)) for suite in options.suite)
            wanted = tuple((suite, missing) for suite, missing in left if missing)
            if wanted:
                tasks.append(ClipTask(index, suite_clip_seed(options.split, options.seed, index), wanted, options.seen))
        return tasks


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark that the command line asks for; returns the exit status."""
    console = Console(stderr=True)
    options = build_parser().parse_args(arguments)
    try:
        check_options(options)
        benchmark = Benchmark(options, candidates_of(options), console)
    except (UsageError, ModelFileError, OutputError) as error:
        say(console, str(error), "red")
        return 2
    status = 0
    try:
        benchmark.run()
    except KeyboardInterrupt:
        say(console, "Interrupted; finished clips are kept, and the same command continues.", "yellow")
        status = INTERRUPTED
    except (OutputError, WorkerLost) as error:
        say(console, f"{error} Finished clips are kept.", "red")
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
        say(console, str(error), "red")
        return 1
    show(table, scores, console)
    say(console, f"written: {options.output}/table.csv, details.csv, figures/")
    if not any(row.status == OK for row in rows):
        say(console, "No clip could be estimated.", "red")
        return status or 1
    return status


if __name__ == "__main__":
    run_door(main)
