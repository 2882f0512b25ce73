"""How well θ is recovered on synthetic clips with known truth, against the best that is possible.

    python -m evaluation.benchmark --suite clean --estimator direct --clips 60 --seed 0 --output runs/benchmark

Clips are made in memory and thrown away. Results are appended to DIR/results.jsonl as they come; the same command
continues an interrupted run, and a later one may add suites, estimators or clips. Writes table.csv, details.csv
(see `evaluation.recovery.details`) and figures/. A clip that can't be estimated is counted and shown. In table.csv
constant_rmse_log is the error of the best constant for exactly the clips of a row; the estimator constant, whose θ is
the mean over another split, can't reach it.

Suites of grips show tissue that a tool holds and moves, at 854x480; the session of direct is asked what they tell, and
grips.csv has the answer (see `evaluation.recovery.grips`). The suite fem shows soft solids, whose truth is no θ; what
estimates mean then is in slabs.csv (see `evaluation.recovery.slabs`).
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, interruptible, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from data.command_line import path_option, progress_bars, real_number, say, whole_number
from data.contact.interaction import CONTACT, FIELD, OBSERVATIONS, PRESS
from data.depth.normalise import MOST_THREADS
from estimators.direct.estimator import LEAST_SIGMA
from estimators.onset import ONSETS, STAMP
from estimators.open import FEM, MODELS, SHEET, EstimatorOptions
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.recovery.constant import constant_estimate
from evaluation.recovery.estimators import CONSTANT, NAMES, Candidate, describe
from evaluation.recovery.evaluate import MOTION, ClipTask, Recovery, evaluate_clip
from evaluation.recovery.grips import DIRECT, GripRecovery, GripTask, evaluate_grip
from evaluation.recovery.output import finish, finish_grips, finish_slabs
from evaluation.recovery.scores import Bound
from evaluation.recovery.slabs import SlabRecovery, SlabTask, asked, evaluate_slab
from evaluation.recovery.store import RecoveryStore
from evaluation.recovery.suites import (
    GRID_SIZE,
    GRIP_SUITES,
    LARGEST_SEED,
    SLAB_SUITES,
    SPLITS,
    SUITES,
    suite_clip_seed,
)
from models.onnx_session import ModelFileError
from results.store import OutputError

LARGEST_SIZE = 4096
"""Of pictures [px]."""
LEAST_SEEN = 3
"""Fewer frames after the onset are refused by `direct`."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="suites:\n"
        + "\n".join(
            f"  {suite.name:12s}{suite.reason}"
            for suite in (*SUITES.values(), *GRIP_SUITES.values(), *SLAB_SUITES.values())
        )
        + "\n\nExit status: 0 done, also where clips could not be estimated; 1 nothing could be; 2 wrong usage; "
        "130 interrupted.",
    )
    add = parser.add_argument
    several: dict[str, Any] = {"nargs": "+", "action": "extend"}
    choices = [*SUITES, *GRIP_SUITES, *SLAB_SUITES, "all"]
    text = "suites, or all of presses (default clean)"
    add("--suite", **several, choices=choices, metavar="SUITE", help=text)
    add("--estimator", **several, choices=NAMES, metavar="NAME", help=f"{', '.join(NAMES)} (default direct)")
    add("--model", type=path_option, metavar="FILE", help="ONNX file of the estimator network")
    add("--gan-model", type=path_option, metavar="FILE", help="ONNX file of the estimator gan: one estimate a frame")
    text = (
        "what direct fits to presses (default %(default)s): fem is a slab of finite elements that is told the "
        "tissue's thickness, for the suite fem alone"
    )
    add("--direct-model", choices=MODELS, default=SHEET, help=text)
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
    text = (
        "how contacts are found: where masks show the tool (touching, default), or by their dents in clips that are "
        "drawn without the tool (motion), of presses on a sheet"
    )
    add("--contact", choices=("touching", MOTION), default="touching", help=text)
    text = "what direct and network look at: the whole dent (field, default), or the point that was touched (contact)"
    add("--observation", choices=OBSERVATIONS, help=text)
    text = (
        "Cramér–Rao bound that errors are compared with: of the film of the whole dent (default), or of the contact's "
        "point; with --onset between, of somebody who doesn't know the instants either"
    )
    add("--bound", choices=OBSERVATIONS, default=FIELD, help=text)
    text = "width and height of the pictures (default %(default)s); 854x480 is CholecSeg8k's"
    add("--size", type=_size, default="214x120", metavar="WxH", help=text)
    add("--output", type=path_option, required=True, metavar="DIR", help="folder of the results")
    text = "processes; 0 = in this one (default %(default)s)"
    add("--workers", type=whole_number(0, MOST_THREADS), default=2, metavar="N", help=text)
    return parser


def _seen(text: str) -> int | str:
    if text == PRESS or (text.isascii() and text.isdigit() and int(text) >= LEAST_SEEN):
        return PRESS if text == PRESS else int(text)
    raise argparse.ArgumentTypeError(f"{text} is no part of a contact; give at least {LEAST_SEEN} frames, or {PRESS}")


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    whole = width.isdigit() and height.isdigit() and text.isascii()
    if not whole or not (GRID_SIZE[0] <= int(width) <= LARGEST_SIZE and GRID_SIZE[1] <= int(height) <= LARGEST_SIZE):
        least = "x".join(map(str, GRID_SIZE))
        raise argparse.ArgumentTypeError(
            f"{text} is no size of pictures; give WIDTHxHEIGHT from {least} up, {LARGEST_SIZE} px a side at most"
        )
    return int(width), int(height)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Options of the command line, with what was left out; ends the program where they don't belong together."""
    parser = build_parser()
    options = parser.parse_args(arguments)
    chosen = options.suite or ["clean"]
    options.suite = [name for name in SUITES if "all" in chosen or name in chosen]
    options.grips = [name for name in GRIP_SUITES if name in chosen]
    options.slabs = [name for name in SLAB_SUITES if name in chosen]
    options.estimator = [name for name in NAMES if name in (options.estimator or ["direct"])]
    if options.slabs and CONSTANT in options.estimator:
        parser.error(
            "--estimator constant is of no use to the suite fem, which has no true θ; leave one of the two out."
        )
    if options.seen is not None and "gan" in options.estimator:
        parser.error("--seen is of no use to gan, which sees single frames; leave one of the two out.")
    if options.direct_model == FEM and (options.suite or options.grips or "direct" not in options.estimator):
        parser.error(
            "--direct-model fem is for --suite fem --estimator direct, whose clips tell the thickness; leave other "
            "suites out."
        )
    if options.direct_model == FEM and options.observation == CONTACT:
        parser.error("--direct-model fem is fitted to all visible tissue; leave --observation contact out.")
    if options.contact == MOTION and (options.grips or options.slabs or "gan" in options.estimator):
        parser.error("--contact motion is for direct and network on suites of presses; leave gan and other suites out.")
    options.models = {"network": options.model, "gan": options.gan_model}
    for (name, given), option in zip(options.models.items(), ("--model", "--gan-model"), strict=True):
        if name in options.estimator and given is None:
            parser.error(f"--estimator {name} needs a network; give its file as {option} FILE.")
        if name not in options.estimator and given is not None:
            parser.error(f"{option} {given} is of no use without --estimator {name}; add that or leave it out.")
    return options


def estimators_of(options: argparse.Namespace) -> dict[str, EstimatorOptions]:
    """What is compared but the constant, by name."""
    return {
        name: EstimatorOptions(
            name,
            model=Path(options.direct_model) if name == "direct" else options.models.get(name),
            onset=None if name == "gan" else options.onset,
            noise=options.noise if name == "direct" else None,
            observation=None if name == "gan" else options.observation,
            horizon=options.seen,
            threads=1,
        )
        for name in options.estimator
        if name != CONSTANT
    }


def open_store(options: argparse.Namespace, estimators: Mapping[str, EstimatorOptions]) -> RecoveryStore:
    """Results of earlier runs, and where those of this one go.

    Raises:
        ModelFileError: a network can't be used.
        OutputError: the folder can't be, or holds results that depend on something else.
    """
    wanted = {"seed": options.seed, "split": options.split, "seen": options.seen, "size": list(options.size)}
    wanted["contact"] = options.contact
    wanted |= {f"suite {name}": SUITES[name].describe() for name in options.suite}
    wanted |= {f"estimator {name}": describe(estimator) for name, estimator in estimators.items()}
    return RecoveryStore(options.output, wanted, Recovery)


def run_grips(options: argparse.Namespace, console: Console) -> int:
    """Do what is left of the suites of grips, and write grips.csv; returns the exit status."""
    wanted = {"seed": options.seed, "split": options.split}
    wanted |= {f"suite {name}": GRIP_SUITES[name].describe() for name in options.grips}
    try:
        store = RecoveryStore(options.output, wanted, GripRecovery)
    except OutputError as error:
        say(console, str(error), "red")
        return 2
    asked = [(name, index) for index in range(options.clips) for name in options.grips]
    left = [pair for pair in asked if (*pair, DIRECT) not in store.done]
    tasks = [GripTask(*pair, suite_clip_seed(options.split, options.seed, pair[1])) for pair in left]
    status = _append_all(evaluate_grip, tasks, len(asked), store, options.workers, console)
    rows = [row for row in store.rows if (row.suite, row.index) in asked]
    return finish_grips(rows, options.output, console, status)


def run_slabs(options: argparse.Namespace, console: Console) -> int:
    """Do what is left of the suites of slabs, and write slabs.csv; returns the exit status."""
    estimators = estimators_of(options)
    wanted = {"seed": options.seed, "split": options.split, "seen": options.seen}
    try:
        wanted |= {f"suite {name}": SLAB_SUITES[name].describe() for name in options.slabs}
        wanted |= {f"estimator {name}": describe(estimator) for name, estimator in estimators.items()}
        store = RecoveryStore(options.output, wanted, SlabRecovery)
    except (ModelFileError, OutputError) as error:
        say(console, str(error), "red")
        return 2
    tasks, total = [], options.clips * len(options.slabs)
    for index, suite in itertools.product(range(options.clips), options.slabs):
        left = {
            name: estimators[name] for name in asked(suite, index, estimators) if (suite, index, name) not in store.done
        }
        if left:
            tasks.append(SlabTask(suite, index, suite_clip_seed(options.split, options.seed, index), left))
    status = _append_all(evaluate_slab, tasks, total, store, options.workers, console)
    rows = [row for row in store.rows if row.suite in options.slabs and row.index < options.clips]
    return finish_slabs([row for row in rows if row.estimator in estimators], options.output, console, status)


def _append_all(
    work: Callable[[Any], list[Any]],
    tasks: Sequence[Any],
    total: int,
    store: RecoveryStore,
    workers: int,
    console: Console,
) -> int:
    """Do tasks and keep their results as they come; returns the exit status."""
    try:
        with progress_bars(console) as progress:
            bar = progress.add_task("clips", total=total, completed=total - len(tasks))
            for rows in run_tasks(work, tasks, workers):
                store.append(rows)
                progress.advance(bar)
    except KeyboardInterrupt:
        say(console, "Interrupted; finished clips are kept, and the same command continues.", "yellow")
        return INTERRUPTED
    except (OutputError, WorkerLost) as error:
        say(console, f"{error} Finished clips are kept.", "red")
        return 1
    return 0


def measure(
    options: argparse.Namespace,
    estimators: Mapping[str, EstimatorOptions],
    left: set[tuple[str, int, str]],
    store: RecoveryStore,
    console: Console,
) -> None:
    """Do what is left: suite, clip and estimator of every result that is missing."""
    candidates: dict[str, Candidate] = {**estimators}
    with progress_bars(console) as progress:
        if any(name == CONSTANT for _, _, name in left):
            candidates[CONSTANT] = constant_estimate(options.split, options.seed, options.workers, progress)
        tasks = []
        for index in sorted({index for _, index, _ in left}):
            wanted = {
                suite: {name: candidates[name] for name in options.estimator if (suite, index, name) in left}
                for suite in options.suite
            }
            seed = suite_clip_seed(options.split, options.seed, index)
            tasks.append(ClipTask(index, seed, wanted, options.seen, options.size, options.contact))
        bar = progress.add_task("clips", total=options.clips, completed=options.clips - len(tasks))
        for rows in run_tasks(evaluate_clip, tasks, options.workers):
            store.append(rows)
            progress.advance(bar)


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark that the command line asks for; returns the exit status."""
    console, options = Console(stderr=True), parse(arguments)
    status = run_grips(options, console) if options.grips else 0
    status = status or (run_slabs(options, console) if options.slabs else 0)
    return status or (run_presses(options, console) if options.suite else 0)


def run_presses(options: argparse.Namespace, console: Console) -> int:
    """Do what is left of the suites of presses, and write their tables; returns the exit status."""
    estimators = estimators_of(options)
    try:
        store = open_store(options, estimators)
    except (ModelFileError, OutputError) as error:
        say(console, str(error), "red")
        return 2
    if store.outdated:
        text = "Results of another version of the program are kept; give another --output to measure this one."
        say(console, text, "yellow")
    asked = set(itertools.product(options.suite, range(options.clips), options.estimator))
    status = 0
    try:
        with interruptible():
            measure(options, estimators, asked - store.done, store, console)
    except KeyboardInterrupt:
        say(console, "Interrupted; finished clips are kept, and the same command continues.", "yellow")
        status = INTERRUPTED
    except (OutputError, WorkerLost) as error:
        say(console, f"{error} Finished clips are kept.", "red")
        status = 1
    places = list(SUITES)
    rows = [row for row in store.rows if row.key in asked]
    rows.sort(key=lambda row: (NAMES.index(row.estimator), places.index(row.suite), row.index))
    return finish(rows, options.output, console, status, Bound(options.bound, options.onset))


if __name__ == "__main__":
    run_door(main)
