"""The online estimator on four simulated pulls: Table II of Liang 2024.

    python -m benchmarks.online --output OUT [--sequences thin-shell-1 …] [--starts k1 k2 k3] [--methods PBD …]
        [--match tracks] [--optimizer gauss-newton] [--frames N] [--particles 600] [--points 9000] [--every 10]

Truth is another integrator's on another mesh (benchmarks/online/sequences.py). Each sequence, start and method is a
line of results.jsonl: an interrupted run goes on, and a run of some adds to those that are there. Writes table.csv
(sequence, start, method, measure, value) and table_2.csv of all that were asked for. A small run: --sequences
thin-shell-1 --starts k1 --frames 30 --particles 150 --points 1000.
"""

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, get_args

import pandas as pd

from benchmarks.harness import Experiment, Report, Row, run
from benchmarks.online.compare import BATCH, HORIZON, METHODS, STARTS, Key, Optimizer, run_case, table
from benchmarks.online.sequences import SEQUENCES, Pull
from palpate.common.doors import run_door
from palpate.common.settings import LARGEST

STEP = "step on one core [s]"
SequenceName = Literal["thin-shell-1", "thin-shell-2", "volume-1", "volume-2"]
Start = Literal["k1", "k2", "k3"]


@functools.lru_cache(maxsize=len(SEQUENCES))
def pull_of(sequence: str, particles: int, points: int, frames: int) -> Pull:
    """A sequence's pull, simulated once a process."""
    return SEQUENCES[sequence].pull(particles, points, frames)


def follow(case: "tuple[Online, Key]") -> list[Row]:
    """The row of one method from one start on a sequence."""
    asked, (sequence, start, method) = case
    pull = pull_of(sequence, asked.particles, asked.points, asked.frames_of[sequence])
    found = run_case(pull, STARTS[start], method, asked.match, asked.every, asked.optimizer)
    return [{"sequence": sequence, "start": start, "method": method, **found}]


@dataclass(frozen=True)
class Online(Experiment):
    """Cases to run."""

    sequences: tuple[SequenceName, ...] = get_args(SequenceName)
    """which"""
    starts: tuple[Start, ...] = get_args(Start)
    """stiffness to begin with"""
    methods: tuple[Literal["PBD", "PBD-DiffCloud", "PBD-RM", "PBD-RM-ON"], ...] = METHODS
    """which; PBD-DiffCloud on sheets alone"""
    match: Literal["chamfer", "tracks", "both"] = "tracks"
    """observations of a frame (the paper: chamfer)"""
    optimizer: Optimizer = "gauss-newton"
    """of PBD-RM-ON (the paper: adam)"""
    frames: Annotated[int, HORIZON + 2, LARGEST] | None = None
    """of each sequence, from its beginning (default: all; 60, of thin-shell-2 100)"""
    particles: Annotated[int, 60, 10_000] = 600
    """about how many"""
    points: Annotated[int, 50, LARGEST] = 9000
    """of a cloud"""
    every: Annotated[int, 1, LARGEST] = 10
    """frames between predictions"""

    keys: ClassVar = ("sequence", "start", "method")
    work: ClassVar = staticmethod(follow)
    writes: ClassVar = ("table.csv", "table_2.csv")

    def __post_init__(self) -> None:
        """Raise a ValueError where options don't belong together."""
        # Of fewer no particle of a block lies where the gripper holds it.
        if self.particles < 68 and any(SEQUENCES[name].block for name in self.sequences):
            raise ValueError(f"--particles: {self.particles} is less than 68, and a block needs so many.")
        if (self.match, self.optimizer) == ("chamfer", "gauss-newton") and "PBD-RM-ON" in self.methods:
            raise ValueError("--match chamfer tells Gauss–Newton's steps nothing; give --optimizer adam, or both.")
        least = min(self.frames_of.values())
        if self.every + HORIZON > least - 1:
            problem = f"--every {self.every} leaves no prediction {HORIZON} frames ahead within {least} frames;"
            raise ValueError(f"{problem} give fewer or more --frames.")
        if not self.wanted:
            raise ValueError(f"{BATCH} runs on sheets alone, as in the paper; give other --sequences or --methods.")

    @property
    def frames_of(self) -> dict[str, int]:
        """Frames of each sequence."""
        return {name: min(SEQUENCES[name].frames, self.frames or SEQUENCES[name].frames) for name in self.sequences}

    @property
    def wanted(self) -> list[Key]:
        """Sequences, starts and methods."""
        every = itertools.product(self.sequences, self.starts, self.methods)
        return [key for key in every if key[2] != BATCH or not SEQUENCES[key[0]].block]

    def record(self) -> Mapping[str, Any]:
        """Everything that the results depend on."""
        names = ("match", "optimizer", "particles", "points", "every")
        found = {name: getattr(self, name) for name in names}
        return found | {f"frames of {name}": count for name, count in self.frames_of.items()}

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """Every measure, and Table II."""
        cases = {key: rows[key] for key in self.wanted if key in rows}
        cells = []
        distances = {"future gap [mm]": "gap", "keypoint error [mm]": "keypoint", "Chamfer distance [mm]": "chamfer"}
        for key, case in cases.items():
            cells += [(*key, text, 1e3 * float(case[name].mean())) for text, name in distances.items()]
            cells += [(*key, "rank correlation of distances", case.get("rank")), (*key, STEP, case["seconds"])]
        frame, gaps = pd.DataFrame(cells, columns=(*self.keys, "measure", "value")), table(cases)
        steps = frame[frame["measure"] == STEP].pivot_table("value", "method", "sequence", "median").reset_index()
        matched = f"Matched: {self.match}; {self.optimizer}."
        return Report({"table.csv": frame, "table_2.csv": gaps}, [gaps, steps], [(matched, "")])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the missing cases, and draw all of them; returns the exit status."""
    return run(Online, arguments, "benchmarks.online", __doc__)


if __name__ == "__main__":
    run_door(main)
