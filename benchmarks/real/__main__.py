"""Evaluation on real clips, judged on frames kept back from the fit.

    python -m benchmarks.real --data DIR --output OUT
    python -m benchmarks.real --pulled CLIP [--layout YAML] [--masks FILE] --output OUT

--data runs every known clip under a folder (docs/reports/real.md). A pulled clip shows tissue that an instrument holds
and moves. The table has the results of `infer.py --estimator direct` and the seconds that the fit takes.

A sheet is fitted to the first half of the frames in which the tissue moves with the instrument. It predicts the others
from the motion at the instrument alone. Skill is 1 - error / motion, root mean squares over the points of a frame: 0 =
as good as no motion, 1 = exact. `contact_frame_N` is the probability that tissue moves with the instrument.

Writes table.csv (clip, measure, value); the same command tries failed clips again. `infer.py` draws the same session's
fit.png. Not a medical device.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from benchmarks.harness import OK, Measurements, Row, run
from palpate.api import open_clip, open_estimator
from palpate.common.doors import run_door
from palpate.estimators.contract import ClipInfo
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of


@dataclass(frozen=True)
class PulledClip:
    """Files of a clip of a grip."""

    path: Path
    """Folder of its files, or a video file."""
    layout_file: Path | None = None
    """YAML file that names a folder's files; None = CholecSeg8k's layout."""
    masks: Path | None = None
    """Outlines of its instruments, or a segmentation model; None = annotations where there are any, else automatic."""


def evaluate_pull(clip: PulledClip) -> Row:
    """Measures of a clip by name.

    `status` is the reason if there is no grip. The probability of contact in every frame with an instrument is there in
    any case.

    Raises:
        InputError: the clip can't be read.
    """
    estimator = open_estimator("direct")
    stream = open_clip(clip.path, estimator, layout=clip.layout_file, masks=clip.masks and str(clip.masks))
    session = estimator.start(ClipInfo.of(stream))
    outputs = list(estimates_of(session, stream))
    frames = [item for item in outputs if isinstance(item, FrameEstimate)]
    runs = [item for item in outputs if isinstance(item, InteractionEstimate)]
    measures: Row = {"status": OK, "frames": len(frames)}
    measures["frames in contact"] = sum(item.contact is True for item in frames)
    known = [item for item in frames if item.touch.contact_probability is not None]
    measures |= {f"contact_frame_{item.frame:04d}": item.touch.contact_probability for item in known}
    gripped = [(run, run.grip) for run in runs if run.grip is not None]
    if not gripped:
        return measures | {"status": " ".join(run.detail for run in runs) or "No run of contact was found."}
    run, grip = max(gripped, key=lambda pair: len(pair[1].times))
    measures |= {
        "run from frame": run.onset_frame,
        "frames that move": len(grip.times),
        "verdict": grip.verdict,
        "determined": ";".join(grip.determined),
        "skill in frames kept back": grip.skill,
        "skill if gripped elsewhere": grip.rival,
        "seconds of following": session.seconds["follow"],
        "seconds of the fit": session.seconds["grip"],
    }
    return measures


LAYOUTS = Path(__file__).resolve().parents[2] / "configs" / "layouts"
KNOWN = {
    "recover_tissue": PulledClip(Path("recover_tissue"), LAYOUTS / "recover_tissue.yaml"),
    "video01_00080": PulledClip(Path("cholecseg8k/video01/video01_00080")),
}
"""Pulled clips, below the data's folder."""


@dataclass(frozen=True)
class Real(Measurements):
    """Clips to judge."""

    data: Path | None = None
    """folder of the known clips"""
    pulled: Path | None = None
    """a clip, as infer.py takes it"""
    layout: Path | None = None
    """of the pulled clip: YAML file that names a folder's files (default: CholecSeg8k)"""
    masks: Path | None = None
    """of the pulled clip: outlines of its instruments, or a segmentation model (default: as in infer.py)"""

    keys: ClassVar = ("clip",)

    def __post_init__(self) -> None:
        """Raise a ValueError where options don't belong together."""
        for name in ("layout", "masks"):
            if (given := getattr(self, name)) is not None and self.pulled is None:
                raise ValueError(f"--{name} {given} is of a clip of --pulled; give both, or leave it out.")
        if not self.clips:
            where = "" if self.data is None else f"; {self.data} holds none of {', '.join(KNOWN)}"
            raise ValueError(f"there is nothing to judge{where}. Give --data or --pulled.")

    @functools.cached_property
    def clips(self) -> dict[str, PulledClip]:
        """Clips by their names."""
        found: dict[str, PulledClip] = {}
        if self.data is not None:
            below = {name: PulledClip(self.data / clip.path, clip.layout_file) for name, clip in KNOWN.items()}
            found = {name: clip for name, clip in below.items() if clip.path.exists()}
        if self.pulled is not None:
            found[self.pulled.resolve().name] = PulledClip(self.pulled, self.layout, self.masks)
        return found

    @property
    def wanted(self) -> dict[str, Callable[[], Row]]:
        """Work on each clip by name."""
        return {name: functools.partial(evaluate_pull, clip) for name, clip in self.clips.items()}

    def record(self) -> Mapping[str, Any]:
        """Record of everything the results depend on."""
        return {f"clip {name}": repr(clip) for name, clip in self.clips.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge what the command line names; returns the exit status."""
    return run(Real, arguments, "benchmarks.real", __doc__)


if __name__ == "__main__":
    run_door(main)
