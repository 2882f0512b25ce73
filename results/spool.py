"""Frames that wait on disk until it is known what is to be drawn on them; memory does not grow with their number."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from palpate.estimators.records import FrameEstimate


class Waiting(NamedTuple):
    """A frame that is to be drawn."""

    image: np.ndarray | None
    """RGB, uint8 [H, W, 3]; None where it could not be read."""
    labels: np.ndarray | None
    """Label map, uint8 [h, w]; None where there is none."""
    estimate: FrameEstimate


class FrameSpool:
    """Frames in the order in which they came, in a file without a name that ends with the program.

    Args:
        folder: where the file is; its disk must hold the frames.

    Raises:
        OSError: the file can't be written (also from the methods).
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (closed by `close`)
        self._entries: list[tuple[FrameEstimate, int, int]] = []

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, frame: Waiting) -> None:
        """Append a frame."""
        image = None if frame.image is None else cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
        picture = self._write(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])
        labels = self._write(".png", frame.labels, [])
        self._entries.append((frame.estimate, picture, labels))

    def drain(self) -> Iterator[Waiting]:
        """All frames, once; the spool is empty then."""
        entries, self._entries = self._entries, []
        self._file.seek(0)
        for estimate, picture, labels in entries:
            image = self._read(picture, cv2.IMREAD_COLOR_RGB)
            yield Waiting(image, self._read(labels, cv2.IMREAD_UNCHANGED), estimate)
        self._file.seek(0)
        self._file.truncate()

    def close(self) -> None:
        """Forget all."""
        self._file.close()

    def _write(self, suffix: str, pixels: np.ndarray | None, options: list[int]) -> int:
        """How many bytes pixels became; 0 = there were none."""
        if pixels is None:
            return 0
        encoded = cv2.imencode(suffix, pixels, options)[1].tobytes()
        self._file.write(encoded)
        return len(encoded)

    def _read(self, size: int, kind: int) -> np.ndarray | None:
        return cv2.imdecode(np.frombuffer(self._file.read(size), np.uint8), kind) if size else None
