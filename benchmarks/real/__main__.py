"""What can be said on real clips, judged on what was kept back from the fit.

    python -m benchmarks.real --data DIR --output OUT
    python -m benchmarks.real --pulled CLIP [--layout YAML] [--masks FILE] --output OUT

--data runs every known clip under a folder (docs/reports/real.md). A pulled clip shows tissue that an instrument holds
and moves: the table has what the session of `infer.py --estimator direct` says of it, its skill in frames that were not
fitted included, and the seconds that the fit takes; `contact_frame_N` is the probability that tissue moves with the
instrument. Writes table.csv (clip, measure, value); the same command judges again what could not be judged. `infer.py`
draws the same session's fit.png. Not a medical device.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from benchmarks.harness import Measurements, Row, run
from benchmarks.real.pulled import PulledClip, evaluate_pull
from palpate.common.provenance import ROOT

KNOWN = {
    "recover_tissue": PulledClip(Path("recover_tissue"), ROOT / "configs/layouts/recover_tissue.yaml"),
    "video01_00080": PulledClip(Path("cholecseg8k/video01/video01_00080")),
}
"""Pulled clips, below the data's folder."""


@dataclass(frozen=True)
class Real(Measurements):
    """What is judged."""

    data: Path | None = None
    """folder of the known clips"""
    pulled: Path | None = None
    """a clip, as infer.py takes it"""
    layout: Path | None = None
    """of the pulled clip: YAML file that names a folder's files (default: CholecSeg8k)"""
    masks: Path | None = None
    """of the pulled clip: outlines of its instruments, or a segmentation model (default: as of infer.py)"""

    keys: ClassVar = ("clip",)

    def __post_init__(self) -> None:
        """Raise a ValueError where options don't belong together."""
        if self.layout is not None and self.pulled is None:
            raise ValueError(f"--layout {self.layout} is of a clip of --pulled; give both, or leave it out.")
        if self.masks is not None and self.pulled is None:
            raise ValueError(f"--masks {self.masks} is of a clip of --pulled; give both, or leave it out.")
        if not self.clips:
            where = "" if self.data is None else f"; {self.data} holds none of {', '.join(KNOWN)}"
            raise ValueError(f"there is nothing to judge{where}. Give --data or --pulled.")

    @functools.cached_property
    def clips(self) -> dict[str, PulledClip]:
        """By their names; a second one of a name is numbered."""
        clips = []
        if self.data is not None:
            below = {name: PulledClip(self.data / clip.path, clip.layout_file) for name, clip in KNOWN.items()}
            clips += [(name, clip) for name, clip in below.items() if clip.path.exists()]
        if self.pulled is not None:
            clips.append((self.pulled.resolve().name, PulledClip(self.pulled, self.layout, self.masks)))
        found: dict[str, PulledClip] = {}
        for name, clip in clips:
            found[f"{name} (2)" if name in found else name] = clip
        return found

    @property
    def wanted(self) -> dict[str, Callable[[], Row]]:
        """What judges each clip, by its name."""
        return {name: functools.partial(evaluate_pull, clip) for name, clip in self.clips.items()}

    def record(self) -> Mapping[str, Any]:
        """What the results depend on."""
        return {f"clip {name}": repr(clip) for name, clip in self.clips.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge what the command line names; returns the exit status."""
    return run(Real, arguments, "benchmarks.real", __doc__)


if __name__ == "__main__":
    run_door(main)
