"""False alarms against missed crossings of `--force-limit` by its threshold, on synthetic presses with depth.

    python -m benchmarks.alarm --output runs/alarm

Presses of the suites clean and noisy, of forces of 0.03 to 0.3, by the network that ships. Writes alarm.csv and its
figure.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.harness import show
from benchmarks.recovery.suites import EVERY, GRID_SIZE, suite_clip_seed
from palpate.common.options import options
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.contract import ClipInfo
from palpate.estimators.open import open_estimator
from palpate.estimators.records import FrameEstimate
from palpate.estimators.session import estimates_of
from palpate.results.alarm import ForceAlarm


@dataclass(frozen=True)
class Alarms:
    """Options of the benchmark."""

    output: Path
    """folder of table and figure"""
    clips: Annotated[int, 1, 10_000] = 12
    """presses of each suite"""


def presses(clips: int) -> Iterator[tuple[float, list[FrameEstimate]]]:
    """Yield the true magnitude of every press [scene units], and its frames' estimates."""
    estimator = open_estimator("network", threads=1)
    for suite in ("clean", "noisy"):
        for index in range(clips):
            settings, seed = EVERY[suite].settings(index, GRID_SIZE), suite_clip_seed("validation", 65, index)
            scene, motion = draw_truth(settings, seed)
            assert isinstance(motion, PressedMotion)
            clip = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
            output = estimates_of(estimator.start(ClipInfo.of(clip)), clip)
            yield abs(float(motion.theta[2])), [item for item in output if isinstance(item, FrameEstimate)]


def curve(found: list[tuple[float, list[FrameEstimate]]]) -> pd.DataFrame:
    """False alarms a minute under the limit, and the share of presses above it without an alarm."""
    rows, limits = [], (0.05, 0.1, 0.15)  # of the force [scene units]
    for limit, raised in itertools.product(limits, (0.05, 0.2, 0.5, 0.8, 0.9, 0.95, 0.99)):  # thresholds of probability
        minutes, alarms, missed = 0.0, 0, []
        for force, frames in found:
            alarm = ForceAlarm(limit, "", math.inf, raised, min(raised, 0.5))
            for frame in frames:
                alarm.watch(frame)
            if force < limit:
                minutes, alarms = minutes + (frames[-1].time_s - frames[0].time_s) / 60, alarms + alarm.alarms
            else:
                missed.append(alarm.alarms == 0)
        rows.append((limit, raised, alarms / minutes if minutes else np.nan, np.mean(missed) if missed else np.nan))
    return pd.DataFrame(rows, columns=("limit", "raised", "false alarms a minute", "missed crossings"))


def main(arguments: list[str] | None = None) -> int:
    """Write the curve; returns the exit status."""
    asked: Alarms = options(Alarms, arguments, "benchmarks.alarm", __doc__)
    table = curve(list(presses(asked.clips)))
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for limit, part in table.dropna().groupby("limit"):  # those with presses on both sides
        axes.plot(part["false alarms a minute"], 100 * part["missed crossings"], "o-", label=f"limit {limit:g}")
    axes.axvline(1.0, color="0.5", linestyle=":")
    axes.set(xlabel="false alarms a minute under the limit", ylabel="missed crossings [%]", xscale="symlog")
    axes.legend()
    asked.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(asked.output / "alarm.csv", index=False)
    figure.savefig(asked.output / "alarm.png", dpi=120)
    show(table)
    return 0


if __name__ == "__main__":
    run_door(main)
