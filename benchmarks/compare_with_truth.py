"""Estimates of synthetic clips compared with their truth, as a table a clip.

    python -m benchmarks.compare_with_truth RESULTS [RESULTS …]

RESULTS are folders that `infer.py` wrote, of frame folders that `python -m data.synthetic` drew, or of their video
files. Of several clips, a last table says how often forces.json and all 90 % intervals hold; newtons are judged where
the calibration takes a scene unit of force for a newton, as `force_N` of a clip's true |F| does. Exit status: 0 all
shown; 1 some are of no such clip, or have no estimate of its run of contact; 2 wrong usage.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.common.command_line import path_option, say
from palpate.common.doors import plain
from palpate.common.files import read_file
from palpate.common.settings import LARGEST
from palpate.data.source.table import MOST_BYTES, reason
from palpate.estimators.estimate import COMBINATIONS, REPORTED, SYMBOLS
from palpate.physics.mechanics import PARAMETERS
from palpate.results.calibrated import NEWTONS
from palpate.results.store import INTERACTIONS, RECORD, REPORT

UNIT = {"damping_over_stiffness": "s"}
"""Of quantities that are not in scene units alone."""
IN_LENGTHS = ("force", "force_over_stiffness")
"""Quantities that count in the clip's unit of length."""
SAME_ONSET = 1.5
"""A run of contact is the true one where it begins within so many frames of it."""


class NoTruth(ValueError):
    """Results can't be compared with the truth; the message is a sentence."""


def true_values(theta: Mapping[str, float]) -> dict[str, float]:
    """Every REPORTED combination of the true k_s, k_d and signed F.

    Raises:
        KeyError, TypeError: a number is missing, or there are none.
        ValueError: one is 0, infinite or no number.
    """
    magnitudes = np.abs([float(theta[name]) for name in PARAMETERS])
    if not ((magnitudes > 0) & (magnitudes <= LARGEST)).all():
        raise ValueError("theta is to be finite numbers other than 0")
    return {name: float(np.prod(magnitudes ** np.array(COMBINATIONS[name]))) for name in REPORTED}


def read_results(folder: Path) -> tuple[str, dict[str, str], dict[str, float], float]:
    """Name of a clip, the row of `interactions.csv` of its true run of contact, its true values, and how long it lasts.

    Raises:
        NoTruth: they are no results, of no synthetic clip, or have no such run.
    """
    try:
        record = json.loads(read_file(folder / RECORD, MOST_BYTES))
        clip, fps = Path(record["input"]["path"]), float(record["input"]["fps"])
        text = io.StringIO(read_file(folder / INTERACTIONS, MOST_BYTES).decode("utf-8"), newline="")
        rows = list(csv.DictReader(text))
        onsets = [float(row["onset_time_s"]) for row in rows]
        found = [f"{row['verdict']}." if row["status"] == "ok" else f"no estimate. {row['detail']}" for row in rows]
    except (OSError, ValueError, KeyError, TypeError, RecursionError, csv.Error) as error:
        raise NoTruth(f"{folder} holds no results of infer.py ({reason(error)}); give a clip's folder.") from error
    try:
        truth = json.loads(read_file((clip if clip.is_dir() else clip.with_suffix("")) / "truth.json", MOST_BYTES))
        values, onset = true_values(truth["theta"]), float(truth["onset_s"])
        pressed = float(truth["release_s"]) - onset
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise NoTruth(f"{clip} has no truth ({reason(error)}); give results of a clip of data.synthetic.") from error
    for row, begun in zip(rows, onsets, strict=True):
        if row["status"] == "ok" and abs(begun - onset) * fps <= SAME_ONSET:
            return clip.name, row, values, pressed
    runs = " ".join(f"Contact from {begun:.2f} s: {outcome}" for begun, outcome in zip(onsets, found, strict=True))
    raise NoTruth(
        f"{folder} has no estimate of a run of contact that begins at {onset:.2f} s, where it truly does. "
        f"{runs or 'No contact was found.'}"
    )


def table_of(name: str, row: Mapping[str, str], truth: Mapping[str, float]) -> Table:
    """Every quantity with its estimate, interval and truth; numbers of what is not determined are not shown.

    A video alone tells lengths, and forces with them, in a unit of its own only: these aren't judged.
    """
    own_unit = () if Path(name).suffix == "" else IN_LENGTHS
    title = f"{name}: {row['verdict']}; normalised units, not N/m or N"
    table = Table("quantity", "estimate", "90 % interval", "truth", "", title=plain(title))
    determined = row["determined"].split(";")
    for quantity in REPORTED:
        label = f"{quantity.replace('_', ' ')} {SYMBOLS[quantity]} {UNIT.get(quantity, '')}".strip()
        estimate, low, high = (row.get(f"{quantity}{end}", "") for end in ("", "_low", "_high"))
        cells = [label, "not determined", "", f"{truth[quantity]:.3g}", ""]
        if estimate and quantity in determined:
            cells[1] = f"{float(estimate):.3g}"
            if low and high:
                held = float(low) <= truth[quantity] <= float(high)
                judged = "in another unit" if quantity in own_unit else "held" if held else "missed"
                cells[2], cells[4] = f"{float(low):.3g} to {float(high):.3g}", judged
        table.add_row(*map(Text, cells))
    return table


def judged(folder: Path, row: Mapping[str, str], truth: Mapping[str, float], pressed: float) -> dict[str, bool]:
    """Whether each thing that is said of a run of contact holds; what is not said is left out.

    Args:
        folder: of the clip's results.
        row: of `interactions.csv`.
        truth: by quantity.
        pressed: how long a constant force truly acts [s].
    """
    held = {}
    for name in row["determined"].split(";"):
        low, high = (row.get(f"{name}_{end}") for end in ("low", "high"))
        if low and high and name in truth:
            held[name] = float(low) <= truth[name] <= float(high)
    report = json.loads(read_file(folder / REPORT, MOST_BYTES))
    found = next(item for item in report["contacts"] if item["onset_frame"] == int(row["onset_frame"]))
    held["time in contact"] = abs(found["contact_s"] - pressed) <= 1.001 * max(found["frame_s"])
    if found["unit"].startswith(NEWTONS):
        held |= {name: found[f"{name}_low"] <= truth["force"] <= found[f"{name}_high"] for name in ("mean", "peak")}
        if report["force_limit"]:
            above = (truth["force"] >= report["force_limit"]["limit"]) * (found["contact_s"] - found["above_unknown_s"])
            held["time above the limit"] = found["above_s_low"] - 1e-9 <= above <= found["above_s_high"] + 1e-9
    return held


def summary(clips: Sequence[Mapping[str, bool]]) -> Table:
    """How often what was said holds."""
    table = Table("of forces.json, or a 90 % interval", "clips that have it", "hold", title=f"{len(clips)} clips")
    for name in dict.fromkeys(name for clip in clips for name in clip):
        found = [clip[name] for clip in clips if name in clip]
        table.add_row(name.replace("_", " "), str(len(found)), f"{sum(found)} ({sum(found) / len(found):.0%})")
    return table


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare_with_truth", description=__doc__.split("\n")[0])
    parser.add_argument("results", nargs="+", type=path_option, metavar="RESULTS", help="folder of infer.py")
    options: Any = parser.parse_args(arguments)
    console, status, clips = Console(), 0, {}
    for folder in options.results:
        try:
            name, row, truth, pressed = read_results(folder)
        except NoTruth as error:
            say(Console(stderr=True), str(error), "red")
            status = 1
            continue
        console.print(table_of(name, row, truth))
        if len(options.results) > 1 and not Path(name).suffix:
            clips[name] = judged(folder, row, truth, pressed)
    if len(clips) > 1:
        console.print(summary([*clips.values()]))
    return status


if __name__ == "__main__":
    run_door(main)
