"""What can be said on real clips, judged on what was kept back from the fit.

    python -m evaluation.real --data DIR --output OUT
    python -m evaluation.real --pulled CLIP [--layout YAML] [--estimator direct|online] [--settings YAML] --output OUT

--data runs every known clip under a folder (docs/reports/real.md). A pulled clip shows tissue that an instrument holds
and moves: the table has what the session of `infer.py --estimator direct` says of it, its skill in frames that were not
fitted included; `contact_frame_N` is the probability that tissue moves with the instrument. With `--estimator online`
it is predicted ten frames ahead instead, by stiffness place by place and by a sheet of one number. Writes table.csv
(clip, measure, value), figures/ and report.html; the same command judges again what could not be judged. Not a medical
device.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import base64
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

from rich.progress import Progress

from palpate.common.doors import interruptible
from palpate.common.provenance import ROOT
from palpate.common.tables import to_cell, to_markdown
from palpate.data.source.layout import InputError
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.lattice import NothingMoves
from palpate.estimators.online.settings import FILES, OnlineSettings, load_settings
from palpate.evaluation.harness import OK, Experiment, Report, Row, by_measure, run
from palpate.evaluation.page import as_png
from palpate.evaluation.real.predicted import evaluate_prediction
from palpate.evaluation.real.pulled import PulledClip, evaluate_pull
from palpate.results.plots import draw_summary

TITLE = "Real clips, judged on what was kept back"
KNOWN = {
    "recover_tissue": PulledClip(Path("recover_tissue"), ROOT / "configs/layouts/recover_tissue.yaml"),
    "video01_00080": PulledClip(Path("cholecseg8k/video01/video01_00080")),
}
"""Pulled clips, below the data's folder."""


@dataclass(frozen=True)
class RealCase:
    """A clip, and how it is judged."""

    name: str
    pulled: PulledClip
    online: OnlineSettings | None = None
    """Of the estimator that predicts a pulled clip ahead; None = the session of direct is asked."""


def judge(case: RealCase) -> list[Row]:
    """What is measured, by name, as far as it comes; `figure` is a PNG file in base 64."""
    row: Row = {"clip": case.name, "status": ""}
    try:
        with interruptible():
            if case.online is None:
                pull = evaluate_pull(case.pulled, row)
                row |= pull.measures
                figure = draw_summary(pull.frames, runs=[pull.run], title=case.name)
                row["figure"] = base64.b64encode(as_png(figure)).decode()
            else:
                row |= evaluate_prediction(case.pulled, case.online)
    except Exception as error:  # of one clip; the others still are judged
        known = isinstance(error, InputError | NoEstimate | NothingMoves)
        unexpected = f"unexpected {type(error).__name__} ({error}); please report it with the clip."
        row["status"] = str(error) if known else unexpected
    return [row]


@dataclass(frozen=True)
class Real(Experiment):
    """What is judged."""

    data: Path | None = None
    """folder of the known clips"""
    pulled: Path | None = None
    """a clip, as infer.py takes it"""
    layout: Path | None = None
    """of the pulled clip: YAML file that names a folder's files (default: CholecSeg8k)"""
    estimator: Literal["direct", "online"] = "direct"
    """of pulled clips: direct, as infer.py runs it, or online, ahead from frames 3, 4 and 5"""
    settings: Path | None = None
    """of online (default: as configs/online.yaml)"""

    asked: list[RealCase] = field(init=False, repr=False, compare=False)
    """What to do."""
    keys: ClassVar = ("clip",)
    work: ClassVar = staticmethod(judge)

    def __post_init__(self) -> None:
        """Raise a ValueError where options don't belong together, or a file of settings can't be used."""
        if self.layout is not None and self.pulled is None:
            raise ValueError(f"--layout {self.layout} is of a clip of --pulled; give both, or leave it out.")
        if self.settings is not None and self.estimator != "online":
            raise ValueError(f"--settings {self.settings} is for --estimator online; leave it out.")
        online = OnlineSettings() if self.settings is None else load_settings(self.settings)
        for name in FILES:
            if getattr(online, name) is not None:
                raise ValueError(f"{self.settings} names a file of {name}, which is for infer.py; leave it out here.")
        object.__setattr__(self, "asked", list(self._cases(online if self.estimator == "online" else None)))
        if not self.asked:
            where = "" if self.data is None else f"; {self.data} holds none of {', '.join(KNOWN)}"
            raise ValueError(f"there is nothing to judge{where}. Give --data or --pulled.")

    def _cases(self, online: OnlineSettings | None) -> Iterator[RealCase]:
        clips = []
        if self.data is not None:
            below = {name: PulledClip(self.data / clip.path, clip.layout_file) for name, clip in KNOWN.items()}
            clips += [(name, clip) for name, clip in below.items() if clip.path.exists()]
        if self.pulled is not None:
            clips.append((self.pulled.resolve().name, PulledClip(self.pulled, self.layout)))
        names: Counter[str] = Counter()
        for name, clip in clips:
            names[name] += 1
            yield RealCase(f"{name} ({names[name]})" if names[name] > 1 else name, clip, online)

    @property
    def writes(self) -> list[str]:  # ty: ignore[incompatible-property-override]  nobody sets it
        """Files of the results."""
        return ["table.csv", "report.html", *(f"figures/{number}.png" for number in range(1, len(self.asked) + 1))]

    def record(self) -> Mapping[str, Any]:
        """What the results depend on."""
        return {f"clip {case.name}": repr(case) for case in self.asked}

    def cases(self, done: Mapping[tuple, Row], progress: Progress) -> tuple[list[RealCase], int]:
        """Those that could not be judged are tried again."""
        left = [case for case in self.asked if done.get((case.name,), {"status": ""})["status"] != OK]
        return left, len(self.asked)

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """A row a clip and measure, and a figure a clip."""
        found = [dict(rows[case.name,]) for case in self.asked if (case.name,) in rows]
        drawn = [base64.b64decode(row.pop("figure")) for row in found if "figure" in row]
        figures = {f"{number}.png": content for number, content in enumerate(drawn, 1)}
        frame = by_measure(found, "clip")
        failed = [(f"{row['clip']}: {row['status']}", "red") for row in found if row["status"] != OK]
        lines = [[to_cell(cell, ".3g") for cell in line] for line in frame.itertuples(index=False)]
        shown = "\n".join(f"![Figure {name}]({name})\n" for name in figures)
        note = "> **Not a medical device.** Lengths in pixels; forces in newtons only where some were measured.\n"
        page = TITLE, f"# {TITLE}\n\n{note}\n{shown}\n{to_markdown([*frame.columns], lines)}\n"
        return Report({"table.csv": frame}, [frame], failed, figures, page, failed=bool(failed))


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge what the command line names; returns the exit status."""
    return run(Real, arguments, "evaluation.real", __doc__)


if __name__ == "__main__":
    run_door(main)
