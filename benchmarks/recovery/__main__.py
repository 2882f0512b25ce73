"""Recovery of θ on synthetic clips with known truth, against the best that is possible.

    python -m benchmarks.recovery --suite clean --estimator direct --clips 60 --seed 0 --output runs/benchmark

Clips are made in memory and thrown away. Results are appended to DIR/results.jsonl as they come; the same command
continues an interrupted run, and a later one may add suites, estimators or clips. Writes table.csv. A clip that can't
be estimated is counted and shown. In table.csv constant_rmse_log is the error of the best constant for exactly the
clips of a row: nothing that ignores its input can do better.

Suites of grips show tissue that a tool holds and moves, at 854x480. Only direct estimates them; grips.csv has its
results (see `benchmarks.recovery.grips`).

suites:
"""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from benchmarks.harness import OK, Experiment, Report, Row, run
from benchmarks.recovery.grips import grip_table
from benchmarks.recovery.scores import score_all, table
from benchmarks.recovery.suites import EVERY, GRID_SIZE, SUITES, suite_clip_seed
from benchmarks.recovery.trial import Trial, opened, run_trial
from palpate.common.command_line import size_of
from palpate.common.doors import run_door
from palpate.common.options import option
from palpate.common.settings import LARGEST
from palpate.data.depth.normalise import MOST_THREADS
from palpate.estimators.open import settings_of

Name = Literal["direct", "gan", "network"]
"""Estimators in the order of tables."""


@dataclass(frozen=True)
class Benchmark(Experiment):
    """Options of the benchmark."""

    suite: tuple[str, ...] = option(("clean",), choices=lambda: (*EVERY, "all"))
    """suites, or all of presses"""
    estimator: tuple[Name, ...] = ("direct",)
    """direct, gan or network, one or more"""
    model: Path | None = None
    """ONNX file of the estimator network"""
    gan_model: Path | None = None
    """ONNX file of the estimator gan: one estimate a frame"""
    clips: Annotated[int, 1, LARGEST] = 60
    """clips of each suite, a third a regime"""
    seed: Annotated[int, 0, 2**32 - 1] = 0
    """another seed gives other clips"""
    split: Literal["training", "validation", "test"] = "test"
    """stream of seeds"""
    seen: Literal["press"] | None = None
    """only the frames in contact are observed (default: one second)"""
    onset: Literal["stamp", "between"] = "stamp"
    """assumed begin of a press, by direct, network and the Cramér–Rao bound: at a frame's stamp (as in most suites) or
    between two"""
    size: str = "214x120"
    """width and height of the pictures; 854x480 is CholecSeg8k's"""
    workers: Annotated[int, 0, MOST_THREADS] = 2
    """processes; 0 = in this one"""

    keys: ClassVar = ("suite", "index", "estimator")
    work: ClassVar = staticmethod(run_trial)
    writes: ClassVar = ("table.csv", "grips.csv")

    def __post_init__(self) -> None:
        """Raise a ValueError where an option can't be used, or options don't belong together."""
        if not all(least <= side <= 4096 for side, least in zip(self.pixels, GRID_SIZE, strict=True)):
            problem = f"--size {self.size} is no size of pictures; give WIDTHxHEIGHT from"
            raise ValueError(f"{problem} {'x'.join(map(str, GRID_SIZE))} up, 4096 px a side at most.")
        if self.seen is not None and "gan" in self.estimator:
            raise ValueError("--seen is of no use to gan, which sees single frames; leave one of the two out.")
        for name, flag, given in (("network", "--model", self.model), ("gan", "--gan-model", self.gan_model)):
            if name in self.estimator and given is None:
                raise ValueError(f"--estimator {name} needs a network; give its file as {flag} FILE.")
            if name not in self.estimator and given is not None:
                raise ValueError(f"{flag} {given} is of no use without --estimator {name}; add that or leave it out.")

    @property
    def suites(self) -> list[str]:
        """Suites, each once, in the order of tables."""
        return [name for name in EVERY if name in self.suite or ("all" in self.suite and name in SUITES)]

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height of the pictures; 0 if --size is none."""
        return size_of(self.size) or (0, 0)

    @property
    def estimators(self) -> dict[str, Any]:
        """Compared estimators by name, in the order of tables."""
        press = {"onset": self.onset, "horizon": self.seen}
        known: dict[str, dict[str, Any]] = {"direct": press, "gan": {"model": self.gan_model, "threads": 1}}
        known["network"] = {"model": self.model, "threads": 1, **press}
        return {name: settings_of(name, **known[name]) for name in get_args(Name) if name in self.estimator}

    def record(self) -> Mapping[str, Any]:
        """Record of everything the results depend on."""
        found: dict[str, Any] = {"seed": self.seed, "split": self.split, "seen": self.seen, "size": list(self.pixels)}
        decisive = ("errors", "truth", "turns")
        found |= {f"suite {name}": {part: getattr(EVERY[name], part) for part in decisive} for name in self.suites}
        for name, settings in self.estimators.items():
            network, onset = getattr(opened(settings), "model", None), getattr(settings, "onset", None)
            found[f"estimator {name}"] = {"model_sha256": getattr(network, "sha256", ""), "onset": onset}
        return found

    def asked(self, suite: str, index: int) -> list[str]:
        """Estimators of a clip: of a grip, the one that fits grips."""
        if EVERY[suite].of == "grip":
            return ["direct"]
        return [name for name in get_args(Name) if name in self.estimator]

    @property
    def wanted(self) -> list[tuple[str, int, str]]:
        """Suite, clip and estimator of every requested result."""
        clips = itertools.product(range(self.clips), self.suites)
        return [(suite, index, name) for index, suite in clips for name in self.asked(suite, index)]

    def cases(self, done: Mapping[tuple, Row]) -> tuple[list[Trial], int]:
        """Presses of one clip together, as most suites show the same motion; all others one by one."""
        left = [key for key in self.wanted if key not in done]
        known = {"direct": settings_of("direct"), **self.estimators}

        def group(key: tuple[str, int, str]) -> tuple[int, str]:
            return key[1], "" if EVERY[key[0]].of == "press" else key[0]

        trials: dict[tuple[int, str], dict[str, dict[str, Any]]] = {}
        for key in left:
            trials.setdefault(group(key), {}).setdefault(key[0], {})[key[2]] = known[key[2]]
        seeds = {index: suite_clip_seed(self.split, self.seed, index) for index, _ in trials}
        rest = self.seen, self.pixels
        cases = [Trial(index, seeds[index], wanted, *rest) for (index, _), wanted in trials.items()]
        return cases, len({group(key) for key in self.wanted})

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """Tables of presses and of grips."""
        order = sorted(self.wanted, key=lambda key: (get_args(Name).index(key[2]), self.suites.index(key[0]), key[1]))
        found = [rows[key] for key in order if key in rows]
        presses, grips = ([row for row in found if EVERY[row["suite"]].of == of] for of in ("press", "grip"))
        judged = score_all(presses, self.onset)
        tables = {"table.csv": table(judged)} if judged else {}
        shown = [frame[frame["n"] > 0] for frame in tables.values()]
        if grips:
            tables["grips.csv"] = grip_table(grips)
            shown.append(tables["grips.csv"])
        lines: list[tuple[str, str]] = []
        for scores in judged:
            count = f"{len(scores.rows)} of {len(scores.rows) + len(scores.failed)} clips estimated"
            lines += [(f"{scores.estimator} on {scores.suite}: {count}", ""), *_failures(scores.failed)]
        lines += _failures(grips)
        failed = not found or (bool(presses) and not any(row["status"] == OK for row in presses))
        if failed:
            lines.append(("No clip could be estimated.", "red"))
        return Report(tables, shown, lines, failed=failed)


def _failures(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Lines on the first eight clips that were not estimated, and a count of all."""
    failed = [row for row in rows if row["status"] != OK]
    lines, most = [], 8
    for row in failed[:most]:
        clip = f"{row['suite']}, clip {row['index']} ({row.get('regime', row['action'])})"
        lines.append((f"  {clip}: {row['status']}, {row['reason']}", "yellow"))
    if len(failed) > most:
        lines.append((f"  {len(failed)} in all: {dict(Counter(row['status'] for row in failed))}", "yellow"))
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark that the command line asks for; returns the exit status."""
    suites = "\n".join(f"  {suite.name:12s}{suite.reason}" for suite in EVERY.values())
    return run(Benchmark, arguments, "benchmarks.recovery", f"{__doc__}{suites}")


if __name__ == "__main__":
    run_door(main)
