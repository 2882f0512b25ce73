"""Presses that a path tracer drew, which shares no code with this project, compared with their truth.

    python -m benchmarks.path_traced --data DIR [--given depth] --output runs/path_traced

DIR holds NAME.mp4 with NAME.truth.json, and for some the folder NAME with true masks and depth. `--given video` opens
the MP4 alone, as a user has it; `--given depth` the folder. Tables are those of `benchmarks.plain_video`.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.harness import Measurements, Report, Row, run
from benchmarks.plain_video import SAME_ONSET, compared, summarised
from palpate.api import open_clip
from palpate.data.source.layout import InputError, read_mapping
from palpate.estimators.contract import ClipInfo
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of

TRUTH = ".truth.json"
"""Ending of the files of truth."""


def measured(clip: Path, truth: Mapping[str, Any], options: EstimatorOptions) -> Row:
    """Frames of contact that are found, and errors of the first press that is."""
    estimator = open_estimator(options)
    stream = open_clip(clip, estimator)
    found = list(estimates_of(estimator.start(ClipInfo.of(stream)), stream))
    contact = np.array([output.contact is True for output in found if isinstance(output, FrameEstimate)])
    pressed = np.isin(np.arange(len(contact)), truth["contact_frames"])
    row: Row = {
        "pressed_frames": int(pressed.sum()),
        "pressed_found": int((pressed & contact).sum()),
        "other_frames": int((~pressed).sum()),
        "other_found": int((~pressed & contact).sum()),
    }
    onsets = [frame for frame in truth["contact_frames"] if frame - 1 not in truth["contact_frames"]]
    if onsets:
        row["regime"] = f"damping ratio {truth['zeta']:g}"
    for output in found:
        if isinstance(output, InteractionEstimate) and output.estimate is not None:
            if min(abs(output.onset_frame - onset) for onset in onsets or [np.inf]) <= SAME_ONSET:
                theta = np.array(list(truth["theta"].values()))
                return row | compared(output, theta, truth["distance_mm"] / truth["mm_per_scene_unit"])
            row["verdict"] = output.verdict  # of a press that there isn't
    return {"verdict": "no_estimate"} | row


@dataclass(frozen=True)
class PathTraced(Measurements):
    """Options of the benchmark."""

    data: Path
    """folder of the clips"""
    given: Literal["video", "depth"] = "video"
    """what is given of each"""
    estimator: Literal["direct", "network"] = "direct"
    """which"""

    writes = ("table.csv", "summary.csv")

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Every clip by its name.

        Raises:
            InputError: there are none.
        """
        options, found = EstimatorOptions(self.estimator), {}
        for file in sorted(self.data.glob(f"*{TRUTH}")):
            name = file.name.removesuffix(TRUTH)
            clip = self.data / (name if self.given == "depth" else f"{name}.mp4")
            if clip.exists():
                found[name] = functools.partial(measured, clip, read_mapping(file, "a truth"), options)
        if not found:
            raise InputError(f"{self.data} holds no NAME{TRUTH} beside its clip; give a folder of path-traced clips.")
        return found

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """The measures of every clip, and those of all."""
        report = super().report(rows)
        summary = summarised([row for row in rows.values() if "pressed_frames" in row])
        return Report({**report.tables, "summary.csv": summary}, [*report.tables.values(), summary], report.lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the clips; returns the exit status."""
    return run(PathTraced, arguments, "benchmarks.path_traced", __doc__)


if __name__ == "__main__":
    run_door(main)
