"""Frames that wait on disk until it is known what is to be drawn on them; memory does not grow with their number."""

import pickle
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
        self._estimates: list[FrameEstimate] = []

    def __len__(self) -> int:
        return len(self._estimates)

    def add(self, frame: Waiting) -> None:
        """Append a frame."""
        bgr = None if frame.image is None else cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
        image = None if bgr is None else cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        pickle.dump((image, frame.labels), self._file)
        self._estimates.append(frame.estimate)

    def drain(self) -> Iterator[Waiting]:
        """All frames, once; the spool is empty then."""
        estimates, self._estimates = self._estimates, []
        self._file.seek(0)
        for estimate in estimates:
            image, labels = pickle.load(self._file)
            yield Waiting(None if image is None else cv2.imdecode(image, cv2.IMREAD_COLOR_RGB), labels, estimate)
        self._file.seek(0)
        self._file.truncate()

    def close(self) -> None:
        """Forget all."""
        self._file.close()
