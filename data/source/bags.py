"""Pictures, their camera and forces by topic in bags of ROS 1 and ROS 2, which the library `rosbags` reads."""

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from os.path import isfile
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np

from palpate.common.doors import plain
from palpate.data.source.images import decode_image, printable, require_pixels
from palpate.data.source.layout import InputError
from palpate.data.source.table import reason

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""Types of messages that hold a picture."""
WRENCHES = ("geometry_msgs/msg/WrenchStamped",)
"""Types of messages that hold a force."""


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: a file by its ending, or a folder that ROS 2 has recorded."""
    endings = {".bag", ".mcap", ".db3"}
    if isfile(path):
        return path.suffix in endings
    return isfile(path / "metadata.yaml") and any(endings & set(file.suffixes) for file in path.glob("*.*"))


@contextmanager
def _opened(path: Path) -> Generator[Any]:
    """A bag, open as `rosbags.highlevel.AnyReader`; errors of the library become one sentence."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except ImportError as error:
        raise InputError(f"{printable(path)} is a bag, which needs rosbags; install 'palpate[robot]'.") from error
    except Exception as error:  # those of the library, of SQLite and of decompression have nothing in common
        problem = f"can't be read as a bag ({reason(error).rstrip('.')}); copy it again or mend it by `rosbag reindex`"
        raise InputError(f"{printable(path)} {problem}, `ros2 bag reindex` or `mcap recover`.") from error


def topic_of(path: Path, topic: str | None, kinds: Sequence[str] = IMAGES, setting: str = "layout.topic") -> str:
    """A topic of a bag that holds messages of some types: the one that is named, else the only one.

    Args:
        setting: name of the layout's setting, for the error message.

    Raises:
        InputError: the bag can't be read, or holds no such topic, or several and none is named.
    """
    with _opened(path) as reader:
        topics = [name for name, found in sorted(reader.topics.items()) if found.msgtype in kinds and found.msgcount]
    if topic in topics or (topic is None and len(topics) == 1):
        return topic or topics[0]
    remedy = f"name one of these as {setting}" if topics else "record one"
    problem = f"holds {' or '.join(kinds)} on {plain(', '.join(topics)) or 'no topic'}"
    raise InputError(f"{printable(path)} {problem}; {remedy}.")


def read_topic(path: Path, topic: str, kinds: Sequence[str] = IMAGES) -> Iterator[tuple[int, Any]]:
    """Yield the recording time [ns] and content of a topic's messages, in order; None in place of a damaged one.

    Raises:
        InputError: the bag can't be read.
    """
    with _opened(path) as reader:
        chosen = [each for each in reader.connections if each.topic == topic and each.msgtype in kinds]
        for connection, recorded, content in reader.messages(chosen) if chosen else ():
            try:
                message = reader.deserialize(content, connection.msgtype)
            except Exception:  # parsing of damaged bytes may raise anything
                message = None
            yield recorded, message


def time_stamps(messages: Iterable[tuple[int, Any]], named: str) -> np.ndarray:
    """Time stamps of messages, int64, shape [N] [ns]: their headers', on whose clock are those without one.

    Args:
        messages: messages of a topic, as `read_topic` yields them.
        named: begins the error message.

    Raises:
        InputError: they fall somewhere, or most are repeated.
    """
    headers = ((recorded, None if message is None else message.header.stamp) for recorded, message in messages)
    pairs = [(recorded, 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec) for recorded, stamp in headers]
    recorded, stamps = np.array(pairs, np.int64).reshape(-1, 2).T
    known = stamps > 0
    shift = int(np.median((stamps - recorded)[known])) if known.any() else 0
    times = np.where(known, stamps, recorded + shift)
    steps = np.diff(times)
    if (steps < 0).any() or 2 * (steps == 0).sum() > len(steps):
        raise InputError(f"{named} has time stamps that don't rise; correct them.")
    return times


def pictures(path: Path, topic: str) -> Iterator[np.ndarray | InputError]:
    """Pictures of a topic, RGB uint8 [H, W, 3], or why there is none.

    Raises:
        InputError: the bag can't be read.
    """
    for index, (_, message) in enumerate(read_topic(path, topic)):
        try:
            yield _picture(message, f"Picture {index} on {plain(topic)} of {printable(path)}")
        except InputError as problem:
            yield problem


def _picture(message: Any, named: str) -> np.ndarray:
    if message is None:
        raise InputError(f"{named} is damaged; record it again.")
    if hasattr(message, "format"):
        return _decompressed(message.data.tobytes(), message.format, named)
    height, width, step = message.height, message.width, message.step
    require_pixels(named, width, height)
    # Channels of pictures that are stored as they are, and what makes RGB of them.
    known = {"rgb8": (3, None), "bgr8": (3, cv2.COLOR_BGR2RGB), "mono8": (1, cv2.COLOR_GRAY2RGB)}
    known |= {"rgba8": (4, cv2.COLOR_RGBA2RGB), "bgra8": (4, cv2.COLOR_BGRA2RGB)}
    try:
        channels, code = known[message.encoding]
        pixels = message.data.reshape(height, step)[:, : width * channels].reshape(height, width, channels)
        return pixels if code is None else cv2.cvtColor(pixels, code)
    except (KeyError, ValueError, cv2.error) as error:
        problem = f"is no {width}x{height} of {plain(message.encoding)} in rows of {step} bytes that can be read"
        raise InputError(f"{named} {problem}; record {', '.join(known)}, or compressed pictures.") from error


def _decompressed(content: bytes, label: str, named: str) -> np.ndarray:
    """Picture of a CompressedImage of any format name."""
    try:
        return decode_image(content, named)
    except InputError as error:
        video = content.startswith((b"\0\0\1", b"\0\0\0\1"))
        kind = "holds H.264 or H.265 video" if video else "can't be decoded as JPEG or PNG"
        remedy = "record JPEG or PNG, or convert the topic by `image_transport republish`"
        raise InputError(f"{named} (format '{plain(label)[:60]}') {kind}; {remedy}.") from error


def camera_entries(path: Path, topic: str | None) -> dict[str, Any] | None:
    """Fields of the camera whose pictures a topic holds, None where the bag has none that was calibrated.

    Raises:
        InputError: as in `topic_of`, or the lens has another model than those of OpenCV.
    """
    home = PurePosixPath(topic_of(path, topic).removesuffix("/compressed"))
    info = read_topic(path, str(home.parent / "camera_info"), ("sensor_msgs/msg/CameraInfo",))
    message = next((message for _, message in info if message is not None), None)
    entries = {} if message is None else {name.lower(): value for name, value in vars(message).items()}
    if not entries or entries["k"][0] == 0:  # drivers that know no calibration write zeros; ROS 1 writes K, D and P
        return None
    matrix, bent = entries["k"].reshape(3, 3), entries["d"].tolist()
    if "rect" in home.name:  # pictures from which the distortion has been removed
        matrix, bent = entries["p"].reshape(3, 4), []
    if any(bent) and entries["distortion_model"] not in ("", "plumb_bob", "rational_polynomial"):
        problem = f"has the lens model {plain(entries['distortion_model'])}; record pictures without distortion"
        raise InputError(f"{printable(path)} {problem}.")
    fields = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2], "distortion": bent}
    return fields | {"width": entries["width"], "height": entries["height"]}


def read_wrenches(path: Path, topic: str, shown: str | None) -> np.ndarray:
    """Norms of the forces that a topic of WrenchStamped holds, shape [2, K]: times after the first picture [s], [N].

    Args:
        shown: topic of the pictures; None = the only one.

    Raises:
        InputError: it is no bag; else as in `topic_of` and `time_stamps`.
    """
    if not is_bag(path):
        raise InputError(f"{printable(path)} is no bag and has no topic {plain(topic)}; give --force-scale a table.")
    begun = time_stamps(read_topic(path, topic_of(path, shown)), printable(path))[0]
    messages = list(read_topic(path, topic_of(path, topic, WRENCHES, "--force-scale"), WRENCHES))
    vectors = (None if message is None else message.wrench.force for _, message in messages)
    forces = [np.nan if each is None else float(np.linalg.norm((each.x, each.y, each.z))) for each in vectors]
    times = time_stamps(messages, f"{printable(path)} ({plain(topic)})") - begun
    return np.stack((times / 1e9, np.array(forces)))[:, np.diff(times, prepend=times[:1] - 1) > 0]
