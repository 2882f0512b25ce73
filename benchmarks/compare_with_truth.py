"""Estimates of synthetic clips compared with their truth, as a table a clip.

    python -m benchmarks.compare_with_truth --results FOLDER [FOLDER …]

Folders are results of `palpate infer` on frame folders of `python -m data.synthetic`, or on their video files. Exit
status: 0 all shown; 1 some are of no such clip, or have no estimate of its run of contact; 2 wrong usage.
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from benchmarks.harness import show
from palpate.common.command_line import say
from palpate.common.doors import plain, run_door
from palpate.common.files import read_file
from palpate.common.options import options
from palpate.data.source.table import MOST_BYTES, reason
from palpate.estimators.estimate import COMBINATIONS, REPORTED, SYMBOLS
from palpate.physics.mechanics import PARAMETERS
from palpate.results.store import INTERACTIONS, RECORD


class NoTruth(ValueError):
    """Error: results can't be compared with the truth; the message is a sentence."""


def read_results(folder: Path) -> tuple[str, dict[str, str], dict[str, float]]:
    """Return a clip's name, the row of `interactions.csv` of its true run of contact, and its true values.

    Raises:
        NoTruth: the folder holds no results of a synthetic clip, or these lack that run.
    """
    try:
        record = json.loads(read_file(folder / RECORD, MOST_BYTES))
        clip, fps = Path(record["input"]["path"]), float(record["input"]["fps"])
        text = io.StringIO(read_file(folder / INTERACTIONS, MOST_BYTES).decode("utf-8"), newline="")
        rows = list(csv.DictReader(text))
        truth = json.loads(read_file((clip if clip.is_dir() else clip.with_suffix("")) / "truth.json", MOST_BYTES))
        theta, onset = np.abs([float(truth["theta"][name]) for name in PARAMETERS]), float(truth["onset_s"])
        # A run of contact that begins within 1.5 frames of the true one is taken for it.
        begun = [row for row in rows if abs(float(row["onset_time_s"]) - onset) * fps <= 1.5]
    except (OSError, ValueError, KeyError, TypeError, RecursionError, csv.Error) as error:
        problem = f"holds no results of infer.py on a clip of data.synthetic ({reason(error)})"
        raise NoTruth(f"{folder} {problem}; give a clip's folder.") from error
    for row in begun:
        if row["status"] == "ok":
            return clip.name, row, {name: float(np.prod(theta ** np.array(COMBINATIONS[name]))) for name in REPORTED}
    why = " ".join(row["detail"] for row in begun or rows) or "No contact was found."
    raise NoTruth(f"{folder} has no estimate of the run of contact that truly begins at {onset:.2f} s. {why}")


def table_of(name: str, row: Mapping[str, str], truth: Mapping[str, float]) -> pd.DataFrame:
    """Table of quantities with estimate, interval and truth; without numbers where they aren't determined.

    A video alone gives lengths and forces in its own unit only: these aren't judged.
    """
    own_unit = () if Path(name).suffix == "" else ("force", "force_over_stiffness")  # what counts in lengths
    determined, lines = row["determined"].split(";"), []
    for quantity in REPORTED:
        estimate, low, high = (row.get(f"{quantity}{end}", "") for end in ("", "_low", "_high"))
        line: dict[str, object] = {"quantity": f"{quantity} {SYMBOLS[quantity]}", "truth": truth[quantity]}
        if not estimate or quantity not in determined:
            lines.append(line | {"estimate": "not determined"})
            continue
        line |= {"estimate": float(estimate)}
        if low and high:
            held = float(low) <= truth[quantity] <= float(high)
            judged = "in another unit" if quantity in own_unit else "held" if held else "missed"
            line |= {"low": float(low), "high": float(high), "90 % interval": judged}
        lines.append(line)
    return pd.DataFrame(lines, columns=("quantity", "estimate", "low", "high", "truth", "90 % interval"))


@dataclass(frozen=True)
class Compared:
    """Results and truth to compare."""

    results: tuple[Path, ...]
    """folders of palpate infer, one a clip"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; returns the exit status."""
    status = 0
    for folder in options(Compared, arguments, "benchmarks.compare_with_truth", __doc__).results:
        try:
            name, row, truth = read_results(folder)
        except NoTruth as error:
            say(Console(stderr=True), str(error), "red")
            status = 1
            continue
        print(plain(f"{name}: {row['verdict']}; normalised units, not N/m or N; damping over stiffness in s"))
        show(table_of(name, row, truth))
    return status


if __name__ == "__main__":
    run_door(main)
