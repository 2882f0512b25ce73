"""What the finite elements find on other people's data, beside the truth.

    python -m evaluation.foreign --data DIR --output OUT

Runs on every file that it knows under DIR, by name: `linear*.npz` and `neohookean*.npz` with `liver.msh` and
`dirichlet-vertices.npy` beside them (a pulled liver of a foreign simulation; minutes each), and `beam_*.csv` (a
silicone beam that is let go). Writes table.csv (file, measure, value); what the measures mean is in docs/fem.md.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from data.command_line import path_option, progress_bars, say
from data.source.layout import InputError
from evaluation.foreign.beam import Ringing, judge_beams, read_ringing
from evaluation.foreign.liver import MATERIALS, judge_pull
from evaluation.tables import to_csv
from physics.doors import INTERRUPTED
from physics.files import all_below
from physics.ownership import replacing_own
from results.store import OutputError, writing

COLUMNS = ("file", "measure", "value")


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.foreign",
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
    found = all_below(options.data) if options.data.is_dir() else []
    pulls = [path for path in found if path.name.startswith(tuple(MATERIALS)) and path.suffix == ".npz"]
    beams = [path for path in found if path.name.startswith("beam_") and path.suffix == ".csv"]
    if not pulls and not beams:
        parser.error(f"{options.data} holds none of linear*.npz, neohookean*.npz, beam_*.csv; give --data that does.")
    rows: list[dict[str, object]] = []
    runs: dict[str, Ringing] = {}
    status = 0

    def tell(name: str, work: Callable[[], dict[str, object]]) -> None:
        nonlocal status
        try:
            measures = work()
        except InputError as error:
            measures, status = {"status": str(error)}, 1
            say(console, str(error), "red")
        except Exception as error:  # of one file; the others' answers must not be lost
            measures, status = {"status": f"failed ({type(error).__name__}: {error})"}, 1
            say(console, f"{name}: {measures['status']}", "red")
        rows.extend({"file": name, "measure": measure, "value": value} for measure, value in measures.items())
        _write(options.output, rows)

    def read(path: Path, name: str) -> dict[str, object]:
        runs[name] = read_ringing(path)
        return {}

    try:
        with progress_bars(console) as progress:
            bar = progress.add_task("files", total=len(pulls) + len(beams))
            for path in beams:
                name = path.relative_to(options.data).as_posix()
                tell(name, lambda path=path, name=name: read(path, name))
                progress.advance(bar)
            if runs:
                judged: dict[str, dict[str, object]] = {}
                tell("silicone beam", lambda: judged.update(judge_beams(runs)) or {})
                for name, measures in judged.items():
                    tell(name, lambda measures=measures: measures)
            for path in pulls:
                tell(path.relative_to(options.data).as_posix(), lambda path=path: judge_pull(path))
                progress.advance(bar)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    except KeyboardInterrupt:
        say(console, "Interrupted; what is finished is written.", "yellow")
        status = INTERRUPTED
    for row in rows:
        value = row["value"]
        print(f"{row['file']}: {row['measure']}: {f'{value:.4g}' if isinstance(value, float) else value}")
    say(console, f"written: {options.output}/table.csv")
    return status


def _write(output: Path, rows: list[dict[str, object]]) -> None:
    with writing(output):
        output.mkdir(parents=True, exist_ok=True)
        with replacing_own(output / "table.csv") as partial:
            partial.write_text(to_csv(rows, COLUMNS, ".6g"), encoding="utf-8")


if __name__ == "__main__":
    run_door(main)
