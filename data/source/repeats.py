"""Pictures that repeat the one before: capture lost a frame, or wrote more frames than it recorded.

Where a clip has noise of its own, a picture without any is a repeat. Synthetic pictures and compressed video have none,
and a still scene looks the same: there a picture repeats if it stands still between pictures that move.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import cv2
import numpy as np

from palpate.data.source.frames import Frame

MOST_GAPS = 5
"""Largest number of frames in a row that measure nothing and are bridged."""
HISTORY, LEAST_HISTORY = 5, 3
"""Most and fewest changes by which the next one is judged."""


class _Change(NamedTuple):
    """Difference of two pictures, in levels of green, averaged over squares of 8 px."""

    largest: float
    median: float


def _change(before: np.ndarray, after: np.ndarray) -> _Change:
    height, width = after.shape
    difference, size = cv2.absdiff(before, after).astype(np.float32), (max(width // 8, 1), max(height // 8, 1))
    squares = cv2.resize(difference, size, interpolation=cv2.INTER_AREA)
    return _Change(float(squares.max()), float(np.median(squares)))


def mark_repeats(frames: Iterable[Frame], look_ahead: bool = True) -> Iterator[tuple[Frame, bool]]:
    """Yield every frame with whether its picture repeats the one before.

    Args:
        frames: frames of a clip, in order.
        look_ahead: True = a frame may wait up to 0.1 s for later ones; False = only noise tells a repeat.
    """
    # Largest change of a repeat over that of the pictures around it. In 54 encoded clips repeats reached 0.25 where
    # tissue moved visibly, and other pictures stayed above 0.39.
    most = 0.25
    past: deque[_Change] = deque(maxlen=HISTORY)
    waiting: list[tuple[Frame, _Change, bool]] = []
    last: np.ndarray | None = None
    for frame in frames:
        green = None if frame.image is None else cv2.extractChannel(frame.image, 1)
        if last is None or green is None:
            yield from ((each, certain) for each, _, certain in waiting)
            yield frame, False
            waiting, last = [], green
            past.clear()
            continue
        change, certain, still = _change(last, green), False, False
        if len(past) >= LEAST_HISTORY:
            usual = _Change(*np.median(past, axis=0))
            certain = change.largest < most * usual.median
            # Compression leaves smaller differences than this between equal pictures [levels].
            still = change.largest < min(5.0, most * past[-1].largest, most * usual.largest)
            # Median difference of pictures from which noise alone tells repeats, which are exact there [levels].
            still &= look_ahead and usual.median < 1.0
        last = green
        if certain and not waiting:
            yield frame, True
            continue
        repeats = not still and all(each.largest < most * change.largest for _, each, _ in waiting)
        waiting.append((frame, change, certain))
        # Pictures without noise that stand still for longer are taken for a still scene, as a tool that presses stands.
        if (certain or still) and frame.time_s - waiting[0][0].time_s < 0.1:
            continue
        for each, other, sure in waiting:
            repeat = sure or (repeats and each is not frame)
            yield each, repeat
            if not repeat:
                past.append(other)
        waiting = []
    yield from ((each, certain) for each, _, certain in waiting)
