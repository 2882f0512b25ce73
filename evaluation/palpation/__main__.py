"""What measured forces tell, judged on what was kept back from the fits.

    python -m evaluation.palpation --data DIR --output OUT

Runs on every CSV file under DIR whose columns it knows, whatever its name: probes of a region (probe, contact_x …,
depth_mm, fn_N), indentations that are held (t_s, force_N, displacement_mm), grasps (force_N, gripper_width_m; the name
tells day and object). Writes table.csv (file, measure, value); what the measures mean is in docs/reports/palpation.md.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from palpate.common.command_line import progress_bars, say
from palpate.common.doors import INTERRUPTED
from palpate.common.files import all_below
from palpate.estimators.palpation import fit_grasp, read_grasp, read_hold, read_probes
from palpate.estimators.palpation.curves import HOLD, KINDS, PROBES, kind_of
from palpate.estimators.palpation.grasp import GraspSlope
from palpate.evaluation.file_table import FileTable, folder_parser
from palpate.evaluation.palpation.grasping import GraspName, judge_grasps
from palpate.evaluation.palpation.probing import judge_probing
from palpate.evaluation.palpation.relaxation import judge_relaxation
from palpate.results.store import OutputError

SUMMARISED = {
    "probing": (
        "that over the mean stiffness's, random fifths",
        "that over the mean stiffness's, strips",
        "coverage of 90 % intervals, random fifths",
    ),
    "relaxation": ("second half off, rms / peak", "one standard linear solid: second half off, rms / peak"),
}
"""Measures of which the median over the files is told as well."""


def main(arguments: list[str] | None = None) -> int:
    """Judge what lies under a folder; returns the exit status."""
    parser, console = folder_parser("evaluation.palpation", __doc__), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    below = all_below(options.data) if options.data.is_dir() else []
    kinds = {path: kind_of(path) for path in below if path.suffix.lower() == ".csv"}
    files = {path: kind for path, kind in kinds.items() if kind is not None}
    if not files:
        wanted = "; ".join(", ".join(columns) for columns in KINDS)
        parser.error(f"{options.data} holds no CSV file with the columns of any of: {wanted}. Give --data that does.")
    slopes: dict[GraspName, list[GraspSlope]] = defaultdict(list)

    def judge(path: Path, kind: tuple[str, ...]) -> dict[str, object]:
        if kind == PROBES:
            return judge_probing(read_probes(path))
        if kind == HOLD:
            return judge_relaxation(read_hold(path))
        slope = fit_grasp(read_grasp(path))
        slopes[GraspName.of(path.stem)].append(slope)
        return {"slope 2 to 8 N (N/mm)": slope.stiffness, "compliance (mm/N)": slope.compliance, "its sd": slope.sd}

    try:
        table, interrupted = FileTable(options.output, console), False
        try:
            with progress_bars(console) as progress:
                bar = progress.add_task("files", total=len(files))
                for path, kind in files.items():
                    name = path.relative_to(options.data).as_posix()
                    table.judge(name, lambda path=path, kind=kind: judge(path, kind))
                    progress.advance(bar)
        except KeyboardInterrupt:
            say(console, "Interrupted; what is finished is written.", "yellow")
            interrupted = True
        for name, measures in judge_grasps(slopes).items():
            table.add(name, measures)
        for name, measures in _medians(table.rows).items():
            table.add(name, measures)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    table.show()
    return INTERRUPTED if interrupted else table.status


def _medians(rows: list[dict[str, object]]) -> dict[str, dict[str, object]]:
    """Over all files of a kind."""
    found: dict[str, dict[str, object]] = {}
    for kind, measures in SUMMARISED.items():
        for measure in measures:
            values = [row["value"] for row in rows if row["measure"] == measure]
            numbers = [value for value in values if isinstance(value, float)]
            if numbers:
                told = f"{measure}, median of {len(numbers)} files"
                found.setdefault(f"all {kind}", {})[told] = float(np.median(numbers))
    return found


if __name__ == "__main__":
    run_door(main)
