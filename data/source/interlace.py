"""Detection of interlaced video by its motion, without its flags, and deinterlacing.

Even and odd rows of a progressive frame show the same instant, those of an interlaced one instants half a frame apart.
The time offset between them, in frame intervals, is measured by regression. I are the even rows interpolated to the odd
ones, O the odd rows, and dI, dO half their change from the frame before to the frame after:

    O − I = offset · dI        offset = Σ dO (O − I) / Σ dO dI

dO is the instrumental variable, whose noise is independent of that of dI.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress

import av
import cv2
import numpy as np
from av.filter import Graph
from av.video.reformatter import VideoReformatter

LARGEST_OFFSET = 0.25
"""Largest absolute offset of progressive video, below 0.01 in measurements; interlaced video has 0.65 to 0.79."""


class FieldOffset:
    """Time offset between odd and even rows of consecutive frames."""

    def __init__(self) -> None:
        self._recent: deque[np.ndarray] = deque(maxlen=3)
        """Even rows interpolated to the odd ones, and odd rows, of the last frames, shape [2, h, w] each."""
        self._sums = np.zeros(4)
        self._reformatter = VideoReformatter()

    def push(self, frame: av.VideoFrame) -> None:
        """Add the next frame."""
        luma = self._reformatter.reformat(frame, format="gray", threads=1).to_ndarray()
        # Neighbouring columns that are averaged [px]; more reduces noise and detail.
        luma = cv2.resize(luma, (max(frame.width // 4, 1), frame.height), interpolation=cv2.INTER_AREA)
        luma = luma[: (len(luma) - 1) // 2 * 2 + 1].astype(np.float32)
        rows = np.stack([(luma[:-2:2] + luma[2::2]) / 2, luma[1::2]])
        if self._recent and rows.shape != self._recent[-1].shape:
            self._recent.clear()
        self._recent.append(rows)
        if len(self._recent) == 3:
            before, now, after = self._recent
            even, odd = (after - before) / 2
            pairs = (odd, now[1] - now[0]), (odd, even), (odd, odd), (even, even)
            self._sums += [np.vdot(first, second) for first, second in pairs]

    def skip(self) -> None:
        """Forget the frames before: the next one doesn't follow them."""
        self._recent.clear()

    @property
    def value(self) -> float | None:
        """Offset in frame intervals, positive where even rows come first; None where too little moves."""
        misfit, common, odd, even = self._sums
        # Least correlation of dI and dO at which the offset is known: 0 of still scenes with noise, above 0.6 with
        # motion.
        known = common > 0.25 * np.sqrt(odd * even)
        return float(misfit / common) if known else None


def filtered(frames: Iterable[av.VideoFrame], name: str, options: str) -> Iterator[av.VideoFrame]:
    """Frames after one of FFmpeg's filters, as many as come in; it begins anew where their size changes."""
    graph, shape = None, None
    for frame in frames:
        if graph is None or shape != (frame.width, frame.height, frame.format.name):
            if graph is not None:
                yield from _pulled(graph, None)
            graph, shape = Graph(), (frame.width, frame.height, frame.format.name)
            width, height, unit = frame.width, frame.height, frame.time_base
            buffer = graph.add_buffer(width=width, height=height, format=frame.format, time_base=unit)
            graph.link_nodes(buffer, graph.add(name, options), graph.add("buffersink")).configure()
        yield from _pulled(graph, frame)
    if graph is not None:
        yield from _pulled(graph, None)


def _pulled(graph: Graph, frame: av.VideoFrame | None) -> Iterator[av.VideoFrame]:
    """Frames that come out when one is pushed, or the rest of them."""
    graph.vpush(frame)
    with suppress(BlockingIOError, EOFError):
        while True:
            yield graph.vpull()
