"""Frames that measure nothing are set aside, so that the measurements around them stay neighbours in time.

Repeated pictures, stored depth that repeats, and depth that jumps by a factor count as gaps.
"""

import dataclasses
import math
from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from palpate.data.labels import TISSUE
from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import Frame
from palpate.data.source.repeats import HISTORY, LEAST_HISTORY, MOST_GAPS


def gap(frame: Frame, shape: tuple[int, int], detail: str = "", status: str = "repeated") -> PreparedFrame:
    """Prepare a frame that measures nothing, on a grid [h, w]; by default its picture is that of the frame before."""
    repeats = "The picture repeats the one before, so it is no measurement; record at the camera's own frame rate."
    return PreparedFrame(frame, status, detail or repeats, np.zeros(shape, np.float32), np.zeros(shape, np.uint8))


def bridge_gaps(frames: Iterable[PreparedFrame], stored: bool) -> Iterator[PreparedFrame]:
    """Yield a clip's measurements, each with the gaps before it, numbered by `frame.index`.

    Gaps come as frames of their own, which end a contact, if they are longer than `MOST_GAPS`, at the clip's end, or
    where the depth's scale changes for good.

    Args:
        frames: prepared one by one, in order.
        stored: True = depth is measured, and equal maps are one measurement.
    """
    index, gaps = 0, list[PreparedFrame]()
    last: PreparedFrame | None = None
    jumped: PreparedFrame | None = None
    past: deque[tuple[float, float]] = deque(maxlen=HISTORY)

    def numbered(frame: PreparedFrame) -> PreparedFrame:
        nonlocal index
        frame.frame, index = dataclasses.replace(frame.frame, index=index), index + 1
        return frame

    for frame in frames:
        measures, shape = False, frame.depth.shape
        if frame.status == "repeated":
            gaps.append(frame)
        elif frame.has_depth and last is not None:
            scale, changed = _compared(last, frame)
            usual = np.median(past, axis=0) if len(past) >= LEAST_HISTORY else (0.0, 0.0)
            # Smallest jump of the depth's scale, as a logarithm, and over the median of the clip's own changes.
            limit = max(math.log(1.1), 6.0 * usual[0])
            if stored and changed == 0 and usual[1] > 0.5:
                repeats = "The stored depth repeats that of the frame before, so it is no measurement"
                gaps.append(gap(frame.frame, shape, f"{repeats}; store one map a picture."))
            elif abs(scale) <= limit:
                past.append((abs(scale), changed))
                measures = True
            elif jumped is not None and abs(_compared(jumped, frame)[0]) <= limit:
                yield from map(numbered, gaps)
                gaps, measures = [], True
            else:
                jumps = f"The tissue's depth is {math.exp(scale):.3g} times that of the frame before"
                gaps.append(gap(frame.frame, shape, f"{jumps}; check the scale of this depth map.", "bad_depth"))
                jumped = frame
        else:
            measures = True
        if measures:
            frame.skipped, gaps, jumped = tuple(gaps), [], None
            last = frame if frame.has_depth else last
            yield numbered(frame)
        elif len(gaps) > MOST_GAPS:
            yield from map(numbered, gaps)
            gaps = []
    yield from map(numbered, gaps)


def _compared(before: PreparedFrame, after: PreparedFrame) -> tuple[float, float]:
    """Logarithm of the scale of a frame's tissue against another's, and the share of its pixels that differ."""
    both = (before.labels == TISSUE) & (after.labels == TISSUE) & (before.depth > 0) & (after.depth > 0)
    # Fewest grid pixels of tissue in both frames by which their scales are compared.
    if both.sum() < 50:
        return 0.0, 1.0
    one, other = before.depth[both], after.depth[both]
    return float(np.median(np.log(other / one))), float(np.mean(one != other))
