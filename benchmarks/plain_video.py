"""Plain videos: drawn clips as MP4 alone, through the session that users open, compared with their truth.

    python -m benchmarks.plain_video --suite video --seed 77 --clips 8 --output runs/plain_video

Suites: `video` (presses), `video-moving` (presses, the camera turns), `video-oblique` (presses on tissue that faces up
to 25 degrees aside), `video-patch` (presses on patches, aslant, by a force that rises and falls) and `video-hover` (an
instrument that passes over tissue and never touches). Tissue obeys the law of light that estimators assume; presses by
another renderer, of real light, are judged by `benchmarks.path_traced`.
Nothing but the video is given: masks are automatic, depth is guessed, the light of the tissue is what is measured.
Lengths and forces count in the tissue's distance, which no plain video tells. table.csv has the measures of every clip,
summary.csv those of all: how often frames under a press are found and others aren't, and of every quantity how many
clips determine it, the median error of its logarithm there, and how often its 90 % interval holds the truth.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import functools
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from benchmarks.harness import Measurements, Report, Row, run
from benchmarks.recovery.suites import EVERY, LARGEST_SEED
from palpate.api import open_clip
from palpate.common.options import require_within
from palpate.common.settings import LARGEST
from palpate.data.source.layout import from_mapping
from palpate.data.synthetic.clip import clip_seed, draw_truth, write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import PressedMotion, regime_of
from palpate.estimators.contract import ClipInfo
from palpate.estimators.estimate import COMBINATIONS, NINETY, REPORTED
from palpate.estimators.open import EstimatorOptions
from palpate.estimators.open import open_estimator as open_by_options
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of
from palpate.physics.mechanics import damping_ratio

SAME_ONSET = 2
"""A run of contact is the true one where it begins within so many frames of it."""
SUITES: Mapping[str, Mapping[str, Any]] = {
    "video": {},
    "video-moving": {"turning_deg": 0.5},
    "video-oblique": {"max_tilt_deg": 25.0},
    "video-patch": EVERY["patch"].truth,
    "video-hover": {"action": "grip", "onset_fraction": (1.0, 1.0)},
}
"""Fields of SceneSettings that make each suite."""
HEIGHTS = {854: 480, 1280: 720}
"""Of pictures by their width [px]."""


def measured_video(settings: SceneSettings, seed: int) -> Row:
    """Measures of the video alone of one drawn clip."""
    estimator = open_by_options(EstimatorOptions("direct"))
    scene, truth = draw_truth(settings, seed)
    with tempfile.TemporaryDirectory() as folder:
        stream = open_clip(write_clip(Path(folder), 1, settings, seed).with_suffix(".mp4"), estimator)
        found = list(estimates_of(estimator.start(ClipInfo.of(stream)), stream))
    contact = np.array([output.contact is True for output in found if isinstance(output, FrameEstimate)])
    pressed = truth.in_contact
    # Nothing has moved yet in the frame in which the press begins, and dents recover after it.
    judged = np.arange(len(pressed)) != truth.onset_frame
    row: Row = {
        "pressed_frames": int((pressed & judged).sum()),
        "pressed_found": int((pressed & judged & contact).sum()),
        "other_frames": int((~pressed & judged).sum()),
        "other_found": int((~pressed & judged & contact).sum()),
    }
    runs = [output for output in found if isinstance(output, InteractionEstimate)]
    if not isinstance(truth, PressedMotion):
        verdicts = [run.verdict for run in runs if run.verdict not in ("", "undetermined")]
        return row | {"verdict": ";".join(verdicts) or "undetermined"}
    row["regime"] = regime_of(damping_ratio(truth.theta[0], truth.theta[1], settings.mass))
    right = [run for run in runs if abs(run.onset_frame - truth.onset_frame) <= SAME_ONSET and run.estimate is not None]
    if not right:
        return row | {"verdict": "no_estimate"}
    distance = float(scene.mesh.vertices[scene.vertex, 2])
    estimate = right[0].estimate
    assert estimate is not None
    return row | {"left": estimate.left} | compared(right[0], truth.theta, distance)


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
class PlainVideo(Measurements):
    """What is drawn."""

    suite: Literal[tuple(SUITES)] = "video"  # ty: ignore[invalid-type-form]
    """what the clips show"""
    width: Literal[854, 1280] = 854
    """of the pictures, 480 or 720 pixels high"""
    seed: int = 77
    """of the clips"""
    clips: int = 8
    """how many"""
    frames: int = 32
    """of each clip"""

    writes = ("table.csv", "summary.csv")

    def __post_init__(self) -> None:
        """Raise a ValueError where an option can't be used."""
        require_within(self, seed=(0, LARGEST_SEED), clips=(1, LARGEST), frames=(16, LARGEST))

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Every clip by its number."""
        return {
            str(index): functools.partial(measured_video, self.settings, clip_seed(self.seed, index))
            for index in range(self.clips)
        }

    @property
    def settings(self) -> SceneSettings:
        """What the clips are drawn from."""
        size: dict[str, Any] = {"width": self.width, "height": HEIGHTS[self.width], "frames": self.frames}
        return from_mapping(SceneSettings, {**size, **SUITES[self.suite]}, f"The suite {self.suite}")

    def record(self) -> Mapping[str, Any]:
        """What the clips are drawn from."""
        return asdict(self.settings) | {"seed": self.seed}

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """The measures of every clip, and those of all."""
        report = super().report(rows)
        summary = summarised([rows[name,] for name in self.wanted if (name,) in rows and "status" not in rows[name,]])
        return Report({**report.tables, "summary.csv": summary}, [summary], report.lines, failed=report.failed)


def summarised(rows: Sequence[Row]) -> pd.DataFrame:
    """Frames found and quantities determined over all clips, a line each."""
    lines = []
    for name in ("pressed", "other"):
        found, frames = (sum(row[f"{name}_{end}"] for row in rows) for end in ("found", "frames"))
        lines.append({"measure": f"{name} frames called contact", "count": found, "of": frames})
    pressed = [row for row in rows if "regime" in row]
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
    return run(PlainVideo, arguments, "benchmarks.plain_video", __doc__)


if __name__ == "__main__":
    run_door(main)
