"""What a step of the online estimator costs, beside the paper's, and by particles.

    python -m benchmarks.online [--match chamfer tracks both] [--optimizer adam]

A step is a frame of PBD-RM-ON: one time step and 30 steps of the mapping; beside it, by Adam, four snapshots stepped,
and the adjoint of all of it, by Gauss-Newton the simulations that are carried along, in two more threads. Medians over
frames. "longer thread" is the CPU time of that which has most to do; "wall" is what it took here.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import time
from collections.abc import Iterator, Sequence
from typing import Literal, get_args, get_type_hints

import numpy as np

from palpate.benchmarks.shared import command_line, machine, print_table
from palpate.estimators.online.objective import Objective
from palpate.estimators.online.session import SNAPSHOTS, Method, Session
from palpate.evaluation.online.sequences import SEQUENCES, Pull
from palpate.physics.pbd.stiffness import Stiffness

PAPER = {"thin-shell-1": 0.9, "volume-1": 2.6}
"""Seconds a step of sheets and blocks (Liang 2024, section III)."""
JUDGED, ALONG = 600, (300, 1200, 2500, 5000, 10_000)
"""Particles of the paper, and others."""
POINTS, FRAMES = 9000, 12
START = (1.0, 0.01)
MATCHES = ("chamfer", "tracks", "both")
OPTIMIZERS = get_args(get_type_hints(Method)["optimizer"])
COLUMNS = (
    "body",
    "particles",
    "constraints",
    "match",
    "CPU [ms]",
    "longer thread [ms]",
    "wall [ms]",
    "CPU a particle [µs]",
    "paper over longer thread",
    "over wall",
)


def costs(pull: Pull, match: str, optimizer: Literal["adam", "gauss-newton"] = "adam") -> np.ndarray:
    """CPU time, that of the longer thread and wall-clock time of a step with four snapshots, medians [s]."""
    beside = 1 if optimizer == "adam" else 2
    fields = Stiffness(*(np.full(pull.body.count, value) for value in START))
    session = Session(Objective(pull.body, pull.gripped), fields, Method(optimizer=optimizer))
    spent = []
    for frame, places in enumerate(pull.places):
        matches = pull.matches(frame, match)
        before = time.process_time(), time.thread_time(), time.perf_counter()
        session.step(places, matches)
        both, own, wall = np.subtract((time.process_time(), time.thread_time(), time.perf_counter()), before)
        if frame >= SNAPSHOTS:
            spent.append((both, max(own, (both - own) / beside), wall))
    return np.median(spent, axis=0)


def rows(
    matches: Sequence[str],
    along: Sequence[int] = ALONG,
    frames: int = FRAMES,
    optimizer: Literal["adam", "gauss-newton"] = "adam",
) -> Iterator[list[str]]:
    """A row for every kind of body and observation at the paper's size, then for sheets of other sizes."""
    sizes = [(name, JUDGED) for name in PAPER] + [("thin-shell-1", particles) for particles in along]
    for name, particles in sizes:
        pull = SEQUENCES[name].pull(particles, POINTS, frames)
        for match in matches:
            both, longer, wall = costs(pull, match, optimizer)
            yield [
                "block" if SEQUENCES[name].block else "sheet",
                str(pull.body.count),
                str(len(pull.body.layout.rest)),
                match,
                f"{1e3 * both:.0f}",
                f"{1e3 * longer:.0f}",
                f"{1e3 * wall:.0f}",
                f"{1e6 * both / pull.body.count:.0f}",
                f"{PAPER[name] / longer:.1f}" if particles == JUDGED else "",
                f"{PAPER[name] / wall:.1f}" if particles == JUDGED else "",
            ]


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = command_line(__doc__)
    parser.add_argument("--match", nargs="+", choices=MATCHES, default=list(MATCHES), help="what is seen")
    parser.add_argument("--optimizer", choices=OPTIMIZERS, default=OPTIMIZERS[0], help="what changes the stiffness")
    options = parser.parse_args(arguments)
    print(f"{machine()}; {POINTS} points\n")
    print_table(COLUMNS, rows(options.match, optimizer=options.optimizer))
    return 0


if __name__ == "__main__":
    run_door(main)
