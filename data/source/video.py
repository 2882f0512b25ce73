"""Video files written picture by picture, H.264, which every browser plays."""

import errno
from collections.abc import Generator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Final

import av
import numpy as np
from av.video.reformatter import VideoReformatter


@contextmanager
def _as_os_error() -> Generator[None]:
    """Turn the encoder's own errors into file-system errors, as most of them already are."""
    try:
        yield
    except av.FFmpegError as error:
        if isinstance(error, OSError):
            raise
        raise OSError(errno.EIO, f"the video encoder failed ({error.strerror})") from error


class Video:
    """A video file to write.

    Args:
        path: the file, in a folder that exists.
        size: width and height of the pictures, even [px].
        fps: frames a second.
        crf: constant rate factor of H.264; lower is better.
        fast: coded in a third of the time, twice as large.

    Raises:
        OSError: the file can't be written (also from the methods), or PyAV lacks the encoder, which its wheels have.
    """

    encoder: Final = "libx264"

    def __init__(self, path: Path, size: tuple[int, int], fps: float, crf: int = 21, fast: bool = False) -> None:
        if self.encoder not in av.codecs_available:
            raise OSError(errno.ENOSYS, f"PyAV lacks the encoder {self.encoder}; install its wheel", str(path))
        self._container = av.open(str(path), "w", options={"movflags": "+faststart"})
        # The version of x264 for the processor codes the same pictures differently from time to time: it reads memory
        # that it has not written.
        options = {"crf": str(crf), "preset": "ultrafast" if fast else "veryfast", "x264-params": "cpu-independent=1"}
        self._converter = VideoReformatter() if fast else None
        rate = Fraction(fps).limit_denominator(1001)
        self._stream = self._container.add_stream(self.encoder, rate=rate, options=options)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"

    def write(self, picture: np.ndarray) -> None:
        """Append a picture, RGB uint8 [H, W, 3]."""
        with _as_os_error():
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            if self._converter is not None:  # less exact than the encoder's own conversion, in half the time
                frame = self._converter.reformat(frame, format="yuv420p", interpolation="BILINEAR", threads=1)
            self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Finish the file."""
        with _as_os_error(), self._container:
            self._container.mux(self._stream.encode())
