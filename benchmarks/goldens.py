"""Goldens: numbers that a change of the code must leave as they are.

    python -m benchmarks.goldens [--group recovery online …] [--write]

Computes each group and compares it with tests/goldens.json, to a relative tolerance of 1e-4; `--write` replaces the
groups computed. Exit status: 0 equal or written; 1 different; 2 wrong usage.

network, direct   six synthetic clips with depth
rgb               their video files
recovery, grips   one clip of each suite
online            Liang 2024, one sequence
palpation, plan   Frank 2010
real              two real clips; left out where TISSUE_REAL_DATA, or ../shared/data, doesn't exist
"""

import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from rich.console import Console

from benchmarks.harness import read_results
from benchmarks.online.__main__ import main as follow
from benchmarks.palpation.example import main as press
from benchmarks.real.__main__ import main as judge
from benchmarks.recovery.__main__ import main as recover
from benchmarks.recovery.suites import EVERY
from palpate.api import calibrate, plan
from palpate.cli.infer import main as infer
from palpate.common.command_line import say
from palpate.common.doors import run_door
from palpate.common.files import as_json
from palpate.common.options import options
from palpate.data.synthetic.__main__ import main as draw

ROOT = Path(__file__).resolve().parents[1]
GOLDENS = ROOT / "tests" / "goldens.json"
REAL_DATA = Path(os.environ.get("TISSUE_REAL_DATA", ROOT.parent / "shared" / "data"))

Group = Literal["network", "direct", "rgb", "recovery", "grips", "online", "palpation", "plan", "real"]
Values = dict[str, float | str]


@dataclass(frozen=True)
class Goldens:
    """Groups of results to compute."""

    group: tuple[Group, ...] = get_args(Group)
    """which"""
    write: bool = False
    """replace the goldens of these groups"""


def inferred(folder: Path, ending: str, *arguments: str, count: int = 6) -> Values:
    """Estimates of the demo's clips: a value per clip, contact and column."""
    clips = folder / "clips"
    draw(["--output", str(clips), "--clips", str(count), "--frames", "32", "--seed", "1"])
    inputs = [str(path) for path in sorted(clips.glob(f"*/*_00000{ending}"))]
    infer([*inputs, "--output", str(folder / "results"), "--no-overlay", *arguments])
    quantities = ("stiffness", "damping", "force", "damping_over_stiffness", "force_over_stiffness")
    columns = ("verdict", *quantities, *(f"{name}_sd" for name in quantities), "misfit")
    found: Values = {}
    for path in sorted((folder / "results").glob("*/interactions.csv")):
        for row in rows_of(path):
            found |= {f"{path.parent.name} {row['onset_frame']} {name}": row[name] for name in columns}
    return found


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a table, all texts."""
    return pd.read_csv(path, dtype=str, keep_default_na=False).to_dict("records")


def recovered(folder: Path, kind: str, suites: Sequence[str] = ()) -> Values:
    """Estimates of the first clip of suites; by default of all of a kind, press or grip."""
    asked = suites or [name for name, suite in EVERY.items() if suite.of == kind]
    model = str(ROOT / "models" / "weights" / "contact.onnx")
    recover(["--output", str(folder), "--suite", *asked, "--estimator", "direct", "network", "--model", model,
             "--clips", "1", "--workers", "0"])  # fmt: skip
    found: Values = {}
    for key, row in read_results(folder / "results.jsonl", ("suite", "estimator")).items():
        for name in ("status", "estimate", "covariance", "misfit", "contact_right", "skill", "curve"):
            values = np.ravel(row.get(name, []))
            found |= {" ".join((*key, name, str(place))): value for place, value in enumerate(values.tolist())}
    return found


def table_of(folder: Path, *columns: str) -> Values:
    """Values of a table.csv by the columns that name them, without times."""
    rows = rows_of(folder / "table.csv")
    return {" ".join(row[name] for name in columns): row["value"] for row in rows if "step" not in row["measure"]}


def followed(folder: Path) -> Values:
    """Liang's table for one sequence and start, of fewer frames, particles and points."""
    follow(["--output", str(folder), "--sequences", "thin-shell-1", "--starts", "k1", "--frames", "30",
            "--particles", "150", "--points", "1000"])  # fmt: skip
    return table_of(folder, "sequence", "start", "method", "measure")


def palpated(folder: Path) -> Values:
    """Modulus and Poisson's ratio of the example."""
    press(["--output", str(folder)])
    fit = calibrate(folder / "scene.yaml")
    return {name: getattr(fit, name) for name in ("young", "young_sd", "poisson", "poisson_sd", "noise")}


def planned(folder: Path) -> Values:
    """The path between two curtains."""
    found = plan(ROOT / "configs" / "scenes" / "two_curtains.yaml", folder)
    places = {f"place {number}": value for number, value in enumerate(found.places.ravel().tolist())}
    return {"cost": found.cost, "deformation": found.deformation, "way": found.way} | places


def real(folder: Path) -> Values:
    """Pulls in real clips."""
    if not (REAL_DATA / "cholecseg8k").is_dir():
        return {}
    judge(["--data", str(REAL_DATA), "--output", str(folder)])
    ends = "frames in contact", "verdict", "skill in frames kept back"
    return {key: value for key, value in table_of(folder, "clip", "measure").items() if key.endswith(ends)}


GROUPS: dict[str, Callable[[Path], Values]] = {
    "network": lambda folder: inferred(folder, ""),
    "direct": lambda folder: inferred(folder, "", "--estimator", "direct"),
    "rgb": lambda folder: inferred(folder, ".mp4"),
    "recovery": lambda folder: recovered(folder, "press"),
    "grips": lambda folder: recovered(folder, "grip"),
    "online": followed,
    "palpation": palpated,
    "plan": planned,
    "real": real,
}


def rounded(values: Values) -> Values:
    """Texts as they are; numbers to six significant digits, without those that are no number."""
    found: Values = {}
    for name, value in values.items():
        try:
            number = float(f"{float(value):.6g}")
        except ValueError:
            found[name] = value
            continue
        if math.isfinite(number):
            found[name] = number
    return {name: value for name, value in found.items() if value != ""}


def differences(values: Values, goldens: Values) -> list[str]:
    """A sentence per value that is another, new or missing."""

    def same(value: Any, golden: Any) -> bool:
        numbers = isinstance(value, float) and isinstance(golden, float)
        # Relative difference that rounding makes between machines and numbers of threads.
        return math.isclose(value, golden, rel_tol=1e-4) if numbers else value == golden

    pairs = {name: (values.get(name, "missing"), goldens.get(name, "missing")) for name in goldens | values}
    return [f"{name}: {value}, golden {golden}" for name, (value, golden) in pairs.items() if not same(value, golden)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare or write; returns the exit status."""
    asked: Goldens = options(Goldens, arguments, "benchmarks.goldens", __doc__)
    console, status = Console(), 0
    for group in asked.group:
        with TemporaryDirectory() as folder:
            values = rounded(GROUPS[group](Path(folder)))
        if group == "real" and not values:
            say(console, f"real: left out, there is no {REAL_DATA}; set TISSUE_REAL_DATA.", "yellow")
            continue
        goldens = json.loads(GOLDENS.read_text(encoding="utf-8"))
        if asked.write:
            goldens[group] = values
            GOLDENS.write_text(as_json(goldens, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        found = differences(values, goldens.get(group, {}))
        status |= bool(found)
        say(console, f"{group}: {len(values)} values, {len(found)} different", "red" if found else "")
        for text in found:
            say(console, f"  {text}")
    return status


if __name__ == "__main__":
    run_door(main)
