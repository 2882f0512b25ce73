"""Gathers the motion around an instrument over a run of contact, and says what it tells if it is a grip.

Rest is the run's first frame: what the tissue was stretched by before is not known, and counts as none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.labels import TOOL
from data.prepared import PreparedFrame
from data.tracks.background import without_background
from data.tracks.following import PointFollower
from estimators.estimate import NINETY, GripEstimate, NoEstimate
from estimators.grip.sheet_fit import GripFrame, NothingMoves, fit_sheet, skill

DRIVEN = 24.0
"""Points that began nearer to the tool move with it [px]."""
MOST_KEPT = 32
"""Frames that are kept, evenly spread over the run so far: memory does not grow with it."""


@dataclass(frozen=True, eq=False)
class _Kept:
    time_s: float
    frame: GripFrame


class GripRecorder:
    """One run of contact.

    Args:
        first: its first frame, which shows pictures and labels.
    """

    def __init__(self, first: PreparedFrame) -> None:
        picture, labels = first.view
        self._follower = PointFollower(picture, labels == TOOL)
        self._start, self._kept, self._every, self._count = first.frame.time_s, list[_Kept](), 1, 0

    def add(self, frame: PreparedFrame) -> None:
        """The next frame; one without picture or labels is passed over, one out of contact only followed through."""
        if not frame.visible:
            return
        picture, labels = frame.view
        follower = self._follower
        follower.step(picture, labels == TOOL)
        self._count += frame.in_contact
        if not frame.in_contact or self._count % self._every:
            return
        moved = without_background(follower.points, follower.moved, follower.distance).astype(np.float32)
        grip = GripFrame(moved, follower.followed & (follower.distance < DRIVEN))
        self._kept.append(_Kept(frame.frame.time_s - self._start, grip))
        if len(self._kept) > MOST_KEPT:
            self._kept, self._every = self._kept[1::2], 2 * self._every

    def estimate(self) -> GripEstimate:
        """A sheet's one number from the first half of the motion, judged on the second.

        Raises:
            NoEstimate: too little moves, or too few points are seen.
        """
        moving = [kept for kept in self._kept if kept.frame.tells]
        half, points = len(moving) // 2, self._follower.points
        try:
            fit = fit_sheet(points, self._follower.spacing, [kept.frame for kept in moving[:half]], field=False)
        except NothingMoves as error:
            raise NoEstimate(str(error)) from error
        log, sd = fit.mean_log_anchor
        force, force_sd = fit.relative_force([kept.frame for kept in moving])
        return GripEstimate(
            foundation_over_stiffness=float(np.exp(log)),
            foundation_over_stiffness_low=float(np.exp(log - NINETY * sd)),
            foundation_over_stiffness_high=float(np.exp(log + NINETY * sd)),
            skill=float(np.mean([skill(fit, kept.frame) for kept in moving[half:]])),
            times=np.array([kept.time_s for kept in moving]),
            force=force,
            force_sd=force_sd,
        )
