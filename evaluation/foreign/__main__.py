"""What the finite elements find on other people's data, compared with the truth.

    python -m evaluation.foreign --data DIR --output OUT

Runs on every file that it knows under DIR, by name: `linear*.npz` and `neohookean*.npz`, with `liver.msh` and
`dirichlet-vertices.npy` in the same folder (a pulled liver of a foreign simulation; minutes each), and `beam_*.csv` (a
silicone beam that is let go). Writes table.csv (file, measure, value); what the measures mean is in
docs/reports/fem.md.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from palpate.common.files import all_below
from palpate.evaluation.foreign.beam import Ringing, judge_beams, measure_ringing
from palpate.evaluation.foreign.liver import MATERIALS, judge_pull
from palpate.evaluation.harness import FileMeasurements, Row, run


@dataclass(frozen=True)
class Foreign(FileMeasurements):
    """Other people's data."""

    def __post_init__(self) -> None:
        """Raise a ValueError where there is nothing to judge."""
        if not self.wanted:
            raise ValueError(
                f"{self.data} holds none of linear*.npz, neohookean*.npz, beam_*.csv; give --data that does."
            )

    @functools.cached_property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Beams, then pulls."""
        found = all_below(self.data) if self.data.is_dir() else []
        beams = [path for path in found if path.name.startswith("beam_") and path.suffix == ".csv"]
        pulls = [path for path in found if path.name.startswith(tuple(MATERIALS)) and path.suffix == ".npz"]
        works = [(path, measure_ringing) for path in beams] + [(path, judge_pull) for path in pulls]
        return {path.relative_to(self.data).as_posix(): functools.partial(work, path) for path, work in works}

    def tabled(self, rows: Sequence[Row]) -> list[Row]:
        """In place of beams as they were measured, what their runs say together."""
        runs = {row["file"]: Ringing(**row["ringing"]) for row in rows if "ringing" in row}
        judged = judge_beams(runs) if runs else {}
        failed_beams = [row for row in rows if "status" in row and row["file"].endswith(".csv")]
        pulls = [row for row in rows if row["file"].endswith(".npz")]
        return [*failed_beams, *({"file": name, **measures} for name, measures in judged.items()), *pulls]


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge what lies under a folder; returns the exit status."""
    return run(Foreign, arguments, "evaluation.foreign", __doc__)


if __name__ == "__main__":
    run_door(main)
