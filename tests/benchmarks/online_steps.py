"""What a frame takes of a robot's sequence in the online estimator: by followed points, clouds and both.

    python -m tests.benchmarks.online_steps

The pull thin-shell-1 of `evaluation.online`, 600 particles, 200 followed points, clouds of 9,000 points, settings as by
default: a sheet, and a volume 1 cm thick on the same clouds. A frame is everything from reading its cloud to the field
with its intervals. Processor time of all threads; the first frame, which loads compiled code,
does not count. Rounds of all cases follow each other, so that other jobs slow all of them.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import itertools
import os
import platform
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from unittest import mock

import numpy as np

from palpate.common.options import options, require_within
from palpate.common.tables import to_markdown
from palpate.data.source.sequence import open_sequence
from palpate.estimators.online.driven import Cloud
from palpate.estimators.online.sequence import SequenceTissue
from palpate.estimators.online.session import Frame, Method
from palpate.estimators.online.settings import OnlineSettings
from palpate.evaluation.online.sequences import SEQUENCES
from tests.sequences import write_sequence

POINTS = 9000
"""Of a cloud."""
BODIES = {"sheet": None, "volume": 0.01}
"""Thickness [m]."""
PAPER = {"sheet": 0.9, "volume": 2.6}
"""A step of Liang 2024, by clouds and Adam (section III-D) [s]."""
MATCHES = "points", "clouds", "both"


@dataclass(frozen=True)
class Options:
    """Of the command."""

    frames: int = 30
    """Of the pull, from its beginning."""
    particles: int = 600
    """About how many."""
    rounds: int = 2
    """Times that every case is run; the fastest round's median counts."""

    def __post_init__(self) -> None:
        require_within(self, frames=(3, 60), particles=(60, 10_000), rounds=(1, 100))


def seconds(path: Path, settings: OnlineSettings, clouds: bool) -> np.ndarray:
    """Processor time of every frame after the first, shape [T] [s].

    Args:
        path: sequence.yaml.
        settings: of the estimator.
        clouds: whether it gets them.
    """
    tissue = SequenceTissue(open_sequence(path), settings)
    step, spent, begun = tissue.driven.step, [], time.process_time()

    def taken(moved: np.ndarray, cloud: Cloud, led: np.ndarray) -> Frame:
        return step(moved, cloud if clouds else None, led)

    with mock.patch.object(tissue.driven, "step", taken):
        for _ in tissue.fields():
            spent.append(time.process_time() - begun)
            begun = time.process_time()
    return np.array(spent[1:])


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    chosen = options(Options, arguments, "tests.benchmarks.online_steps", __doc__)
    pull = SEQUENCES["thin-shell-1"].pull(chosen.particles, POINTS, chosen.frames)
    cases = list(itertools.product(BODIES, ("gauss-newton", "adam"), MATCHES))
    found: dict[tuple[str, str, str], list[tuple[float, float]]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory() as name:
        folder, still = Path(name), Path(name) / "without"
        both = write_sequence(folder, chosen.frames, drawn=pull)
        alone = write_sequence(still, chosen.frames, drawn=pull, points=None)
        for _ in range(chosen.rounds):
            for body, optimizer, match in cases:
                settings = OnlineSettings(
                    particles=chosen.particles,
                    thickness=BODIES[body],
                    method=Method(optimizer=optimizer),  # ty: ignore[invalid-argument-type]  one of its names
                )
                each = seconds(alone if match == "clouds" else both, settings, match != "points")
                found[body, optimizer, match].append((float(np.median(each)), float(each.max())))
    rows = []
    for body, optimizer, match in cases:
        median, longest = min(found[body, optimizer, match])
        ratios = median / min(found[body, "gauss-newton", "points"])[0], median / PAPER[body]
        numbers = f"{median:.3f}", f"{longest:.3f}", *(f"{ratio:.2f}" for ratio in ratios)
        rows.append((body, optimizer, match, *numbers))
    machine = f"{os.cpu_count()} cores {platform.machine()}, {date.today()}"
    print(f"A frame of about {chosen.particles} particles [s] ({machine})\n")
    over = "over points' by Gauss–Newton", "over the paper's 0.9 and 2.6 s"
    print(to_markdown(("body", "optimizer", "matched", "median", "longest", *over), rows))
    return 0


if __name__ == "__main__":
    run_door(main)
