"""Alarms at a limit of force on drawn presses with depth, whose force is known: how many are false, how many missing?

    python -m tests.results.drawn_alarms --presses 100 --seed 775001

Half of the presses are of suite `clean`, half of `noisy`; the network is the shipped one. An alarm is false where the
press's force lies under the limit. Missed is a frame whose force is determined and lies over the limit by more than
its interval reaches, without an alarm.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.common.options import options, require_within
from palpate.common.tables import to_markdown
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.estimators.contract import ClipInfo
from palpate.estimators.network.estimator import NetworkEstimator
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of
from palpate.evaluation.recovery.suites import EVERY, GRID_SIZE, suite_clip_seed
from palpate.results.alarm import ABOVE, BELOW, UNKNOWN, ForceAlarm, known_seconds, upper_force

LIMITS = 0.03, 0.055, 0.1, 0.15, 0.2
"""[scene units]; forces are 0.03 to 0.15."""
SUITES = "clean", "noisy"


@dataclass(frozen=True)
class Options:
    """Of the command."""

    presses: int = 20
    """How many are drawn."""
    seed: int = 775001
    """Of the benchmark's clips."""

    def __post_init__(self) -> None:
        require_within(self, presses=(2, 10_000), seed=(0, 2**31))


@dataclass
class Tally:
    """Of the presses of a limit."""

    frames: Counter[str] = field(default_factory=Counter)
    """In contact, by state."""
    over: int = 0
    """Determined frames whose force lies over the limit by more than the interval."""
    missed: int = 0
    """Of these, those without an alarm."""
    false: list[float] = field(default_factory=list)
    """Upper end over the force where a press under the limit raised an alarm."""
    first: int = 0
    """How many of these alarms came with a press's first determined frame."""
    under_s: float = 0.0
    """Length of the clips whose press lies under the limit [s]."""


def watch(tally: Tally, alarm: ForceAlarm, output: list[FrameEstimate | InteractionEstimate], force: float) -> None:
    """Go through a clip's frames."""
    determined = 0
    for item in output:
        if isinstance(item, InteractionEstimate):
            alarm.end_run()
            continue
        upper = None if item.estimate is None else upper_force(item.estimate)
        before = alarm.alarms
        state = alarm.push(item.time_s, item.contact, upper)
        if state:
            tally.frames[state] += 1
        if state in (ABOVE, BELOW) and upper is not None and item.estimate is not None:
            determined += 1
            wide = upper / abs(float(item.estimate.theta[2]))
            over = force > alarm.limit * wide
            tally.over += over
            tally.missed += over and state == BELOW
            if alarm.alarms > before and force < alarm.limit:
                tally.false.append(upper / force)
                tally.first += determined == 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge; returns the exit status."""
    chosen = options(Options, arguments, "tests.results.drawn_alarms", __doc__)
    estimator = open_estimator(EstimatorOptions("network", threads=1))
    assert isinstance(estimator, NetworkEstimator)
    tallies = {(suite, limit): Tally() for suite in SUITES for limit in LIMITS}
    seconds, forces = known_seconds(estimator)[0], []
    for index in range(chosen.presses):
        suite = SUITES[index % len(SUITES)]
        settings = EVERY[suite].settings(index // len(SUITES), GRID_SIZE)
        seed = suite_clip_seed("test", chosen.seed, index)
        scene, motion = draw_truth(settings, seed)
        clip = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
        info = ClipInfo.of(clip)
        output = list(estimates_of(estimator.start(info), clip))
        force, last = abs(float(motion.theta[2])), settings.frames / info.fps
        forces.append(force)
        for limit in LIMITS:
            tally = tallies[suite, limit]
            watch(tally, ForceAlarm(limit, "scene units", seconds, 1 / info.fps), output, force)
            tally.under_s += last * (force < limit)
    rows = []
    for (suite, limit), tally in tallies.items():
        a_minute = f"{60 * len(tally.false) / tally.under_s:.1f}" if tally.under_s else ""
        wide = f"{np.median(tally.false):.2f}" if tally.false else ""
        unknown = tally.frames[UNKNOWN] / max(tally.frames.total(), 1)
        numbers = f"{tally.missed} of {tally.over}", f"{len(tally.false)}", a_minute, f"{tally.first}", wide
        rows.append((suite, f"{limit:g}", *numbers, f"{unknown:.0%}"))
    print(f"{chosen.presses} presses, forces of {min(forces):.3f} to {max(forces):.3f}\n")
    false = "false alarms", "a minute under the limit", "in the first determined frame"
    heads = "suite", "limit", "frames missed", *false, "upper end over the force there", "frames in contact unknown"
    print(to_markdown(heads, rows))
    return 0


if __name__ == "__main__":
    run_door(main)
