"""What the finite elements find on other people's data, beside the truth.

    python -m evaluation.foreign --data DIR --output OUT

Runs on every file that it knows under DIR, by name: `linear*.npz` and `neohookean*.npz` with `liver.msh` and
`dirichlet-vertices.npy` beside them (a pulled liver of a foreign simulation; minutes each), and `beam_*.csv` (a
silicone beam that is let go). Writes table.csv (file, measure, value); what the measures mean is in
docs/reports/fem.md.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from pathlib import Path
from typing import Any

from rich.console import Console

from palpate.common.command_line import progress_bars, say
from palpate.common.doors import INTERRUPTED
from palpate.common.files import all_below
from palpate.evaluation.file_table import FileTable, folder_parser
from palpate.evaluation.foreign.beam import Ringing, judge_beams, read_ringing
from palpate.evaluation.foreign.liver import MATERIALS, judge_pull
from palpate.results.store import OutputError


def main(arguments: list[str] | None = None) -> int:
    """Judge what lies under a folder; returns the exit status."""
    parser, console = folder_parser("evaluation.foreign", __doc__), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    found = all_below(options.data) if options.data.is_dir() else []
    pulls = [path for path in found if path.name.startswith(tuple(MATERIALS)) and path.suffix == ".npz"]
    beams = [path for path in found if path.name.startswith("beam_") and path.suffix == ".csv"]
    if not pulls and not beams:
        parser.error(f"{options.data} holds none of linear*.npz, neohookean*.npz, beam_*.csv; give --data that does.")
    runs: dict[str, Ringing] = {}

    def read(path: Path, name: str) -> dict[str, object]:
        runs[name] = read_ringing(path)
        return {}

    try:
        table, interrupted = FileTable(options.output, console), False
        try:
            with progress_bars(console) as progress:
                bar = progress.add_task("files", total=len(pulls) + len(beams))
                for path in beams:
                    name = path.relative_to(options.data).as_posix()
                    table.judge(name, lambda path=path, name=name: read(path, name))
                    progress.advance(bar)
                if runs:
                    judged: dict[str, dict[str, object]] = {}
                    table.judge("silicone beam", lambda: judged.update(judge_beams(runs)) or {})
                    for name, measures in judged.items():
                        table.add(name, measures)
                for path in pulls:
                    table.judge(path.relative_to(options.data).as_posix(), lambda path=path: judge_pull(path))
                    progress.advance(bar)
        except KeyboardInterrupt:
            say(console, "Interrupted; what is finished is written.", "yellow")
            interrupted = True
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    table.show()
    return INTERRUPTED if interrupted else table.status


if __name__ == "__main__":
    run_door(main)
