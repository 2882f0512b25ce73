"""What measured forces tell, judged on what was kept back from the fits.

    python -m evaluation.palpation --data DIR --output OUT

Runs on every CSV file under DIR whose columns it knows, whatever its name: probes of a region (probe, contact_x …,
depth_mm, fn_N), indentations that are held (t_s, force_N, displacement_mm), grasps (force_N, gripper_width_m; the name
tells day and object). Writes table.csv (file, measure, value); what the measures mean is in docs/palpation.md.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from data.command_line import path_option, progress_bars, say
from data.source.layout import InputError
from estimators.palpation import fit_grasp, read_grasp, read_hold, read_probes
from estimators.palpation.curves import HOLD, KINDS, PROBES, kind_of
from estimators.palpation.grasp import GraspSlope
from evaluation.palpation.grasping import GraspName, judge_grasps
from evaluation.palpation.probing import judge_probing
from evaluation.palpation.relaxation import judge_relaxation
from evaluation.tables import to_csv
from physics.doors import INTERRUPTED
from physics.files import all_below
from physics.ownership import replacing_own, require_own
from results.store import OutputError, writing

COLUMNS = ("file", "measure", "value")
SUMMARISED = {
    "probing": (
        "that over the mean stiffness's, random fifths",
        "that over the mean stiffness's, strips",
        "coverage of 90 % intervals, random fifths",
    ),
    "relaxation": ("second half off, rms / peak", "one standard linear solid: second half off, rms / peak"),
}
"""Measures of which the median over the files is told as well."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.palpation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 all files judged; 1 some could not be; 2 wrong usage; 130 interrupted.",
    )
    parser.add_argument("--data", type=path_option, required=True, metavar="DIR", help="folder of the data")
    parser.add_argument("--output", type=path_option, required=True, metavar="OUT", help="folder of the table")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Judge what lies under a folder; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    below = all_below(options.data) if options.data.is_dir() else []
    kinds = {path: kind_of(path) for path in below if path.suffix.lower() == ".csv"}
    files = {path: kind for path, kind in kinds.items() if kind is not None}
    if not files:
        wanted = "; ".join(", ".join(columns) for columns in KINDS)
        parser.error(f"{options.data} holds no CSV file with the columns of any of: {wanted}. Give --data that does.")
    try:
        with writing(options.output):
            require_own(options.output / "table.csv")
    except OutputError as error:
        say(console, str(error), "red")
        return 2
    rows: list[dict[str, object]] = []
    slopes: dict[GraspName, list[GraspSlope]] = defaultdict(list)
    status = 0

    def judge(path: Path, kind: tuple[str, ...]) -> dict[str, object]:
        if kind == PROBES:
            return judge_probing(read_probes(path))
        if kind == HOLD:
            return judge_relaxation(read_hold(path))
        slope = fit_grasp(read_grasp(path))
        slopes[GraspName.of(path.stem)].append(slope)
        return {"slope 2 to 8 N (N/mm)": slope.stiffness, "compliance (mm/N)": slope.compliance, "its sd": slope.sd}

    def tell(name: str, work: Callable[[], dict[str, object]]) -> None:
        nonlocal status
        try:
            measures = work()
        except InputError as error:
            measures, status = {"status": str(error)}, 1
            say(console, str(error), "red")
        except Exception as error:  # of one file; the others' answers must not be lost
            reason = str(error) if isinstance(error, ValueError) else f"failed ({type(error).__name__}: {error})"
            measures, status = {"status": reason}, 1
            say(console, f"{name}: {reason}", "red")
        rows.extend({"file": name, "measure": measure, "value": value} for measure, value in measures.items())

    try:
        with progress_bars(console) as progress:
            bar = progress.add_task("files", total=len(files))
            for path, kind in files.items():
                tell(path.relative_to(options.data).as_posix(), lambda path=path, kind=kind: judge(path, kind))
                _write(options.output, rows)
                progress.advance(bar)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    except KeyboardInterrupt:
        say(console, "Interrupted; what is finished is written.", "yellow")
        status = INTERRUPTED
    for name, measures in judge_grasps(slopes).items():
        rows.extend({"file": name, "measure": measure, "value": value} for measure, value in measures.items())
    rows.extend(_summary(rows))
    try:
        _write(options.output, rows)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    for row in rows:
        value = row["value"]
        print(f"{row['file']}: {row['measure']}: {f'{value:.4g}' if isinstance(value, float) else value}")
    say(console, f"written: {options.output}/table.csv")
    return status


def _summary(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """Medians over all files of a kind."""
    found: list[dict[str, object]] = []
    for kind, measures in SUMMARISED.items():
        for measure in measures:
            values = [row["value"] for row in rows if row["measure"] == measure]
            numbers = [value for value in values if isinstance(value, float)]
            if numbers:
                named = {"file": f"all {kind}", "measure": f"{measure}, median of {len(numbers)} files"}
                found.append(named | {"value": float(np.median(numbers))})
    return found


def _write(output: Path, rows: list[dict[str, object]]) -> None:
    with writing(output):
        output.mkdir(parents=True, exist_ok=True)
        with replacing_own(output / "table.csv") as partial:
            partial.write_text(to_csv(rows, COLUMNS, ".6g"), encoding="utf-8")


if __name__ == "__main__":
    run_door(main)
