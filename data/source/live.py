"""Frames as they come from a camera, a stream or a pipe; those that have waited too long are dropped and counted."""

import threading
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np

from palpate.data.source.decoding import LARGEST_FPS
from palpate.data.source.frames import Frame, FrameSource, VideoFile
from palpate.data.source.images import picture_size
from palpate.data.source.layout import InputError


class LiveSource(FrameSource):
    """Pictures as they come; another iteration goes on with the pictures of then.

    Args:
        name: name of the source, for messages.
        pictures: RGB uint8 [H, W, 3], taken in a thread of their own.
        fps: frames a second.
        max_latency: largest age of a picture when it is taken; older ones are dropped [s].
        clocked: True = times are those of arrival; False = pictures are one frame apart.

    Raises:
        InputError: no picture comes at all, or one of an unusable size.
    """

    def __init__(
        self, name: str, pictures: Iterable[np.ndarray], fps: float, max_latency: float, *, clocked: bool = False
    ) -> None:
        self.name, self.path, self.fps, self.max_latency = name, Path(name), fps, max_latency
        self.length, self.warnings = 0, []
        self.dropped = 0
        """Pictures that were dropped."""
        self.came: dict[int, float] = {}
        """Arrival time of each frame by its number, removed by the consumer [s of `time.monotonic`]."""
        self._pictures, self._clocked = pictures, clocked
        self._waiting: deque[tuple[int, float, np.ndarray]] = deque()
        self._ended = self.stopped = False
        self._error: Exception | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._take, daemon=True).start()
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ended)
            if not self._waiting:
                raise self._error or InputError(f"{name} gives no picture; check that it is there and not in use.")
            self.size = picture_size(self.path, *self._waiting[0][2].shape[1::-1])

    def _take(self) -> None:
        begun, number = np.nan, -1
        try:
            for picture in self._pictures:
                came = time.monotonic()
                begun = came if number < 0 else begun
                number = max(number + 1, round((came - begun) * self.fps)) if self._clocked else number + 1
                with self._changed:
                    if self.stopped:
                        return
                    self._waiting.append((number, came, picture))
                    self._drop(came)
                    self._changed.notify()
        except Exception as error:  # of any kind, so that the reader doesn't wait for ever
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify()

    def _drop(self, now: float) -> None:
        """Drop pictures that have waited too long, but for the last one."""
        while len(self._waiting) > 1 and now - self._waiting[0][1] > self.max_latency:
            self._waiting.popleft()
            self.dropped += 1

    def stop(self) -> None:
        """Let the source end now, even where it stalls."""
        with self._changed:
            self._ended = self.stopped = True
            self._waiting.clear()
            self._changed.notify_all()

    def __iter__(self) -> Iterator[Frame]:
        """Frames until the source ends or is stopped.

        Raises:
            InputError: the source can't be read any more.
        """
        index, first, begun = 0, 0, 0.0
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._ended)
                if not self._waiting:
                    if self._error is not None:
                        raise self._error
                    return
                self._drop(time.monotonic())
                number, came, picture = self._waiting.popleft()
            if index == 0:
                first, begun = number, came
            number -= first
            self.came[number] = came
            error = self.size_error(picture, f"Frame {number} of {self.name}")
            time_s = came - begun if self._clocked else number / self.fps
            yield Frame(index, number, time_s, None if error else picture, None, error)
            index += 1


def open_live(
    where: str, max_latency: float, size: tuple[int, int] | None, fps: float | None, pipe: BinaryIO, every: int = 1
) -> LiveSource:
    """Open a source.

    Args:
        where: a camera's number, the address of a stream, a video file (played at its own rate), or `-` for the pipe.
        max_latency: largest age of a picture [s], as in `LiveSource`.
        size: width and height of the pipe's pictures [px].
        fps: frames a second; None = the source's own, of a pipe 25.
        pipe: RGB pictures, 3 bytes a pixel, one after the other.
        every: number of pictures of which the first one is taken.

    Raises:
        InputError: it can't be opened, or a size or rate is given that it has of its own.
    """
    if size is not None and where != "-":
        raise InputError(f"{where} has pictures of a size of its own; leave --size out.")
    clocked = where.isdecimal() or "://" in where
    if where == "-":
        if size is None:
            raise InputError("pictures from a pipe have no size of their own; give --size, such as --size 854x480.")
        name, pictures, rate = "pipe", _piped(pipe, size), fps or 25.0
    elif clocked:
        if where.isdecimal() and len(where) > 4:
            raise InputError(f"{where[:20]} is no camera's number; give one such as 0.")
        name = f"camera {where}" if where.isdecimal() else where
        capture = cv2.VideoCapture(int(where) if where.isdecimal() else where)
        if not capture.isOpened():
            raise InputError(f"{name} can't be opened; check that it is there and not in use.")
        stated = capture.get(cv2.CAP_PROP_FPS)
        pictures, rate = _captured(capture), fps or (stated if 0 < stated <= LARGEST_FPS else 25.0)
    else:
        if not Path(where).is_file():
            raise InputError(f"{where} is no file, stream or camera; give a path, an address, a camera's number, or -.")
        if fps is not None:
            raise InputError(f"{where} is played at its own rate; leave --fps out.")
        video = VideoFile(Path(where))
        name, pictures, rate = video.name, _played(video), video.fps
    return LiveSource(name, islice(pictures, 0, None, every), rate / every, max_latency, clocked=clocked)


def _captured(capture: cv2.VideoCapture) -> Generator[np.ndarray]:
    """Pictures of a camera or stream until it has gone."""
    try:
        while (picture := capture.read()[1]) is not None:
            yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    finally:
        capture.release()


def _piped(pipe: BinaryIO, size: tuple[int, int]) -> Iterator[np.ndarray]:
    width, height = size
    while len(data := pipe.read(3 * width * height)) == 3 * width * height:
        yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


def _played(video: VideoFile) -> Iterator[np.ndarray]:
    """Pictures of a file when their time has come; frames that can't be decoded are left out."""
    begun = time.monotonic()
    for frame in video:
        time.sleep(max(begun + frame.time_s - time.monotonic(), 0.0))
        if frame.image is not None:
            yield frame.image
