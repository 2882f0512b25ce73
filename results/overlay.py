"""The clip with what was found drawn on it: outlines, contact point, force arrow, numbers; and the video file."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from data.labels import TISSUE, TOOL
from estimators.estimate import FrameEstimate
from results.drawing import WHITE, shade, text, wrap_text
from results.verdicts import COLORS, FAR, MEANINGS, Color, in_words, is_far, numbers, state

try:
    import av
except ImportError:  # the optional extra `video`; without it the overlay is MPEG-4 part 2
    av = None

_TISSUE_COLOR: Color = (74, 222, 128)
_TOOL_COLOR: Color = (56, 189, 248)
_FORCE_COLOR: Color = (251, 146, 60)
_SOFT: Color = (203, 213, 225)
_SMALLEST_WIDTH = 480
"""Narrower clips are enlarged, or the numbers would not fit [px]."""
_NOTICE = "Research software, not a medical device"


def canvas_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height of the overlay for source frames of `size`: even, as H.264 needs, and wide enough for text."""
    factor = max(1, -(-_SMALLEST_WIDTH // size[0]))
    return (size[0] * factor + 1) // 2 * 2, (size[1] * factor + 1) // 2 * 2


def draw_overlay(
    image: np.ndarray | None,
    size: tuple[int, int],
    labels: np.ndarray | None,
    estimate: FrameEstimate,
    *,
    unit: str = "",
) -> np.ndarray:
    """Draw one frame of the overlay.

    Args:
        image: source frame, RGB uint8 [H, W, 3]; None where it could not be read (the picture is black then).
        size: width and height of the source frames [px].
        labels: label map of any resolution with the frame's field of view; None where there is none.
        estimate: the frame's result.
        unit: unit of stiffness, damping and force.

    Returns:
        RGB uint8, of `canvas_size(size)`.
    """
    width, height = canvas_size(size)
    factor = max(1, -(-_SMALLEST_WIDTH // size[0]))
    canvas = np.zeros((height, width, 3), np.uint8)
    if image is not None and image.shape[:2] == (size[1], size[0]):
        enlarged = image if factor == 1 else cv2.resize(image, (size[0] * factor, size[1] * factor))
        canvas[: enlarged.shape[0], : enlarged.shape[1]] = enlarged
        if labels is not None:
            view = canvas[: enlarged.shape[0], : enlarged.shape[1]]
            _outline(view, labels == TISSUE, _TISSUE_COLOR)
            _outline(view, labels == TOOL, _TOOL_COLOR)
    _mark_contact(canvas, estimate, factor)
    _panel(canvas, estimate, unit)
    _footer(canvas, estimate)
    return canvas


def _outline(canvas: np.ndarray, mask: np.ndarray, color: Color) -> None:
    """Draw a mask's smoothed outline; the mask is enlarged to the canvas."""
    if not mask.any():
        return
    height, width = canvas.shape[:2]
    # Half the canvas is as smooth to the eye and a quarter of the work; shift=1 turns its pixels into the canvas's.
    half = cv2.resize(mask.astype(np.uint8) * 255, (-(-width // 2), -(-height // 2)), interpolation=cv2.INTER_LINEAR)
    reach = 2 * max(1, round(half.shape[1] / mask.shape[1])) + 1
    half = cv2.blur(half, (reach, reach))
    contours = cv2.findContours((half > 127).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    thickness = max(1, round(height / 320))
    cv2.polylines(canvas, [contour * 4 for contour in contours], True, color, thickness, cv2.LINE_AA, shift=1)


def _mark_contact(canvas: np.ndarray, estimate: FrameEstimate, factor: int) -> None:
    """Ring at the contact point, and the force arrow that ends there."""
    scale = canvas.shape[0] / 480
    if estimate.arrow is not None:
        tail, tip = (tuple(round((value + 0.5) * factor) for value in point) for point in estimate.arrow)
        cv2.arrowedLine(canvas, tail, tip, (20, 20, 20), max(4, round(6 * scale)), cv2.LINE_AA, tipLength=0.3)
        cv2.arrowedLine(canvas, tail, tip, _FORCE_COLOR, max(2, round(3 * scale)), cv2.LINE_AA, tipLength=0.3)
    if estimate.contact_u is not None and estimate.contact_v is not None:
        center = (round((estimate.contact_u + 0.5) * factor), round((estimate.contact_v + 0.5) * factor))
        cv2.circle(canvas, center, max(4, round(7 * scale)), (20, 20, 20), max(3, round(4 * scale)), cv2.LINE_AA)
        cv2.circle(canvas, center, max(4, round(7 * scale)), WHITE, max(1, round(2 * scale)), cv2.LINE_AA)


def _panel(canvas: np.ndarray, estimate: FrameEstimate, unit: str) -> None:
    """Verdict, numbers and remarks at the upper left."""
    scale = min(canvas.shape[0] / 480, canvas.shape[1] / 640)
    size, step, pad = max(11.0, 15 * scale), max(15.0, 21 * scale), max(6, round(10 * scale))
    small, width = size * 0.76, min(canvas.shape[1] - 2 * pad, round(max(262 * scale, 190)))
    lines = _number_lines(estimate)
    notes = [line for note in _notes(estimate, unit) for line in wrap_text(note, width - 2 * pad, small)]
    height = round(step * (1.2 + len(lines)) + step * 0.75 * len(notes) + 1.3 * pad)
    shade(canvas, (pad, pad), (width, height), 0.66)
    baseline, right = pad + step, width
    dot = (round(2 * pad + size * 0.3), round(baseline - size * 0.35))
    cv2.circle(canvas, dot, round(size * 0.36), COLORS[state(estimate)], -1, cv2.LINE_AA)
    text(canvas, in_words(state(estimate)), (2 * pad + size, baseline), size, WHITE, bold=True)
    for name, value in lines:
        baseline += step
        text(canvas, name, (2 * pad, baseline), size, _SOFT)
        text(canvas, value, (right, baseline), size, WHITE, align="right")
    baseline += step * 0.2
    for note in notes:
        baseline += step * 0.75
        text(canvas, note, (2 * pad, baseline), small, _SOFT)


def _number_lines(estimate: FrameEstimate) -> list[tuple[str, str]]:
    """Name and value of what the frame has."""
    names = {"k_s": "stiffness k_s", "k_d": "damping k_d", "|F|": "force |F|"}
    moved = (
        ("displacement, simulated", estimate.simulated_displacement),
        ("displacement, observed", estimate.observed_displacement),
    )
    found = [(names.get(symbol, symbol), told) for symbol, told in numbers(estimate.verdict, estimate.values)]
    return found + [(name, f"{value:.2g}") for name, value in moved if value is not None]


def _notes(estimate: FrameEstimate, unit: str) -> list[str]:
    """Small print under the numbers: what they can't say, why there are none, and their unit."""
    told = [MEANINGS[estimate.verdict]] if estimate.verdict else []
    told += [f"The simulated displacement is {FAR}."] if is_far(estimate) else []
    told += [estimate.detail] if estimate.detail else []
    if estimate.estimate is None:
        return told
    unsure = estimate.verdict != "determined" and "stiffness_low" in estimate.values
    ranges = "Ranges are 90 % intervals. " if unsure else ""
    return [*told, f"{ranges}Unit: {unit}." if unit else ranges]


def _footer(canvas: np.ndarray, estimate: FrameEstimate) -> None:
    """Frame and time at the lower left, the notice at the lower right."""
    height, width = canvas.shape[:2]
    size = max(10.0, 13 * min(height / 480, width / 640))
    bar = round(size * 1.9)
    shade(canvas, (0, height - bar), (width, bar), 0.55)
    baseline = height - bar * 0.32
    text(canvas, f"frame {estimate.frame}   {estimate.time_s:.2f} s", (size, baseline), size, WHITE)
    text(canvas, _NOTICE, (width - size, baseline), size, _SOFT, align="right")


class _Encoder(Protocol):
    """Takes RGB frames of one size and writes a video file."""

    def write(self, picture: np.ndarray) -> None: ...

    def close(self) -> None: ...


class OverlayVideo:
    """A video file written frame by frame: H.264 through PyAV where it is there (browsers play it), else MPEG-4.

    Args:
        path: the file, in a folder that exists.
        size: width and height of the *source* frames; pictures have `canvas_size(size)`.
        fps: frames a second.

    Raises:
        OSError: the file can't be written (also from the methods).
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self.encoder = "libx264" if _has_h264() else "mp4v"
        """Name of the encoder in use."""
        kind = _H264 if self.encoder == "libx264" else _Mpeg4
        self._encoder: _Encoder = kind(path, canvas_size(size), fps)

    def write(self, picture: np.ndarray) -> None:
        """Append a picture, RGB uint8 [H, W, 3]."""
        self._encoder.write(picture)

    def close(self) -> None:
        """Finish the file."""
        self._encoder.close()


def _has_h264() -> bool:
    return av is not None and "libx264" in av.codecs_available


class _H264:
    """PyAV with libx264."""

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path = path
        with self._told():
            self._container = av.open(str(path), "w", options={"movflags": "+faststart"})  # ty: ignore[missing-union-attribute]  it is there (_has_h264)
            rate = Fraction(fps).limit_denominator(1001)
            self._stream = self._container.add_stream("libx264", rate=rate, options={"preset": "veryfast", "crf": "21"})
            self._stream.width, self._stream.height = size
            self._stream.pix_fmt = "yuv420p"

    def write(self, picture: np.ndarray) -> None:
        with self._told():
            self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))  # ty: ignore[missing-union-attribute]  as above

    def close(self) -> None:
        with self._told():
            try:
                self._container.mux(self._stream.encode())
            finally:
                self._container.close()

    @contextmanager
    def _told(self) -> Generator[None]:
        """Turn the encoder's own errors into file-system errors, as most of them already are."""
        try:
            yield
        except av.FFmpegError as error:  # ty: ignore[missing-union-attribute]  as above
            if isinstance(error, OSError):
                raise
            raise OSError(errno.EIO, f"the video encoder failed ({error.strerror})", str(self._path)) from error


class _Mpeg4:
    """OpenCV's own writer, which tells of no failure: the finished file is counted."""

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path, self._count = path, 0
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, size)  # ty: ignore[missing-attribute]  stubs lack it
        if not self._writer.isOpened():
            raise self._failure("OpenCV can't write an MPEG-4 video there")

    def write(self, picture: np.ndarray) -> None:
        self._writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        self._count += 1

    def close(self) -> None:
        self._writer.release()
        reader = cv2.VideoCapture(str(self._path))
        written = round(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
        reader.release()
        if written < self._count:
            raise self._failure(f"only {written} of {self._count} overlay frames were stored")

    def _failure(self, reason: str) -> OSError:
        folder = self._path.parent
        full = folder.is_dir() and shutil.disk_usage(folder).free < 2**16
        return OSError(errno.ENOSPC if full else errno.EIO, reason, str(self._path))
