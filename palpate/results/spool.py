"""Frames that wait on disk until it is known what is to be shown of them; memory does not grow with their number."""

import pickle
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from palpate.estimators.online.particle_field import ParticleField


class Shown(NamedTuple):
    """Content of a frame."""

    image: np.ndarray | None
    """RGB, uint8 [H, W, 3]; None where it could not be read or isn't needed."""
    labels: np.ndarray | None
    """Label map, uint8 [h, w]; None where there is none."""
    field: ParticleField | None


class FrameSpool:
    """Frames in the order in which they came, in a file without a name that ends with the program.

    Args:
        folder: where the file is; its disk must hold the frames.

    Raises:
        OSError: the file can't be written (also from the methods).
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (closed by `close`)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, frame: Shown) -> None:
        """Append a frame."""
        bgr = None if frame.image is None else cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
        image = None if bgr is None else cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        pickle.dump((image, *frame[1:]), self._file)
        self._count += 1

    def drain(self) -> Iterator[Shown]:
        """Yield all frames, once; the spool is empty then."""
        count, self._count = self._count, 0
        self._file.seek(0)
        for _ in range(count):
            image, *others = pickle.load(self._file)
            yield Shown(None if image is None else cv2.imdecode(image, cv2.IMREAD_COLOR_RGB), *others)
        self._file.seek(0)
        self._file.truncate()

    def close(self) -> None:
        """Forget all."""
        self._file.close()
