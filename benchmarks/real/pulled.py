"""Gripped tissue: what the session that users run says of a clip, and how well it predicts frames that it didn't fit.

The session of `direct` is opened on the clip as `infer.py --estimator direct` opens it. Its skill is 1 - error /
motion, root mean squares over the points of a frame: a sheet that is fitted to the first half of the frames in which
the tissue moves with the instrument predicts the others from the motion at the instrument alone; 0 = as good as saying
that nothing moves, 1 = exact.
"""

from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import OK, Row
from palpate.api import open_clip, open_estimator
from palpate.data.source.layout import ClipLayout, load_layout
from palpate.estimators.contract import ClipInfo
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.session import estimates_of


@dataclass(frozen=True)
class PulledClip:
    """A clip as users have it."""

    path: Path
    """Folder of its files, or a video file."""
    layout_file: Path | None = None
    """YAML file that names a folder's files; None = CholecSeg8k's layout."""
    masks: Path | None = None
    """Outlines of its instruments, or a segmentation model; None = annotations where there are any, else automatic."""

    @property
    def layout(self) -> ClipLayout:
        """How its files are named.

        Raises:
            InputError: the layout's file can't be used.
        """
        return ClipLayout() if self.layout_file is None else load_layout(self.layout_file)


def evaluate_pull(clip: PulledClip) -> Row:
    """Open the session and gather what it says, numbers and words by name.

    `status` says why no run of contact tells anything as a grip. The probability of contact in every frame with an
    instrument, by the frame's number, is there whatever becomes of the rest.

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
    known = [item for item in frames if item.contact_probability is not None]
    measures |= {f"contact_frame_{item.frame:04d}": item.contact_probability for item in known}
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
