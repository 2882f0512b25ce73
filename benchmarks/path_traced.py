"""Presses that a path tracer drew, which shares no code with this project, compared with their truth.

    python -m benchmarks.path_traced --data DIR [--given video-masks|masks|depth] --output runs/path_traced

DIR holds NAME.mp4 with NAME.truth.json, and for some the folder NAME with true masks and depth. `--given video` opens
the MP4 alone, as a user has it; `video-masks` with the folder's masks; `depth` the folder; `masks` the folder without
its depth. Lengths and forces count in the tissue's distance, which no plain video shows. table.csv has the measures of
every clip, summary.csv those of all: how often frames under a press are found and others aren't, and of every quantity
how many clips determine it, the median error of its logarithm there, and how often its 90 % interval holds the truth.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from benchmarks.harness import Measurements, Report, Row, run
from palpate.api import open_clip
from palpate.common.doors import run_door
from palpate.data.source.layout import InputError, read_mapping
from palpate.estimators.contract import ClipInfo
from palpate.estimators.estimate import COMBINATIONS, REPORTED
from palpate.estimators.open import open_estimator
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of
from palpate.physics.identifiability import NINETY

TRUTH = ".truth.json"
"""Ending of the files of truth."""


def measured(clip: Path, truth: Mapping[str, Any], name: str, **given: str) -> Row:
    """Frames of contact that are found, and errors of the first press that is; `given` as in `open_clip`."""
    estimator = open_estimator(name)
    stream = open_clip(clip, estimator, **given)
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
    for output in found:
        if isinstance(output, InteractionEstimate) and output.estimate is not None:
            # A run of contact is the true one where it begins within so many frames of it.
            if min(abs(output.onset_frame - onset) for onset in onsets or [np.inf]) <= 2:
                theta = np.array(list(truth["theta"].values()))
                return row | compared(output, theta, truth["distance_mm"] / truth["mm_per_scene_unit"])
            row["verdict"] = output.verdict  # of a press that there isn't
    return {"verdict": "no_estimate"} | row


def compared(found: InteractionEstimate, theta: np.ndarray, distance: float) -> Row:
    """Errors of the logarithm of every quantity, with their standard deviations, and which are determined.

    Args:
        found: the press.
        theta: true k_s, k_d and F, shape [3], of tissue at a true
        distance: [scene units].
    """
    estimate, contact = found.estimate, found.interaction
    assert estimate is not None
    assert contact is not None
    true = theta * [1, 1, contact.mesh.vertices[contact.vertex, 2] / distance]
    row: Row = {"verdict": estimate.verdict, "explained": int(estimate.explained)}
    for name in REPORTED:
        powers = np.array(COMBINATIONS[name])
        off = powers @ np.log(np.abs(estimate.theta / true))
        row |= {f"{name}_error": float(off), f"{name}_determined": int(name in estimate.determined)}
        if estimate.covariance is not None:
            row[f"{name}_sd"] = math.sqrt(max(powers @ estimate.covariance @ powers, 0.0))
    return row


@dataclass(frozen=True)
class PathTraced(Measurements):
    """Options of the benchmark."""

    data: Path
    """folder of the clips"""
    given: Literal["video", "video-masks", "masks", "depth"] = "video"
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
        found = {}
        for file in sorted(self.data.glob(f"*{TRUTH}")):
            name = file.name.removesuffix(TRUTH)
            folder, video = self.data / name, self.data / f"{name}.mp4"
            more = {"masks": {"depth": "photometric"}, "video-masks": {"masks": str(folder)}}.get(self.given, {})
            clip = video if self.given in ("video", "video-masks") else folder
            if clip.exists() and (self.given == "video" or folder.exists()):
                truth = read_mapping(file, "a truth")
                found[name] = functools.partial(measured, clip, truth, self.estimator, **more)
        if not found:
            raise InputError(f"{self.data} holds no NAME{TRUTH} beside its clip; give a folder of path-traced clips.")
        return found

    def record(self) -> Mapping[str, Any]:
        """Inputs and estimator: other results belong in another folder."""
        return {"given": self.given, "estimator": self.estimator}

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """The measures of every clip, and those of all."""
        report = super().report(rows)
        summary = summarised([row for row in rows.values() if "pressed_frames" in row])
        return Report({**report.tables, "summary.csv": summary}, [*report.tables.values(), summary], report.lines)


def summarised(rows: Sequence[Row]) -> pd.DataFrame:
    """Frames found and quantities determined over all clips, a line each."""
    lines = []
    for name in ("pressed", "other"):
        found, frames = (sum(row[f"{name}_{end}"] for row in rows) for end in ("found", "frames"))
        lines.append({"measure": f"{name} frames called contact", "count": found, "of": frames})
    pressed = [row for row in rows if row["pressed_frames"]]
    for name in REPORTED if pressed else ():
        known = [row for row in pressed if row.get(f"{name}_determined")]
        ends = "error", "sd"
        errors, sds = (np.array([row.get(f"{name}_{end}", math.nan) for row in known]) for end in ends)
        line: Row = {"measure": name, "count": len(known), "of": len(pressed)}
        if known:
            line |= {"median error": float(np.median(np.abs(errors)))}
            line["held"] = float(np.mean(np.abs(errors) <= NINETY * sds))
        lines.append(line)
    return pd.DataFrame(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the clips; returns the exit status."""
    return run(PathTraced, arguments, "benchmarks.path_traced", __doc__)


if __name__ == "__main__":
    run_door(main)
