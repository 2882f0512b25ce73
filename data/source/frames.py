"""Frames with time stamps from a video file, a folder of images or a bag.

No frame is lost silently: one that can't be read comes as a `Frame` without an image and with the reason.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress, pairwise
from pathlib import Path

import av
import numpy as np

from palpate.common.doors import plain
from palpate.data.source.bags import is_bag, pictures, read_topic, time_stamps, topic_of
from palpate.data.source.decoding import LARGEST_FPS, VideoTrack
from palpate.data.source.images import picture_size, printable, read_image
from palpate.data.source.layout import ClipLayout, InputError, folders_beside, frame_files, read_clip_file, stereo_pair
from palpate.data.source.lerobot import file_of, name_in_data_set, span_of


@dataclass(frozen=True)
class Frame:
    """One frame of a clip; `error` is non-empty exactly when `image` is None."""

    index: int
    """Position in the clip, from 0."""
    number: int
    """The frame's own number; a jump means missing frames."""
    time_s: float
    """Time since the clip's first frame [s]."""
    image: np.ndarray | None
    """RGB, uint8, shape [height, width, 3]."""
    path: Path | None = None
    """The image's file, None for a video."""
    error: str = ""
    """Reason for no image, a sentence."""
    right: np.ndarray | None = None
    """The right picture of a stereo pair that came as one with the image."""

    @property
    def picture(self) -> np.ndarray:
        """The image of a frame that has one; ValueError where it has none."""
        if self.image is None:
            raise ValueError(self.error)
        return self.image


class FrameSource(ABC):
    """A clip that can be iterated over more than once."""

    name: str
    """Name of the clip."""
    path: Path
    """The clip's folder or video file."""
    size: tuple[int, int]
    """(width, height) of the first readable frame [px]; frames of another size come as errors."""
    fps: float
    """Frame rate [1/s]."""
    length: int
    """Number of frames to expect; 0 where unknown."""
    warnings: list[str]
    """Problems of the clip as a whole, filled while iterating."""
    begin_ns: int = 0
    """Time stamp of the first frame on the recorder's clock [ns]; 0 if unknown."""
    frame_id: str = "camera_optical_frame"
    """Name of the camera's axes in ROS: x right, y down, z away from it."""

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """Frames in order, from the beginning."""

    def size_error(self, image: np.ndarray, named: str) -> str:
        """Complaint about an image, called `named`, whose size is not the clip's, else an empty string."""
        height, width = image.shape[:2]
        if (width, height) == self.size:
            return ""
        return f"{named} is {width}x{height} while the clip is {self.size[0]}x{self.size[1]}; export all at one size."


class Pictures(FrameSource):
    """A clip of single pictures whose numbers and time stamps are known before they are read."""

    _notes: Sequence[str] = ()
    _numbers: Sequence[int]
    _times: Sequence[float]

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[Path | None, np.ndarray | InputError]]:
        """File, if it has its own, and pixels of every picture, or the reason for none."""

    def _first_size(self) -> tuple[int, int]:
        """(width, height) of the first picture that can be read."""
        problems = []
        for _, found in self._pictures():
            if not isinstance(found, InputError):
                return picture_size(self.path, *found.shape[1::-1])
            problems.append(found)
        raise InputError(f"{self.path} holds {self.length} images and none can be decoded; {problems[0]}")

    def __iter__(self) -> Iterator[Frame]:
        self.warnings, failed = [*self._notes], 0
        first, last = self._numbers[0], self._numbers[-1]
        known = zip(self._numbers, self._times, self._pictures(), strict=True)
        for index, (number, time_s, (file, found)) in enumerate(known):
            image = None if isinstance(found, InputError) else found
            named = f"Frame {number} of {printable(self.path)}" if file is None else printable(file)
            error = str(found) if image is None else self.size_error(image, named)
            failed += bool(error)
            yield Frame(index, number, time_s, None if error else image, file, error)
        missing = last - first + 1 - self.length
        if missing:
            self.warnings.append(f"{missing} frame numbers are missing between {first} and {last}")
        if failed:
            self.warnings.append(f"unreadable: {failed} of {self.length} frames")


class FrameFolder(Pictures):
    """Images of one folder: those that match the layout, else all images in natural order.

    Other folders may continue it; camera, frame rate and depth scale are those of the first one.
    """

    def __init__(self, path: Path, layout: ClipLayout, following: Sequence[Path] = ()) -> None:
        """
        Args:
            path: folder of the clip's images.
            layout: names of the files.
            following: folders that continue the clip, in order.

        Raises:
            InputError: a folder without images, images that can't be decoded, or frame numbers that repeat.
        """
        self.path, self.name = path, name_of(path)
        self.warnings = []
        self.fps = float(read_clip_file(path).get("fps", layout.fps))
        self.files: list[tuple[int, Path]] = []
        self._times = []
        for folder in (path, *following):
            files = frame_files(folder, layout)
            if not files:
                raise InputError(f"{printable(folder)} holds no frame images ({layout.image}); give one that does.")
            _refuse_pairs(folder, [file for _, file in files])
            begin = self._times[-1] + 1 / self.fps if self._times else None
            self._times += _folder_times(folder, files, self.fps, begin)
            self.files += files
        _check_numbers(self.files)
        patterns = " ".join(filter(None, (*layout.mask_patterns, layout.depth)))
        unread = " and ".join(plain(each.name) for each in folders_beside(path) if f"{each.name}/" not in patterns)
        if unread:
            self._notes = [f"files in {unread} are not read; name them in a layout (--layout)"]
        self.length, self._numbers = len(self.files), [number for number, _ in self.files]
        self.size = self._first_size()

    def _pictures(self) -> Iterator[tuple[Path, np.ndarray | InputError]]:
        for _, file in self.files:
            try:
                yield file, read_image(file)
            except InputError as problem:  # it is reported with its frame
                yield file, problem


class VideoFile(FrameSource):
    """A video file, or an episode in one, with its own time stamps, upright and progressive, with square pixels."""

    def __init__(self, path: Path, fallback_fps: float = 25.0) -> None:
        """
        Args:
            path: video file; of LeRobot data sets of version 3 an episode in it.
            fallback_fps: frame rate where the file states none that a camera could have [1/s].

        Raises:
            InputError: an empty file, not a video, no episode in one, or pictures of an unusable size.
        """
        self.path, self.name = path, name_of(path)
        span, path = span_of(path), file_of(path)
        if path.exists() and not path.is_file():
            raise InputError(f"{printable(path)} is no file; give the video itself.")
        if path.stat().st_size == 0:
            raise InputError(f"{path} is an empty file (0 bytes); copy it again.")
        try:
            str(path).encode("utf-8")
            self._track = VideoTrack(path, span or (-math.inf, math.inf), fallback_fps)
        except UnicodeEncodeError as error:
            raise InputError(f"{printable(path)} has a name that is not valid UTF-8; rename the file.") from error
        except av.FFmpegError as error:
            problem = "can't be opened as a video (truncated, or none); copy or convert it again"
            raise InputError(f"{printable(path)} {problem}.") from error
        if self._track.size is None:
            raise InputError(f"{path} holds no frame that can be decoded; copy it again or convert it to MP4.")
        self.size, self.fps = picture_size(path, *self._track.size), self._track.fps
        # A frame has 10 bytes at least, which bounds what a header can announce.
        self.length = min(self._track.length, path.stat().st_size // 10)
        self.warnings = [*self._track.notes]

    def __iter__(self) -> Iterator[Frame]:
        self.warnings = [*self._track.notes]
        for index, (number, time_s, image) in enumerate(self._track):
            named = f"Frame {number} of {self.path}"
            error = f"{named} is damaged; copy it again." if image is None else self.size_error(image, named)
            yield Frame(index, number, time_s, None if error else image, None, error)
        self.warnings += self._track.damage()


class RosBag(Pictures):
    """Pictures of one topic of a bag of ROS 1 or 2."""

    def __init__(self, path: Path, layout: ClipLayout) -> None:
        """
        Args:
            path: the bag.
            layout: names the topic, and the frame rate of a bag with one picture.

        Raises:
            InputError: the bag can't be read, its topic is not given, its time stamps don't rise, or none of its
                pictures can be decoded.
        """
        self.path, self.name, self.warnings = path, name_of(path), []
        self.topic = topic_of(path, layout.topic)
        stamps = time_stamps(read_topic(path, self.topic), f"{printable(path)} ({plain(self.topic)})")
        self._new = np.diff(stamps, prepend=stamps[:1] - 1) > 0
        """Mask of pictures whose time stamp is after that of the one before, shape [N]."""
        stamps = stamps[self._new]
        steps, self.length = np.diff(stamps) / 1e9, len(stamps)
        self.fps = min(1 / float(np.median(steps)), LARGEST_FPS) if self.length > 1 else layout.fps
        self._times, self.begin_ns = ((stamps - stamps[0]) / 1e9).tolist(), int(stamps[0])
        named = (message.header.frame_id for _, message in read_topic(path, self.topic) if message is not None)
        self.frame_id = next(named, "") or self.frame_id
        # A jump in the time stamps is a jump in the numbers, as in videos.
        self._numbers = [0, *np.cumsum(np.maximum(1, np.rint(steps * self.fps))).astype(int).tolist()]
        self.size = self._first_size()

    def _pictures(self) -> Iterator[tuple[None, np.ndarray | InputError]]:
        return ((None, found) for found in compress(pictures(self.path, self.topic), self._new))

    def __iter__(self) -> Iterator[Frame]:
        yield from super().__iter__()
        if lost := int((~self._new).sum()):
            self.warnings.append(f"left out, as their time stamps repeat: {lost} of {len(self._new)} pictures")


class Halves(FrameSource):
    """A clip whose pictures each hold both of a stereo pair: the left one is its image."""

    def __init__(self, whole: FrameSource, across: bool) -> None:
        """
        Args:
            whole: the clip of whole pictures.
            across: True = side by side; False = the left one is on top.
        """
        self.path, self.name, self.fps, self.length = whole.path, whole.name, whole.fps, whole.length
        self.begin_ns, self.frame_id = whole.begin_ns, whole.frame_id
        self.warnings, self._whole, self._across = [], whole, across
        self.size = (whole.size[0] // 2, whole.size[1]) if across else (whole.size[0], whole.size[1] // 2)

    def __iter__(self) -> Iterator[Frame]:
        width, height = self.size
        for frame in self._whole:
            self.warnings = self._whole.warnings
            if frame.image is not None:
                halves = np.array_split(frame.image, [width if self._across else height], axis=int(self._across))
                left, right = (np.ascontiguousarray(half[:height, :width]) for half in halves)
                frame = replace(frame, image=left, right=right)
            yield frame
        self.warnings = self._whole.warnings


def halves(source: FrameSource, layout: ClipLayout) -> FrameSource:
    """The clip of left pictures, where the layout says that pictures hold both of a pair; else the same."""
    return Halves(source, layout.right == "side-by-side") if layout.halved else source


def _folder_times(folder: Path, files: Sequence[tuple[int, Path]], fps: float, begin: float | None) -> Sequence[float]:
    """Time stamps of a folder's frames [s], starting at `begin` where other frames come before.

    Raises:
        InputError: its clip.json gives times of other frames.
    """
    times = read_clip_file(folder).get("times")
    if times is None:
        times = [(number - files[0][0]) / fps for number, _ in files]
    elif len(times) != len(files):
        raise InputError(f"{folder} has {len(files)} frames and its clip.json {len(times)} times; make them agree.")
    return times if begin is None else [begin + time_s - times[0] for time_s in times]


def _refuse_pairs(folder: Path, files: Sequence[Path]) -> None:
    """Raise an InputError where left and right pictures lie in one folder."""
    pair = stereo_pair(files)
    if pair is not None:
        left, right = (re.sub(r"\d+(?=\D*$)", "{number}", file.name) for file in pair)
        problem = f"holds left and right pictures ({pair[0].name}, {pair[1].name}); give a layout (--layout)"
        raise InputError(f"{printable(folder)} {problem} with image: '{left}' and right: '{right}'.")


def _check_numbers(files: Sequence[tuple[int, Path]]) -> None:
    """Raise an InputError where sorted frame numbers repeat or are too large to count with."""
    for (number, file), (following, other) in pairwise(files):
        if number == following:
            raise InputError(f"{printable(file)} and {printable(other)} are both frame {number}; remove one of them.")
    if files[-1][0] > 2**53:  # below that they are exact as floating-point numbers too
        raise InputError(f"{printable(files[-1][1])} has a frame number above {2**53}; rename the file.")


def open_source(path: Path | str, layout: ClipLayout, following: Sequence[Path] = ()) -> FrameSource:
    """Open a clip: a folder of frames with the folders that continue it, a bag, or a video file.

    Raises:
        InputError: the path does not exist or holds no frame.
    """
    path = Path(path)
    try:
        if is_bag(path):
            source = RosBag(path, layout)
        else:
            source = FrameFolder(path, layout, following) if path.is_dir() else VideoFile(path, layout.fps)
        return halves(source, layout)
    except OSError as error:
        raise InputError(f"{printable(path)} can't be opened ({error.strerror}); check the path.") from error


def name_of(clip: Path) -> str:
    """Name of a clip: its folder's, or its video file's without the ending, in LeRobot data sets with its camera's.

    That of a sequence.yaml is its folder's.
    """
    if clip.name in ("sequence.yaml", "sequence.yml"):
        return clip.resolve().parent.name
    return clip.resolve().name if clip.is_dir() else name_in_data_set(clip) or clip.stem
