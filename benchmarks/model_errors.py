"""Measures on drawn clips what the fits' own models get wrong, and writes `estimators/model_errors.yaml`.

    python -m benchmarks.model_errors --part pull --clips 24 --seed 9201

The sessions that users run are asked of clips of the validation split, and what they are off by is compared with what
their residuals tell: the rest is the model's. Of every entry of the file that a part measures, `measured` then says the
root mean square errors and what residuals tell of them (clips weighted as the most likely variance of the model weighs
them), the standard deviation of the model that follows, from how many clips, and by which command. Fewer than 20 clips
leave `value`, by which the estimators go, as it is. The part pull takes the suites retraction, foundation and regions;
video takes presses in RGB videos, facing and oblique (`benchmarks.plain_video`, fifteen seconds a clip), in turns by
either law of light.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from rich.console import Console

from benchmarks.harness import Row
from benchmarks.plain_video import PlainVideo, measured_video
from benchmarks.recovery.suites import LARGEST_SEED, suite_clip_seed
from benchmarks.recovery.trial import Trial, run_trial
from palpate.common.command_line import progress_bars, say
from palpate.common.files import replacing
from palpate.common.options import options, require_within
from palpate.common.settings import LARGEST
from palpate.estimators.estimate import LEAST_SKILL
from palpate.estimators.grip.grip_estimate import force_error
from palpate.estimators.model_errors import FILE, read_entries
from palpate.estimators.open import EstimatorOptions
from palpate.models.calibration_fit import mean_squares

SPLIT = "validation"
VIDEO = "video"
PARTS = {"pull": ("retraction", "foundation", "regions"), VIDEO: (VIDEO, "video-oblique")}
"""Suites of every part."""
DIRECT = "direct"
LOOKS: tuple[Literal["matte", "endoscope"], ...] = ("matte", "endoscope")
"""By which laws plain videos are drawn, in turns."""
ENDS = "error", "sd", "model_sd"
"""What a plain video's row has of a quantity."""
ENOUGH = 20
"""So many clips change a value: a standard deviation is then known to a sixth."""
HEAD = (
    "# What a fit's own model gets wrong: standard deviations, of natural logarithms where nothing else is said, and\n"
    "# the thresholds that go with them. `python -m benchmarks.model_errors` measures them and writes this file.\n"
)

Errors = dict[str, list[tuple[float, float]]]
"""By entry: errors of the clips, and the variances that their residuals tell."""
Entries = dict[str, dict[str, Any]]
"""Of the file, by name."""


def model_sd(off: float, residual: float) -> float:
    """Standard deviation that is left of root mean square errors where residuals tell some, to two digits."""
    left = math.sqrt(max(off**2 - residual**2, 0.0))
    return float(f"{left:.2g}")


def pull_errors(rows: Sequence[Row], values: Mapping[str, float]) -> Errors:
    """Errors of the relative force of pulls, and what residuals tell of them.

    Args:
        rows: of clips.
        values: standard deviations that the estimates counted, by entry.
    """
    found: Errors = {}
    for row in rows:
        if "curve" in row and row["skill"] >= LEAST_SKILL:
            # The last frame's ratio is 1 by definition.
            true, force, sd = row["curve"][:, :-1]
            share = np.square(force_error(force, row["skill"])).sum()
            stated = np.square(sd).sum() / share - values["pull_force"] ** 2
            error = math.sqrt(np.square(force - true).sum() / share)
            found.setdefault("pull_force", []).append((error, max(float(stated), 0.0)))
    return found


def video_errors(rows: Sequence[Row], values: Mapping[str, float]) -> Errors:
    """Errors of k_s and of both ratios of presses in RGB videos; arguments as of `pull_errors`.

    A fit takes its model's errors to be larger where it leaves more of the light's change and residuals are correlated
    (`estimators.direct.shading_fit`); by that factor errors are divided.
    """
    known, found = [row for row in rows if row.get("explained")], {}
    quantities = {"damping": "damping_over_stiffness", "force": "force_over_stiffness", "scale": "stiffness"}
    for kind, quantity in quantities.items() if known else ():
        error, sd, counted = np.array([[row[f"{quantity}_{end}"] for end in ENDS] for row in known]).T
        factor = counted / values[f"shading_{kind}"]
        found[f"shading_{kind}"] = list(zip(error / factor, (sd**2 - counted**2) / factor**2, strict=True))
    return found


def updated(entries: Entries, errors: Errors, command: str, date: str) -> Entries:
    """Entries with what was measured; their values are that where enough clips were."""
    found = {name: dict(entry) for name, entry in entries.items()}
    for name, pairs in errors.items():
        errors_of, variances = np.transpose(pairs)
        off, stated = (float(f"{math.sqrt(mean):.3g}") for mean in mean_squares(errors_of, variances))
        measured = {"off": off, "stated": stated, "sd": model_sd(off, stated), "clips": len(pairs)}
        found[name]["measured"] = measured | {"command": command, "date": date}
        if len(pairs) >= ENOUGH:
            found[name] |= {"value": measured["sd"], "source": "measured"}
    return found


def write_entries(path: Path, entries: Entries) -> None:
    """Write the file."""
    with replacing(path) as partial:
        text = yaml.safe_dump(entries, sort_keys=False, width=110, allow_unicode=True)
        partial.write_text(HEAD + text, encoding="utf-8")


@dataclass(frozen=True)
class ModelErrors:
    """What is measured."""

    part: Literal["pull", "video"]
    """whose errors"""
    seed: int
    """of the clips"""
    clips: int = 24
    """clips of each suite"""
    output: Path = FILE
    """the file (default: that of the estimators)"""

    def __post_init__(self) -> None:
        """Raise a ValueError where an option can't be used."""
        require_within(self, seed=(0, LARGEST_SEED), clips=(1, LARGEST))

    @property
    def wanted(self) -> list[tuple[str, int]]:
        """Suites and numbers of the clips."""
        return [(suite, index) for suite in PARTS[self.part] for index in range(self.clips)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure a part; returns the exit status."""
    asked: ModelErrors = options(ModelErrors, arguments, "benchmarks.model_errors", __doc__)
    console = Console(stderr=True)
    entries = read_entries(asked.output if asked.output.exists() else FILE)
    values = {name: float(entry["value"]) for name, entry in read_entries().items()}
    rows: list[Row] = []
    with progress_bars(console) as progress:
        bar = progress.add_task("clips", total=len(asked.wanted))
        for suite, index in asked.wanted:
            seed = suite_clip_seed(SPLIT, asked.seed, index)
            if asked.part == VIDEO:
                drawn = PlainVideo(asked.output, suite=suite, look=LOOKS[index % len(LOOKS)])
                rows.append(measured_video(drawn.settings, seed))
            else:
                rows += run_trial(Trial(index, seed, {suite: {DIRECT: EstimatorOptions(DIRECT, threads=1)}}))
            progress.advance(bar)
    errors = {"pull": pull_errors, VIDEO: video_errors}[asked.part](rows, values)
    if not errors:
        say(console, "No clip has an estimate that could be compared; give other seeds, or more clips.", "red")
        return 1
    command = f"python -m benchmarks.model_errors --part {asked.part} --clips {asked.clips} --seed {asked.seed}"
    write_entries(asked.output, updated(entries, errors, command, datetime.date.today().isoformat()))
    for name, pairs in errors.items():
        say(console, f"{name}: {len(pairs)} clips")
    say(console, f"written: {asked.output}")
    return 0


if __name__ == "__main__":
    run_door(main)
