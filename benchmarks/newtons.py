"""Forces in newtons of synthetic clips, of which the force of one is known, through infer.py --calibration.

    python -m benchmarks.newtons --clips DIR --output OUT [--known NAME] [--onset stamp|between]

DIR holds clips of data.synthetic, whose truth is taken to be 25 N a unit of force; the known force is off by a draw of
2 %. Runs infer.py into OUT/results, and writes table.csv (file, measure, value): how far the forces of the other clips
are off in calibrated.csv, and whether their 90 % intervals hold.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from rich.console import Console

from palpate.command import infer
from palpate.common.command_line import say
from palpate.common.files import all_below
from palpate.common.output import replacing_own, require_own
from palpate.data.source.layout import InputError, read_mapping
from palpate.evaluation.harness import Report, Row, by_measure, show, write
from palpate.evaluation.options import options
from palpate.results.store import CALIBRATED, OutputError, writing

NEWTONS = 25.0
"""A unit of force."""
MEASURED = 0.02
"""Standard deviation of the logarithm of a measured force."""
NEAR = 0.2
"""Error of a force that is wanted, where it is determined."""
INTO = 0.25
"""Of the press, at which its force is known."""


@dataclass(frozen=True)
class Truth:
    """Of a clip."""

    folder: Path
    force: float
    """[N]."""
    known_time: float
    """A time within the press [s]."""


@dataclass(frozen=True)
class Newtons:
    """What is judged."""

    clips: Path
    """folder of clips of data.synthetic"""
    output: Path
    """folder of the results"""
    known: str | None = None
    """clip whose force is known (default: the first)"""
    onset: Literal["stamp", "between"] = "stamp"
    """as of infer.py"""

    def __post_init__(self) -> None:
        """Raise a ValueError where too few clips can be judged."""
        truths = read_truths(self.clips)
        if len(truths) < 3 or (self.known or next(iter(truths))) not in truths:
            raise ValueError(
                f"{self.clips} holds {len(truths)} presses with truth, or not '{self.known}'; give three or more."
            )


def main(arguments: list[str] | None = None) -> int:
    """Run infer.py on the clips and judge it; returns the exit status."""
    asked: Newtons = options(Newtons, arguments, "benchmarks.newtons", __doc__)
    console, truths = Console(stderr=True), read_truths(asked.clips)
    name = asked.known or next(iter(truths))
    try:
        with writing(asked.output):
            require_own(asked.output / "table.csv")
        path = _write_known(asked.output, truths[name])
        folders = [str(truth.folder) for truth in truths.values()]
        given = ["--output", str(asked.output / "results"), "--onset", asked.onset, "--masks", "annotation"]
        status = infer.main([*folders, *given, "--no-overlay", "--calibration", str(path)])
        if status not in (0, 1):
            return status
        frame = by_measure(judge(asked.output / "results", truths, name), "file")
        write(asked.output, Report({"table.csv": frame}))
    except (InputError, OutputError) as error:
        say(console, str(error), "red")
        return 1
    show(frame)
    return status


def read_truths(folder: Path) -> dict[str, Truth]:
    """Presses under a folder by their clips' names, in order."""
    found = {}
    for path in sorted(all_below(folder)) if folder.is_dir() else []:
        if path.name == "truth.json":
            truth = read_mapping(path, "a synthetic clip's truth")
            if truth.get("action") == "press" and "theta" in truth:
                middle = (1 - INTO) * truth["onset_s"] + INTO * truth["release_s"]
                force = NEWTONS * abs(truth["theta"]["force"])
                found[path.parent.name] = Truth(path.parent, force, middle)
    return found


def measured_force(truth: Truth) -> float:
    """What a sensor that is off by MEASURED says [N]; the same whenever it is asked."""
    draw = np.random.default_rng(round(1e6 * truth.force)).normal()
    return truth.force * math.exp(MEASURED * draw)


def _write_known(output: Path, truth: Truth) -> Path:
    force = measured_force(truth)
    known = {
        "clip": truth.folder.name,
        "force_N": force,
        "force_sd_N": MEASURED * force,
        "force_time_s": truth.known_time,
    }
    with writing(output):
        output.mkdir(parents=True, exist_ok=True)
        with replacing_own(output / "calibration.yaml") as partial:
            partial.write_text(yaml.safe_dump(known), encoding="utf-8")
    return output / "calibration.yaml"


def judge(results: Path, truths: dict[str, Truth], known: str) -> list[Row]:
    """What calibrated.csv is worth: every other clip's force, and all of them together."""
    found: list[Row] = []
    errors, insides, sures = [], [], []
    for name, truth in truths.items():
        row = _row(results / name / CALIBRATED)
        if name == known or row is None or not row["force"]:
            continue
        value, low, high = (float(row[f"force{end}"]) for end in ("", "_low", "_high"))
        errors.append(value / truth.force - 1)
        insides.append(low <= truth.force <= high)
        sures.append("force" in row["determined"].split(";"))
        measures = {"force / truth - 1": errors[-1], "within the 90 % interval": insides[-1]}
        found.append({"file": name, **measures, "determined": sures[-1]})
    error, inside, sure = np.abs(errors), np.array(insides), np.array(sures, bool)
    summary: Row = {"forces": len(error), "determined": int(sure.sum())}
    if sure.any():
        summary |= {
            "determined: median error": float(np.median(error[sure])),
            f"determined: within {NEAR:.0%}": float((error[sure] < NEAR).mean()),
            "determined: 90 % intervals hold": float(inside[sure].mean()),
        }
    if len(error):
        summary["all: 90 % intervals hold"] = float(inside.mean())
    return [*found, {"file": f"others, the force of {known} known", **summary}]


def _row(path: Path) -> dict[str, str] | None:
    """The one run of contact of a clip's table."""
    if not path.is_file():
        return None
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return rows[0] if len(rows) == 1 else None


if __name__ == "__main__":
    run_door(main)
