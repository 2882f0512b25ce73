"""The network's input: windows of the last K frames, built the same way for training and for inference.

A window never reaches across a gap in the frame numbers. The last depth before it stands for a frame without depth,
and where a stretch is shorter than the window its first frame is repeated.
"""

from collections import deque

import numpy as np

from palpate.data.prepared import PreparedFrame


def window_indices(frame: int, length: int, consecutive: np.ndarray, usable: np.ndarray) -> np.ndarray | None:
    """Frames of the window that ends at `frame`, oldest first.

    Args:
        frame: index of the window's last frame.
        length: number of frames K.
        consecutive: mask of frames i whose next number is that of frame i + 1, shape [F].
        usable: mask of frames with depth, shape [F].

    Returns:
        Shape [K], or None where no frame in reach has depth.
    """
    first = frame
    while first > max(frame - length + 1, 0) and consecutive[first - 1]:
        first -= 1
    return _held(range(first, frame + 1), length, usable)


def future_indices(frame: int, length: int, consecutive: np.ndarray, usable: np.ndarray) -> np.ndarray | None:
    """Frames of the time-reversed window that ends at `frame`: the farthest future first (see `window_indices`)."""
    last = frame
    while last < min(frame + length - 1, len(usable) - 1) and consecutive[last]:
        last += 1
    return _held(range(last, frame - 1, -1), length, usable)


def _held(frames: range, length: int, usable: np.ndarray) -> np.ndarray | None:
    """Indices of a window's frames, each unusable one replaced by the last usable one before it; None without any."""
    kept: list[int] = []
    for index in frames:
        if usable[index]:
            kept.append(index)
        elif kept:
            kept.append(kept[-1])
    return np.array([kept[0]] * (length - len(kept)) + kept) if kept else None


class FrameWindow:
    """The window of the latest K frames of a stream."""

    def __init__(self, length: int) -> None:
        """
        Args:
            length: number of frames K.
        """
        self.length = length
        self._depths: deque[np.ndarray] = deque(maxlen=length)
        self._continues = True

    def push(self, prepared: PreparedFrame) -> np.ndarray | None:
        """Add the next frame of the stream.

        Returns:
            Depth window [K, h, w] float32, oldest first, or None where no frame in reach has depth.
        """
        if not self._continues:
            self._depths.clear()
        self._continues = prepared.consecutive
        self._depths.append(prepared.depth)
        kept = _held(range(len(self._depths)), self.length, np.array([depth.any() for depth in self._depths]))
        return None if kept is None else np.stack([self._depths[index] for index in kept])
