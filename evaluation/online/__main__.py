"""The online estimator on four simulated pulls: figures 5, 7, 8 and 9 and Table II of Liang 2024.

    python -m evaluation.online --output OUT [--sequences thin-shell-1 …] [--starts k1 k2 k3] [--methods PBD …]
        [--match tracks] [--optimizer gauss-newton] [--frames N] [--particles 600] [--points 9000] [--every 10]

Truth is another integrator's on another mesh (evaluation/online/sequences.py). Each of sequence, start and method is a
file in OUT/cases, so that an interrupted run goes on where it was, and a run of some adds to those that are there.
Writes report.html, table.csv (sequence, start, method, measure, value) and figures/ of all that were asked for. A small
run: --sequences thin-shell-1 --starts k1 --frames 30 --particles 150 --points 1000.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from palpate.common.command_line import path_option, progress_bars, say, whole_number
from palpate.common.doors import INTERRUPTED, interruptible
from palpate.common.files import digest_of, read_file
from palpate.common.output import replacing_own, require_own
from palpate.common.provenance import code_digest
from palpate.common.tables import to_csv
from palpate.evaluation.online.compare import (
    BATCH,
    HORIZON,
    METHODS,
    OPTIMIZER,
    STARTS,
    Case,
    run_case,
    summary,
    told_by,
)
from palpate.evaluation.online.figures import draw_all, table
from palpate.evaluation.online.sequences import SEQUENCES, Pull
from palpate.evaluation.page import as_png, render_page
from palpate.results.store import OutputError, writing

COLUMNS = ("sequence", "start", "method", "measure", "value")
TITLE = "The online estimator on simulated pulls"
FIGURES = tuple(f"figures/figure_{number}.png" for number in (5, 7, 8, 9))
MATCHES = ("chamfer", "tracks", "both")
Key = tuple[str, str, str]


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.online",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 all done; 1 it could not be written; 2 wrong usage; 130 interrupted.",
    )
    add = parser.add_argument
    add("--output", type=path_option, required=True, metavar="OUT", help="folder of the results")
    add("--sequences", nargs="+", choices=SEQUENCES, default=list(SEQUENCES), help="which (default: all)")
    add("--starts", nargs="+", choices=STARTS, default=list(STARTS), help="stiffness to begin with (default: all)")
    add(
        "--methods",
        nargs="+",
        choices=METHODS,
        default=list(METHODS),
        help=f"which (default: all; {BATCH} on sheets alone)",
    )
    add("--match", choices=MATCHES, default="tracks", help="what is seen of a frame (default tracks; paper: chamfer)")
    text = f"of PBD-RM-ON (default {OPTIMIZER}; the paper: adam)"
    add("--optimizer", choices=("adam", "gauss-newton"), default=OPTIMIZER, help=text)
    text = "of each sequence, from its beginning (default: all; 60, of thin-shell-2 100)"
    add("--frames", type=whole_number(HORIZON + 2), metavar="N", help=text)
    add("--particles", type=whole_number(60, 10_000), default=600, metavar="N", help="about how many (default 600)")
    add("--points", type=whole_number(50), default=9000, metavar="N", help="of a cloud (default 9000)")
    add("--every", type=whole_number(1), default=10, metavar="N", help="frames between predictions (default 10)")
    return parser


def case_path(output: Path, key: Key) -> Path:
    """Where a case lies."""
    return output / "cases" / f"{'_'.join(key)}.npz"


def read_case(path: Path, fingerprint: str) -> Case | None:
    """A case that was made by the same program with the same settings, else None."""
    try:
        with np.load(io.BytesIO(read_file(path)), allow_pickle=False) as stored:
            if str(stored["of"]) != fingerprint:
                return None
            values = {field.name: stored[field.name] for field in dataclasses.fields(Case)}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return Case(**{name: value.item() if value.ndim == 0 else value for name, value in values.items()})


def write_case(path: Path, case: Case, fingerprint: str) -> None:
    """Write a case whole or not at all.

    Raises:
        OutputError: it can't be written.
    """
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        content = io.BytesIO()
        np.savez_compressed(content, of=np.array(fingerprint), **dataclasses.asdict(case))
        with replacing_own(path) as partial:
            partial.write_bytes(content.getvalue())


def main(arguments: list[str] | None = None) -> int:
    """Run what is asked for and not there yet, and draw all of it; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    frames = {name: min(SEQUENCES[name].frames, options.frames or SEQUENCES[name].frames) for name in options.sequences}
    least = min(frames.values())
    if options.every + HORIZON > least - 1:
        parser.error(
            f"--every {options.every} leaves no prediction {HORIZON} frames ahead within {least} frames; give fewer or "
            "more --frames."
        )
    keys: list[Key] = [
        (sequence, start, method)
        for sequence in options.sequences
        for start in options.starts
        for method in options.methods
        if method != BATCH or not SEQUENCES[sequence].block
    ]
    if not keys:
        parser.error(f"{BATCH} runs on sheets alone, as in the paper; give other --sequences or --methods.")
    settings = {
        "match": options.match,
        "optimizer": options.optimizer,
        "particles": options.particles,
        "points": options.points,
    }
    settings |= {"every": options.every, "code": code_digest()}
    prints = {name: digest_of({**settings, "frames": count}) for name, count in frames.items()}
    found: dict[Key, Case] = {}
    pulls: dict[str, Pull] = {}
    try:
        with writing(options.output):  # before the long work
            require_own(
                *(options.output / name for name in ("table.csv", "report.html", *FIGURES)),
                *(case_path(options.output, key) for key in keys),
            )
        for key in keys:
            case = read_case(case_path(options.output, key), prints[key[0]])
            if case is not None:
                found[key] = case
        if found:
            say(console, f"{len(found)} of {len(keys)} cases are there already.")
        with interruptible(), progress_bars(console) as progress:
            bar = progress.add_task("frames", total=sum(frames[key[0]] for key in keys))
            for name in options.sequences:
                pulls[name] = SEQUENCES[name].pull(options.particles, options.points, frames[name])
                for key in (key for key in keys if key[0] == name):
                    if key in found:
                        progress.advance(bar, frames[name])
                        continue
                    progress.update(bar, description=" ".join(key))
                    case = run_case(
                        pulls[name],
                        STARTS[key[1]],
                        key[2],
                        options.match,
                        options.every,
                        lambda: progress.advance(bar),
                        options.optimizer,
                    )
                    write_case(case_path(options.output, key), case, prints[name])
                    found[key] = case
        told = write_report(options.output, {key: found[key] for key in keys}, pulls, options)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    except KeyboardInterrupt:
        say(console, "Interrupted; the cases that are finished are kept.", "yellow")
        return INTERRUPTED
    Console().print(told, markup=False, highlight=False, soft_wrap=True)
    say(console, f"written: {options.output}/table.csv, report.html, figures/")
    return 0


def write_report(output: Path, cases: dict[Key, Case], pulls: dict[str, Pull], options: argparse.Namespace) -> str:
    """Write figures, table and page; gives what it says.

    Raises:
        OutputError: they can't be written.
    """
    claims = list(summary(cases))
    rows = [
        dict(zip(COLUMNS, (*key, measure, value), strict=True))
        for key, case in cases.items()
        for measure, value in (
            ("future gap [mm]", 1e3 * float(case.gap.mean())),
            ("keypoint error [mm]", 1e3 * float(case.keypoint.mean())),
            ("Chamfer distance [mm]", 1e3 * float(case.chamfer.mean())),
            ("rank correlation of distances", case.rank),
            ("step [s]", case.seconds),
        )
    ]
    pictures = {f"figures/{name}": as_png(figure) for name, figure in draw_all(cases, pulls).items()}
    counts = ", ".join(f"{name} {pull.body.count} particles" for name, pull in pulls.items())
    told = f"Matched: {options.match}; {options.optimizer}. {counts}, clouds of {options.points} points.\n\n"
    told += "Future gap; keypoint error [mm]:\n\n" + table(cases, options.sequences) + "\n\n"
    seen = {name: told_by(pull) for name, pull in pulls.items()}
    claims += [
        (f"a field's traces, {name}", ", ".join(f"{field} {1e3 * off:.2f} mm" for field, off in errors.items()))
        for name, errors in seen.items()
    ]
    told += "\n".join(f"- {name}: {text}" for name, text in claims) + "\n"
    shown = "\n".join(f"![{name}]({name})\n" for name in pictures)
    files = {"table.csv": to_csv(rows, COLUMNS, ".6g").encode()}
    files["report.html"] = render_page(TITLE, f"# {TITLE}\n\n{told}\n{shown}", pictures).encode()
    with writing(output):
        (output / "figures").mkdir(parents=True, exist_ok=True)
        for name, content in (pictures | files).items():
            with replacing_own(output / name) as partial:
                partial.write_bytes(content)
    return told


if __name__ == "__main__":
    run_door(main)
