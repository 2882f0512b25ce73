"""Recorder of tissue points around an instrument over a run of contact, and the fit of a sheet to their motion.

Rest is the run's first frame: how the tissue was stretched before is unknown.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palpate.common.robust import affine_terms
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.background import without_background
from palpate.data.tracks.following import PointFollower
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.grip_estimate import PullResult, force_error
from palpate.estimators.grip.lattice import LEAST_GRIPPED, LEAST_MOTION, GripFrame, fit_sheets

DRIVEN = 24.0
"""Points that began nearer to the tool move with it [px]."""
LEAST_FRAMES = 3
"""Least number of moving frames to fit, and to judge."""
MOST_KEPT = 32
"""Number of frames that are kept, evenly spread over the moving ones: memory does not grow with the run."""


class _Kept(NamedTuple):
    time_s: float
    moved: np.ndarray
    """Displacement of the points, shape [N, 2] [px]; NaN where a point is lost."""
    own: np.ndarray
    """Motion less the background's motion."""


@dataclass(frozen=True, eq=False)
class PullMotion:
    """Motion of N points around an instrument over one run of contact, from which a pull is estimated."""

    points: np.ndarray
    """Places at rest, shape [N, 2] [px]."""
    spacing: int
    """Spacing of their grid [px]."""
    distance: np.ndarray
    """Distance from the instrument at rest, shape [N] [px]."""
    kept: list[_Kept]
    """Moving frames, evenly spread over the run."""
    count: int
    """Number of moving frames."""
    frames: int
    """Number of frames in contact."""

    def estimate(self) -> PullResult:
        """Fit the sheet: skill on the second half of the motion by the first half's α, the force by all frames.

        Raises:
            NoEstimate: too little moves, or too few points are visible.
        """
        half, points = len(self.kept) // 2, self.points
        if half < LEAST_FRAMES:
            problem = f"In {self.count} of {self.frames} frames the tissue moves with the instrument by more than"
            raise NoEstimate(f"{problem} {LEAST_MOTION:g} px and enough of it is seen; {2 * LEAST_FRAMES} are needed.")
        times, moved, own = (np.array(values, np.float64) for values in zip(*self.kept, strict=True))
        visible = np.asarray(np.isfinite(moved).all(axis=(0, 2)))
        gripped = visible & (self.distance < DRIVEN)
        if gripped.sum() < LEAST_GRIPPED:
            raise NoEstimate(f"{gripped.sum()} points at the tool are seen in all frames; {LEAST_GRIPPED} are needed.")
        terms = affine_terms(points)
        # Known at all points that are seen, and affine.
        background = np.linalg.lstsq(terms[visible], np.hstack([*(moved - own)[:, visible]]), rcond=None)[0]
        background = np.moveaxis(background.reshape(3, -1, 2), 1, 0)
        fit = fit_sheets(points, self.spacing, gripped, moved, background)
        force, spread = fit.relative_force()
        found = fit.skill(half)
        # Standard deviation of the relative force over `force_error`: on 21 synthetic pulls (docs/reports/real.md). How
        # many of their intervals hold by it is told by `python -m benchmarks.recovery --suite retraction foundation
        # regions --split validation --clips 7 --seed 61001 --output OUT`.
        force_sd = np.hypot(spread, 0.32 * force_error(force, found))
        force_sd[-1] = 0.0  # the last frame's ratio is 1 by definition
        return PullResult(found, self._rival_skill(visible, int(gripped.sum()), own), times, force, force_sd)

    def _rival_skill(self, seen: np.ndarray, count: int, own: np.ndarray) -> float:
        """Return the skill of a grip around the point that moves most far from the tool; -∞ where too little moves
        there.

        Args:
            seen: points visible in all frames, shape [N], bool.
            count: number of points that are gripped.
            own: displacement less the background's, shape [T, N, 2] [px].
        """
        points, distance = self.points, self.distance
        # Tissue that began farther from the tool may be taken as another grip, to compare [px].
        far = seen & (distance > 100.0)
        if not far.any():
            return -math.inf
        most = np.argmax(np.where(far, np.linalg.norm(own[-1], axis=1), -1.0))
        apart = np.where(seen, np.linalg.norm(points - points[most], axis=1), np.inf)
        gripped = np.zeros(len(points), bool)
        gripped[np.argsort(apart)[:count]] = True
        moving = own[[GripFrame(frame, gripped).moves for frame in own]]
        count = min(len(moving), 8)
        half = count // 2
        if half < LEAST_FRAMES:
            return -math.inf
        used = moving[np.linspace(0, len(moving) - 1, count).round().astype(int)]
        return fit_sheets(points, self.spacing, gripped, used, np.zeros((len(used), 3, 2))).skill(half)


class GripRecorder:
    """One run of contact.

    Args:
        first: its first frame, which shows pictures and labels.
    """

    def __init__(self, first: PreparedFrame) -> None:
        self._follower = PointFollower(first.shown)
        self._start, self._kept, self._every = first.frame.time_s, list[_Kept](), 1
        self._seen, self._count = 0, 0

    def add(self, frame: PreparedFrame) -> None:
        """Follow the points into the next frame; one without picture or labels is passed over."""
        if not frame.visible:
            return
        follower = self._follower
        follower.step(frame.shown)
        if not frame.in_contact:
            return
        self._seen += 1
        moved = follower.moved
        own = without_background(follower.points, moved, follower.distance)
        if not GripFrame(own, follower.followed & (follower.distance < DRIVEN)).moves:
            return
        self._count += 1
        if self._count % self._every:
            return
        self._kept.append(_Kept(frame.frame.time_s - self._start, moved.astype(np.float32), own.astype(np.float32)))
        if len(self._kept) > MOST_KEPT:
            self._kept, self._every = self._kept[1::2], 2 * self._every

    def motion(self) -> PullMotion:
        """Return what has been recorded."""
        follower = self._follower
        points = follower.points.astype(np.float64)
        return PullMotion(points, follower.spacing, follower.distance, self._kept, self._count, self._seen)
