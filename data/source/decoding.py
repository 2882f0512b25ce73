"""Decoding of video files by FFmpeg's libraries (PyAV): one track, its time stamps, upright progressive RGB pictures.

Headers are not believed where the frames themselves tell: rate, number of frames, interlacing.
"""

import math
import re
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise
from pathlib import Path
from statistics import median
from typing import Generic, NamedTuple, TypeVar

import av
import numpy as np
from av.container import InputContainer
from av.sidedata.sidedata import Type
from av.stream import Disposition
from av.video.reformatter import ColorTrc, Interpolation, VideoReformatter
from av.video.stream import VideoStream

from palpate.data.source.images import printable, require_pixels
from palpate.data.source.interlace import LARGEST_OFFSET, FieldOffset, filtered
from palpate.data.source.layout import InputError

Kind = TypeVar("Kind")

LARGEST_FPS = 1000.0
"""Largest frame rate of a camera [1/s]; a stored one above this is a container's default."""
NEIGHBOURS = 7
"""Number of gaps before and after one whose median is the local step."""


class Timed(NamedTuple, Generic[Kind]):
    """Something at its place in a video."""

    number: int
    """Number of the frame; a jump means missing frames."""
    time_s: float
    """Time since the first frame [s]."""
    frame: Kind


@contextmanager
def opened(file: Path) -> Generator[tuple[InputContainer, VideoStream]]:
    """A video file and its track: the default one, else what FFmpeg takes for the best, never a cover picture.

    Raises:
        av.FFmpegError: it is no video, or can't be read.
        InputError: it has no track of pictures.
    """
    options = {"protocol_whitelist": "file"}
    no_pictures = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
    with av.open(f"file:{file}", options=options, metadata_errors="replace") as container:
        videos = [track for track in container.streams.video if track.codec_context is not None]
        tracks = [track for track in videos if not track.disposition & no_pictures]
        default = [track for track in tracks if track.disposition & Disposition.default]
        best = container.streams.best("video")
        track = next((each for each in tracks if best is not None and each.index == best.index), None)
        track = default[0] if len(default) == 1 else track or next(iter(tracks), None)
        if track is None:
            raise InputError(f"{printable(file)} holds no video track that can be decoded; give the video itself.")
        track.thread_type = "AUTO"
        yield container, track


@dataclass
class _Damage:
    """Progress of a pass through a track, and the parts that it could not decode."""

    errors: int = 0
    """Packets that the decoder refused once it had begun."""
    pictures: int = 0
    """Frames that are flagged as damaged."""
    read_until: float = -math.inf
    """End of the last packet [s]."""
    filled_until: float = -math.inf
    """Time stamp of the last packet that holds a picture [s]."""
    decoded_until: float = -math.inf
    """Time stamp of the last frame [s]."""


def _decoded(container: InputContainer, track: VideoStream, damage: _Damage) -> Iterator[av.VideoFrame]:
    """Frames of a track in the order of their time stamps, without those that an edit list hides."""
    packets, unit, packet = container.demux(track), float(track.time_base or 1), None
    while True:
        try:
            packet = next(packets, None)
        except av.FFmpegError:
            packet, damage.errors = None, damage.errors + 1
        stamp = None if packet is None or packet.is_discard else packet.dts if packet.pts is None else packet.pts
        if packet is not None and stamp is not None:
            damage.read_until = max(damage.read_until, (stamp + (packet.duration or 0)) * unit)
        if packet is not None and not packet.size:  # a frame that the recorder left out, or the end
            continue
        if stamp is not None:
            damage.filled_until = max(damage.filled_until, stamp * unit)
        try:
            frames = track.decode(packet)
        except av.FFmpegError:
            frames, damage.errors = [], damage.errors + math.isfinite(damage.decoded_until)
        for frame in frames:
            frame.time_base = frame.time_base or track.time_base
            damage.decoded_until = max(damage.decoded_until, _time(frame) or 0.0)
            yield frame
        if packet is None:
            return


def _time(frame: av.VideoFrame) -> float | None:
    stamp = frame.dts if frame.pts is None else frame.pts
    unit = frame.time_base or Fraction(1)
    return None if stamp is None else stamp * unit.numerator / unit.denominator


def numbered(frames: Iterable[tuple[float | None, Kind]], step: float) -> Iterator[Timed[Kind]]:
    """Number frames, and count their time from the first one.

    A missing time stamp, or one that doesn't rise, is a step after the one before. Numbers rise by gaps over the local
    median of gaps. A lost frame is a jump; a late time stamp that the following ones make up for is none.

    Args:
        frames: time stamp [s] and frame, in order.
        step: time between frames where none is known yet [s].
    """
    times: list[float] = []
    waiting: deque[Kind] = deque()
    number = 0

    def earliest() -> Timed[Kind]:
        nonlocal number, step
        index = len(times) - len(waiting)
        if index:
            jump, step = _jump(times, index)
            number += jump
        return Timed(number, times[index] - times[0], waiting.popleft())

    for stamp, frame in frames:
        rises = stamp is not None and (not times or stamp > times[-1])
        times.append(stamp if rises else times[-1] + step if times else 0.0)
        waiting.append(frame)
        if len(waiting) > NEIGHBOURS:
            yield earliest()
    while waiting:
        yield earliest()


def _jump(times: list[float], index: int) -> tuple[int, float]:
    """Rise of the numbers at a frame other than the first, and the local step [s]."""
    near = times[max(index - 1 - NEIGHBOURS, 0) : index + 1 + NEIGHBOURS]
    step = median(after - before for before, after in pairwise(near))
    # Two gaps on either side make up for one late time stamp.
    first, last = max(index - 3, 0), min(index + 2, len(times) - 1)
    without_others = times[last] - times[first] - (last - first - 1) * step
    gap = min(times[index] - times[index - 1], without_others)
    # Share of a step by which a time stamp may be late without a frame missing before it.
    return max(1, math.floor(gap / step + 1 - 0.6)), step


class VideoTrack:
    """The track of a video file that is read: its properties, as the first frames show them, and its pictures.

    Attributes:
        size: width and height of the first picture; None where none can be decoded [px].
        fps: frame rate [1/s].
        length: expected number of frames; 0 = unknown.
        fields: name and options of FFmpeg's filter that deinterlaces, or removes a wrong flag.
        notes: conversions of the pictures, and doubts about them.
    """

    def __init__(self, file: Path, span: tuple[float, float], fallback_fps: float) -> None:
        """Decode the first frames.

        Args:
            file: the video file.
            span: begin and end of the part to read [s].
            fallback_fps: frame rate where neither time stamps nor the header tell one [1/s].

        Raises:
            av.FFmpegError: the file is no video, or can't be read.
            InputError: it has no track of pictures, or these are too large.
        """
        self.file, self.span, self.fps = file, span, fallback_fps
        self.size: tuple[int, int] | None = None
        self.length, self.notes = 0, []
        self.fields: tuple[str, str] | None = None
        self._damage = _Damage()
        with opened(file) as (container, track):
            self._aspect = float(track.sample_aspect_ratio or 1)
            require_pixels(printable(file), *self._square(track.width, track.height))
            self._start = float((track.start_time or 0) * (track.time_base or 1))
            self._end = min(_stated_end(container, track, self._start), span[1])
            if track.average_rate and track.average_rate <= LARGEST_FPS:
                self.fps = float(track.average_rate)
            self._look(container, track)

    def _look(self, container: InputContainer, track: VideoStream) -> None:
        """Find out frame rate, length, size and conversions of the pictures."""
        offset, stamps, flagged, hdr, picture, stored = FieldOffset(), set(), False, "", None, (0, 0)
        transfers = {ColorTrc.SMPTE2084: "PQ", ColorTrc.ARIB_STD_B67: "HLG"}  # of high dynamic range
        # First frames that are decoded for the frame rate, and for interlacing.
        for frame in islice(self._stored(container, track), 32):
            offset.push(frame)
            stamps.add(_time(frame))
            flagged, hdr = flagged or frame.interlaced_frame, transfers.get(frame.color_trc, hdr)
            if picture is None:
                picture, stored = self._picture(frame, VideoReformatter()), (frame.width, frame.height)
        if picture is None:
            return
        self.size = picture.shape[1], picture.shape[0]
        if offset.value is None:
            self._look_elsewhere(container, track, offset)
        if len(rising := sorted(stamps - {None})) > 1:
            *_, last = numbered(((stamp, None) for stamp in rising), 1 / self.fps)
            measured = min(last.number / last.time_s, LARGEST_FPS)
            # Relative difference from the measured frame rate up to which a stated one counts.
            self.fps = self.fps if abs(self.fps / measured - 1) < 0.02 else measured
        begin = max(self.span[0], self._start)
        self.length = round((self._end - begin) * self.fps) if math.isfinite(self._end) else 0
        self.fields = ("setfield", "prog") if flagged else None  # flagged frames are converted field by field
        if offset.value is None:
            if flagged or stored[1] in (480, 486, 576, 1080):  # heights of interlaced television [px]
                self.notes.append("too little moves in the frames examined to tell whether the video is interlaced")
        elif abs(offset.value) > LARGEST_OFFSET:
            self.fields = "bwdif", f"send_frame:{'tff' if offset.value > 0 else 'bff'}:all"
            self.notes.append("interlaced: odd and even rows show different instants; the video is deinterlaced")
        if hdr:
            self.notes.append(f"colours are coded for high dynamic range ({hdr}) and read as standard ones")
        if (square := self._square(*stored)) != stored:
            read = "{}x{} are read as {}x{}".format(*stored, *square)
            self.notes.append(f"pixels are not square: pictures of {read}")

    def _look_elsewhere(self, container: InputContainer, track: VideoStream, offset: FieldOffset) -> None:
        """Search seven places later on, twelve frames of each, for motion that shows whether they are interlaced."""
        begin = max(self._start, self.span[0])
        for share in np.arange(1, 8) / 8 if math.isfinite(self._end) else ():
            offset.skip()
            with suppress(av.FFmpegError):
                container.seek(round((begin + (self._end - begin) * share) * av.time_base))
                for frame in islice(_decoded(container, track, _Damage()), 12):
                    offset.push(frame)
            if offset.value is not None:
                return

    def _stored(self, container: InputContainer, track: VideoStream) -> Iterator[av.VideoFrame]:
        """Frames of the span as they are stored; fills `_damage`."""
        self._damage = _Damage()
        begin, end = (instant - 0.5 / self.fps for instant in self.span)
        if begin > 0:
            container.seek(round(begin * av.time_base))  # to a frame before that can be decoded alone
        for frame in _decoded(container, track, self._damage):
            time_s = _time(frame)
            if time_s is not None and time_s >= end:  # what the decoder has been given beyond is not missing
                self._damage.decoded_until = math.inf
                return
            if time_s is None or time_s >= begin:
                yield frame

    def _square(self, width: int, height: int) -> tuple[int, int]:
        """Size of a picture with square pixels, enlarged on one side [px]."""
        # Relative difference of a pixel's sides that is left as it is.
        if abs(self._aspect - 1) <= 0.005:
            return width, height
        return round(width * max(self._aspect, 1)), round(height / min(self._aspect, 1))

    def _picture(self, frame: av.VideoFrame, reformatter: VideoReformatter) -> np.ndarray | None:
        size = self._square(frame.width, frame.height)
        how = Interpolation.BILINEAR if size == (frame.width, frame.height) else Interpolation.BICUBIC
        with suppress(av.FFmpegError):
            if not frame.is_corrupt:
                # Its threads cost more than they save.
                shown = reformatter.reformat(frame, *size, "rgb24", interpolation=how, threads=1)
                return _upright(shown.to_ndarray(), frame)
        self._damage.pictures += 1
        return None

    def __iter__(self) -> Iterator[Timed[np.ndarray | None]]:
        """RGB pictures, uint8 [H, W, 3], in order; None in place of a damaged one."""
        with opened(self.file) as (container, track):
            frames, reformatter = self._stored(container, track), VideoReformatter()
            if self.fields:
                frames = filtered(frames, *self.fields)
            # Converted at once, while the decoder's picture is in the processor's cache.
            pictures = ((_time(frame), self._picture(frame, reformatter)) for frame in frames)
            yield from numbered(pictures, 1 / self.fps)

    def damage(self) -> list[str]:
        """Complaints about what the last pass, once complete, has not decoded."""
        damage, step = self._damage, 1 / self.fps
        until = max(damage.read_until, damage.decoded_until + step)
        lost = 2.5 * step  # by which a video may end early without a word
        if math.isfinite(self._end) and self._end - until > lost:
            whole, until = self._end - self._start, max(until - self._start, 0.0)
            return [f"truncated: the file ends after {until:.2f} s of {whole:.2f} s; copy it again"]
        if damage.errors or damage.pictures or damage.filled_until - damage.decoded_until > lost:
            return ["damaged: some of its frames can't be decoded; copy it again"]
        return []


def _upright(picture: np.ndarray, frame: av.VideoFrame) -> np.ndarray:
    """The picture as the frame's display matrix turns and mirrors it, by multiples of 90°."""
    data = frame.side_data.get(Type.DISPLAYMATRIX)  # ty: ignore[no-matching-overload]  a mapping by type
    if data is None:
        return picture
    across, across_down, _, down_across, down = np.frombuffer(bytes(data), "i4")[:5]
    if abs(across) < abs(across_down):
        picture, across, down = picture.transpose(1, 0, 2), down_across, across_down
    return np.ascontiguousarray(picture[:: -1 if down < 0 else 1, :: -1 if across < 0 else 1])


def _stated_end(container: InputContainer, track: VideoStream, start: float) -> float:
    """End of a track that begins at `start`, by its header [s]; infinite where that isn't stated for it alone."""
    if track.duration:
        return start + float(track.duration * (track.time_base or 1))
    stated = re.fullmatch(r"(\d+):(\d+):(\d+\.?\d*)", track.metadata.get("DURATION", ""))
    if stated:
        seconds = sum(float(part) * unit for part, unit in zip(stated.groups(), (3600, 60, 1), strict=True))
    elif container.duration and len(container.streams) == 1:
        seconds = container.duration / av.time_base
    else:
        return math.inf
    return seconds if seconds > start else start + seconds  # both are written
