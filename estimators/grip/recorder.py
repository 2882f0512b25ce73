"""Gathers the motion around an instrument over a run of contact, and says what it tells if it is a grip.

Rest is the run's first frame: what the tissue was stretched by before is not known, and counts as none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.background import without_background
from palpate.data.tracks.following import PointFollower, Shown, shrunk
from palpate.estimators.estimate import NINETY, NoEstimate
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.grip.lattice import LEAST_FRAMES, LEAST_MOTION, GripFrame, SheetFit, fit_sheet, skill
from palpate.estimators.grip.sheet import FoundationFit, Measuring, NoSheet, PointGrid, SeenFrame, fit_foundation
from palpate.estimators.grip.stiffness_fit import StiffnessField, fit_stiffness
from palpate.estimators.model_errors import MODEL_ERRORS

DRIVEN = 24.0
"""Points that began nearer to the tool move with it [px]."""
ELSEWHERE = 100.0
"""Tissue that began farther from the tool may be taken as another grip, to compare [px]."""
MOST_KEPT = 32
"""Frames that are kept, evenly spread over those so far that tell anything: memory does not grow with the run."""


@dataclass(frozen=True, eq=False)
class _Kept:
    time_s: float
    frame: GripFrame
    noise: np.ndarray
    """Of its points, shape [N] [px]."""
    shown: Shown
    """Its picture."""

    @property
    def seen(self) -> SeenFrame:
        """Its points."""
        return SeenFrame(self.frame.moved, self.noise)


class GripRecorder:
    """One run of contact.

    Args:
        first: its first frame, which shows pictures and labels.
    """

    def __init__(self, first: PreparedFrame) -> None:
        picture, labels = first.view
        self._follower = PointFollower(picture, labels == TOOL)
        self._picture = shrunk(picture, labels == TOOL)[0]
        self._start, self._kept, self._every = first.frame.time_s, list[_Kept](), 1
        self._seen, self._count = 0, 0

    def add(self, frame: PreparedFrame) -> None:
        """The next frame; one without picture or labels is passed over, one out of contact only followed through."""
        if not frame.visible:
            return
        picture, labels = frame.view
        follower = self._follower
        follower.step(picture, labels == TOOL)
        if not frame.in_contact:
            return
        self._seen += 1
        moved, gripped = follower.moved, follower.followed & (follower.distance < DRIVEN)
        if not GripFrame(without_background(follower.points, moved, follower.distance), gripped).tells:
            return
        grip = GripFrame(moved.astype(np.float32), gripped)
        self._count += 1
        if self._count % self._every:
            return
        self._kept.append(_Kept(frame.frame.time_s - self._start, grip, follower.noise, follower.shown))
        if len(self._kept) > MOST_KEPT:
            self._kept, self._every = self._kept[1::2], 2 * self._every

    def estimate(self) -> GripEstimate:
        """A sheet's one number, judged on the second half of the motion by what the first half tells.

        Raises:
            NoEstimate: too little moves, or too few points are visible.
        """
        kept, half, points = self._kept, len(self._kept) // 2, self._follower.points
        if half < LEAST_FRAMES:
            raise NoEstimate(
                f"In {self._count} of {self._seen} frames the tissue moves with the instrument by more than "
                f"{LEAST_MOTION:g} px and enough of it is seen; {2 * LEAST_FRAMES} are needed."
            )
        spacing, frames = self._follower.spacing, [item.frame for item in kept]
        # Whether the tissue moves with the instrument is judged by what moves against far tissue; how, with the
        # background's motion found together with the sheet's, because far tissue is pulled along, too.
        distance = self._follower.distance
        against = [replace(frame, moved=without_background(points, frame.moved, distance)) for frame in frames]
        judged = fit_sheet(points, spacing, against[:half])
        fit = self._determined(frames)
        known = _interval("foundation_over_stiffness", fit.log_anchor, fit.log_anchor_sd)
        known |= _interval("reaction_over_stiffness", fit.log_force, fit.log_force_sd)
        known |= {"times": np.array([item.time_s for item in kept]), "force": fit.force, "force_sd": fit.force_sd}
        rival = _rival_skill(points, spacing, distance, against)
        found = GripEstimate(skill=_mean_skill(judged, against[half:]), rival=rival, widens=fit.widens, **known)
        if not found.explained:
            return found
        moved = np.stack([frame.moved for frame in frames])
        return replace(found, stiffness=self._stiffness(), points=points, moved=moved, sheet=fit.sheet)

    @property
    def _grid(self) -> PointGrid:
        follower = self._follower
        return PointGrid(follower.points.astype(np.float64), follower.distance, follower.hidden, follower.spacing)

    def _stiffness(self) -> StiffnessField | None:
        """Where the tissue is stiffer, by the last frame; None where no sheet can be fitted."""
        last = self._kept[-1]
        try:
            seen = SeenFrame(last.frame.moved.astype(np.float64), last.noise)
            return fit_stiffness(self._grid, seen, self._picture)
        except NoSheet:
            return None

    def _determined(self, frames: Sequence[GripFrame]) -> FoundationFit:
        """Foundation and force of a sheet.

        Points at the tool are followed badly. Where a sheet explains the others to within their noise, the grip's own
        motion is not taken from them; where it does not, unknown forces would explain too much, and it is.
        """
        follower = self._follower

        def measure(number: int, motion: np.ndarray, which: np.ndarray) -> SeenFrame:
            return SeenFrame(*follower.measured(self._kept[number].shown, motion.astype(np.float32), which))

        again = Measuring(follower.everywhere, measure)
        try:
            return fit_foundation(self._grid, [item.seen for item in self._kept], again)
        except NoSheet:
            held = fit_sheet(self._grid.points, follower.spacing, frames, background=True)
            pull, pull_sd = held.log_force(frames[-1])
            errors = MODEL_ERRORS.foundation_as_seen, MODEL_ERRORS.force_as_seen
            sd, pull_sd = np.hypot([held.log_anchor_sd, pull_sd], errors)
            return FoundationFit(pull, float(pull_sd), *held.relative_force(frames), held.log_anchor, float(sd))


def _interval(name: str, log: float, sd: float) -> dict[str, Any]:
    """A quantity of that name and its 90 % interval, by its logarithm and the standard deviation of that."""
    return {f"{name}{end}": math.exp(log + way * NINETY * sd) for end, way in (("", 0), ("_low", -1), ("_high", 1))}


def _mean_skill(fit: SheetFit, frames: Sequence[GripFrame]) -> float:
    return float(np.mean([skill(fit, frame) for frame in frames]))


def _rival_skill(points: np.ndarray, spacing: int, distance: np.ndarray, frames: Sequence[GripFrame]) -> float:
    """Skill if as many points as are gripped were so around the one that moves most, far from the tool.

    Args:
        points, distance: places at rest [N, 2] and distances from the tool there [N] [px].
        spacing: of the points [px].

    Returns:
        -∞ where too few points are visible there in all frames, or too little of them moves.
    """
    seen = np.logical_and.reduce([np.isfinite(frame.moved).all(axis=1) for frame in frames])
    far = seen & (distance > ELSEWHERE)
    if not far.any():
        return -math.inf
    moved = np.where(far, np.linalg.norm(frames[-1].moved, axis=1), -1.0)
    away = np.where(seen, np.linalg.norm(points - points[np.argmax(moved)], axis=1), np.inf)
    gripped = np.zeros(len(points), bool)
    gripped[np.argsort(away)[: min(int(frames[-1].gripped.sum()), int(seen.sum()))]] = True
    found = [replace(frame, gripped=gripped) for frame in frames]
    found = [frame for frame in found if frame.tells]
    half = len(found) // 2
    if half < LEAST_FRAMES:
        return -math.inf
    return _mean_skill(fit_sheet(points, spacing, found[:half]), found[half:])
