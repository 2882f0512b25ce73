"""Contact by a dent alone: tissue that sinks at one place, whatever presses it there, in view or not.

In every frame the depth is compared with that of frames at rest before it (`data.contact.depth_change`). A dent shows a
frame after the force has begun, so the onset is the last frame without it; and it becomes shallower a frame after the
force has ended, so the release is the last frame before that. Frames wait until both are known.
"""

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from palpate.data.contact.depth_change import MIN_REST, SCALES, DepthChange, RestingTissue, grid_motion, picture_motion
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera
from palpate.data.tracks.following import Shown

EARLIER, LATE = 3, 8
"""Frames wait for so many others, while nothing presses and while something does: when a dent is clear, or clearly
shallower, it may have been so for that long."""
CLEAR, SHOWN = 6.0, 4.0
"""A dent is clear, and is there at all, at so many standard deviations."""
NEAR = 2
"""From frame to frame a dent's deepest place stays within so many rows and columns [grid px]."""
MAX_SHARE = 0.1
"""A dent whose inner half covers a larger share of the tissue isn't local."""
FALLEN = 0.08
"""A dent that is clearly, and by this share, shallower than it was is released: a sheet hardly swings under a load."""
PEAK_SHARE, PEAK_NOISE = 0.03, 2.0
"""Depths within this share of the deepest, or so many standard deviations, are as deep."""
EARLY = "Too few frames at rest came before this one to recognise a dent."
RECOVERS = "The dent of the press before has not gone yet."
RECOVERY_SECONDS = 1.0
"""After this time what is left of a dent counts as the tissue's shape at rest [s]."""


@dataclass(eq=False)
class _Waiting:
    """A frame that is not decided yet."""

    prepared: PreparedFrame
    change: DepthChange | None
    motion: np.ndarray = field(default_factory=lambda: np.eye(3))
    """Of the picture from this frame to the latest, shape [3, 3]."""
    place: tuple[int, int] | None = None
    """Row and column of the dent under whose press it is; None where it isn't in contact."""
    recovers: bool = False
    """Whether the dent of a press that has ended is still in it."""
    depth: np.ndarray = field(default_factory=lambda: np.full(len(SCALES), np.nan))
    """Of the dent there, shape [S] [scene units]; not a number where it isn't visible."""


@dataclass(eq=False)
class _Dent:
    """The dent that is followed."""

    place: np.ndarray
    """Row and column in the latest frame; goes with the picture, shape [2]."""
    deepest: np.ndarray
    """Its largest depth so far, shape [S] [scene units]."""
    time_s: float
    """Of the latest frame with load [s]."""
    released: bool = False


class DentContacts:
    """Finds one clip's presses by their dents: gives frames late, those under a press in contact.

    Args:
        camera: intrinsics of the grid.
        settings: of the geometry.
    """

    def __init__(self, camera: Camera, settings: GeometrySettings) -> None:
        self._camera, self._settings = camera, settings
        self._rest = RestingTissue()
        self._waiting: deque[_Waiting] = deque()
        self._shown: Shown | None = None
        """Picture of the latest frame."""
        self._dent: _Dent | None = None

    def push(self, frame: PreparedFrame) -> list[PreparedFrame]:
        """The next frame; gives those, in order, of which it is now known whether they are in contact."""
        decided = []
        last = self._waiting[-1].prepared if self._waiting else None
        if frame.status != "no_contact" or (last is not None and not frame.follows(last.frame.number)):
            # A press that goes on out of view has no known release, and tissue may be another behind the gap.
            decided += self.finish()
            self._rest, self._dent = RestingTissue(), None
            if frame.status != "no_contact":
                return [*decided, frame]
        motion = self._motion(frame)
        self._rest.move(motion)
        for item in self._waiting:
            item.motion = motion @ item.motion
        change = self._rest.change(frame)
        if len(self._rest) < MIN_REST:
            frame.detail = EARLY
        self._waiting.append(_Waiting(frame, change))
        if self._dent is None:
            self._look()
        else:
            self._follow(self._dent, motion)
        while len(self._waiting) > (EARLIER if self._dent is None else LATE):
            decided.append(self._first())
        return decided

    def _motion(self, frame: PreparedFrame) -> np.ndarray:
        """Motion of the picture on the grid from the frame before to this one, shape [3, 3]."""
        before, self._shown = self._shown, frame.shown
        if before is None or not self._waiting:
            return np.eye(3)
        return grid_motion(picture_motion(before, self._shown), before, frame)

    def finish(self) -> list[PreparedFrame]:
        """The frames that are left at the clip's end."""
        return [self._first() for _ in range(len(self._waiting))]

    def _first(self) -> PreparedFrame:
        """The frame that has waited longest."""
        item = self._waiting.popleft()
        frame = item.prepared
        if item.place is not None:
            frame.press_at(item.place[::-1], self._camera, self._settings)
        elif item.recovers:
            frame.detail = RECOVERS
        elif self._dent is None:
            self._rest.push(frame, item.motion)
        return frame

    def _look(self) -> None:
        """Whether a dent has come: clear in the latest frame, and there in the one before it."""
        *before, latest = self._waiting
        if latest.change is None or not before or before[-1].change is None:
            return
        sigmas = latest.change.sigmas()
        shown = cv2.dilate(before[-1].change.sigmas(), np.ones((2 * NEAR + 1,) * 2)) >= SHOWN
        dents = np.where(shown & (sigmas >= CLEAR), sigmas, -np.inf)
        row, column = np.unravel_index(np.argmax(dents), dents.shape)
        place = int(row), int(column)
        if np.isinf(dents[place]) or not _is_local(sigmas, place):
            return
        earlier, there = [latest], place
        latest.place = place
        for item in reversed(before):
            found = None if item.change is None else _near(item.change.sigmas(), there, SHOWN)
            if found is None:
                break
            item.place = there = found
            earlier.append(item)
        start = len(self._waiting) - len(earlier) - 1
        if start >= 0:
            # A dent shows in the frame after the one in which the force began.
            self._waiting[start].place = there
        for item in earlier:
            item.depth = _depth(item, item.place)
        deepest = np.fmax.reduce([item.depth for item in earlier])
        self._dent = _Dent(np.array(place, np.float64), deepest, latest.prepared.frame.time_s)

    def _follow(self, dent: _Dent, motion: np.ndarray) -> None:
        """The latest frame of a dent: still under load, released, or gone; `motion`: the picture's to it."""
        latest = self._waiting[-1]
        dent.place = (motion @ [*dent.place[::-1], 1.0])[1::-1]
        place = tuple(np.rint(dent.place).astype(int).clip(0, np.array(latest.prepared.depth.shape) - 1).tolist())
        if dent.released:
            late = latest.prepared.frame.time_s - dent.time_s > RECOVERY_SECONDS
            gone = latest.change is not None and _near(latest.change.sigmas(), place, SHOWN) is None
            latest.recovers = not gone
            if late:
                self._rest = RestingTissue()
            if late or gone:
                self._dent = None
            return
        latest.place, latest.depth = place, _depth(latest, place)
        dent.deepest = np.fmax(dent.deepest, latest.depth)
        if latest.change is not None:
            self._release(dent, latest.change.noise)

    def _release(self, dent: _Dent, noise: np.ndarray) -> None:
        """Contact ends at the last frame that is as deep as any: the force has ended by the one after it."""
        items = list(self._waiting)
        now, before = (dent.deepest - item.depth for item in (items[-1], items[-2]))
        fallen = (now > np.maximum(CLEAR * noise, FALLEN * dent.deepest)) & (before > 0.5 * CLEAR * noise)
        if not fallen.any():
            return
        scale = int(np.argmax(fallen))
        as_deep = max(PEAK_SHARE * dent.deepest[scale], PEAK_NOISE * noise[scale])
        deep = dent.deepest[scale] - min(as_deep, now[scale] / 2)
        last = max((index for index, item in enumerate(items) if item.depth[scale] >= deep), default=0)
        for item in items[last:]:
            item.place, item.recovers = None, True
        dent.released, dent.time_s = True, items[last].prepared.frame.time_s


def _depth(item: _Waiting, place: tuple[int, int] | None) -> np.ndarray:
    """Of a dent in a frame over all scales, shape [S] [scene units]; not a number where its place isn't visible."""
    if item.change is None or place is None:
        return np.full(len(SCALES), np.nan)
    return item.change.contrast[:, *place]


def _near(sigmas: np.ndarray, place: tuple[int, int], least: float) -> tuple[int, int] | None:
    """Row and column of the largest value near a place; None where it is below the least."""
    top, left = max(place[0] - NEAR, 0), max(place[1] - NEAR, 0)
    window = sigmas[top : place[0] + NEAR + 1, left : place[1] + NEAR + 1]
    row, column = np.unravel_index(np.argmax(window), window.shape)
    if window[row, column] < least:
        return None
    return top + int(row), left + int(column)


def _is_local(sigmas: np.ndarray, place: tuple[int, int]) -> bool:
    """Whether what is at least half as deep as a place, and joined to it, is a small share of the tissue."""
    _, number = cv2.connectedComponents((sigmas >= 0.5 * sigmas[place]).astype(np.uint8))
    return (number == number[place]).sum() <= MAX_SHARE * np.isfinite(sigmas).sum()
