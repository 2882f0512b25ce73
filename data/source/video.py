"""Video files written picture by picture: H.264 where PyAV was built with it (browsers play it), else MPEG-4."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Final

import av
import cv2
import numpy as np

X264 = {"preset": "veryfast", "x264-params": "cpu-independent=1"}
"""Options of x264, whose version for the processor codes the same pictures differently from time to time: it reads
memory that it has not written."""


def open_video(path: Path, size: tuple[int, int], fps: float, crf: int = 21) -> H264 | Mpeg4:
    """A video file to write.

    Args:
        path: the file, in a folder that exists.
        size: width and height of the pictures, even [px].
        fps: frames a second.
        crf: constant rate factor of H.264; lower is better.

    Raises:
        OSError: the file can't be written (also from the methods).
    """
    if H264.encoder in av.codecs_available:
        return H264(path, size, fps, crf)
    return Mpeg4(path, size, fps)


@contextmanager
def _as_os_error() -> Generator[None]:
    """Turn the encoder's own errors into file-system errors, as most of them already are."""
    try:
        yield
    except av.FFmpegError as error:
        if isinstance(error, OSError):
            raise
        raise OSError(errno.EIO, f"the video encoder failed ({error.strerror})") from error


class H264:
    """A video written by PyAV."""

    encoder: Final = "libx264"

    def __init__(self, path: Path, size: tuple[int, int], fps: float, crf: int) -> None:
        self._container = av.open(str(path), "w", options={"movflags": "+faststart"})
        rate = Fraction(fps).limit_denominator(1001)
        self._stream = self._container.add_stream(self.encoder, rate=rate, options={"crf": str(crf)} | X264)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"

    def write(self, picture: np.ndarray) -> None:
        """Append a picture, RGB uint8 [H, W, 3]."""
        with _as_os_error():
            self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))

    def close(self) -> None:
        """Finish the file."""
        with _as_os_error(), self._container:
            self._container.mux(self._stream.encode())


class Mpeg4:
    """A video written by OpenCV, which reports no failure: the finished file's frames are counted."""

    encoder = "mp4v"

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path, self._count = path, 0
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*self.encoder), fps, size)
        if not self._writer.isOpened():
            raise OSError(errno.EIO, "OpenCV can't write an MPEG-4 video there", str(path))

    def write(self, picture: np.ndarray) -> None:
        """Append a picture, RGB uint8 [H, W, 3]."""
        self._writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        self._count += 1

    def close(self) -> None:
        """Finish the file."""
        self._writer.release()
        reader = cv2.VideoCapture(str(self._path))
        written = round(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
        reader.release()
        if written < self._count:
            full = shutil.disk_usage(self._path.parent).free < 2**16
            reason = f"only {written} of {self._count} frames were stored"
            raise OSError(errno.ENOSPC if full else errno.EIO, reason, str(self._path))
