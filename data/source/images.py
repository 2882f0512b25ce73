"""Image files by their bytes, and paths as text."""

import os
from pathlib import Path

# Messages of the decoder about broken files would hide the error message of this project.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
import cv2
import numpy as np

from palpate.common.doors import plain
from palpate.common.files import read_file
from palpate.data.source.layout import InputError

# OpenCV reads the environment when it is first imported, which may have been before this module.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

MOST_PIXELS = 2**25
"""Largest picture that is unpacked [px]; those of 8K are smaller."""
MOST_BYTES = 8 * MOST_PIXELS
"""Largest file of a picture [bytes]: four channels of 16 bits, not packed."""

_PIXEL_LIMIT = f"{MOST_PIXELS / 1e6:.0f} million pixels; store it smaller"
"""End of the error message about a picture that is too large."""


def read_image(path: Path, flags: int = cv2.IMREAD_COLOR_RGB, most: float = MOST_PIXELS) -> np.ndarray:
    """Read an image file by its bytes, so that any file name works: RGB uint8 [H, W, 3] by default.

    Args:
        flags: flags of `cv2.imdecode`.
        most: largest number of pixels of a PNG; no picture may have more than `MOST_PIXELS`.

    Raises:
        InputError: missing, empty, truncated, undecodable or too large file.
    """
    try:
        if path.exists() and not path.is_file():  # reading a pipe would wait, reading a device has no end
            raise InputError(f"{printable(path)} is no file; put the picture itself there.")
        content = read_file(path, MOST_BYTES)
    except OSError as error:
        raise InputError(f"{printable(path)} can't be read ({error.strerror}); check the file.") from error
    return decode_image(content, printable(path), flags, most)


def decode_image(content: bytes, name: str, flags: int = cv2.IMREAD_COLOR_RGB, most: float = MOST_PIXELS) -> np.ndarray:
    """Decode an image file's bytes; arguments as in `read_image`, `name` begins the error message.

    Raises:
        InputError: empty, truncated, undecodable or too large content.
    """
    if not content:
        raise InputError(f"{name} is an empty file (0 bytes); copy it again.")
    width, height = (int.from_bytes(content[place : place + 4], "big") for place in (16, 20))
    if content[12:16] == b"IHDR":
        if width * height > most != MOST_PIXELS:
            raise InputError(f"{name} is {width}x{height}, far larger than its picture; store it at that size.")
        require_pixels(name, width, height)
    image = None
    if not _truncated(content):
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        except cv2.error as error:
            if "MAX_IMAGE" in str(error):
                raise InputError(f"{name} is more than {_PIXEL_LIMIT}.") from error
    if image is None:
        raise InputError(f"{name} can't be decoded as an image (truncated or damaged); copy it again.")
    return image


def require_pixels(named: str, width: int, height: int) -> None:
    """Refuse a picture by the size that it declares, before it is unpacked; `named` begins the error message.

    Raises:
        InputError: it is larger than `MOST_PIXELS`.
    """
    if width * height > MOST_PIXELS:
        raise InputError(f"{named} is {width}x{height}, more than {_PIXEL_LIMIT}.")


def picture_size(path: Path, width: int, height: int) -> tuple[int, int]:
    """(width, height) of a clip's pictures, for which OpenCV's optical flow works.

    Raises:
        InputError: they are too small, or too long for their height.
    """
    if min(width, height) < 32 or max(width, height) > 4 * min(width, height):
        problem = f"{printable(path)} has pictures of {width}x{height}"
        raise InputError(f"{problem}; give at least 32x32 and at most 4:1.")
    return width, height


def _truncated(content: bytes) -> bool:
    """Return whether a PNG or JPEG lacks its end marker: decoders may fill up the rest of the picture with grey."""
    if content.startswith(b"\x89PNG"):
        return b"IEND" not in content[-4096:]
    return content.startswith(b"\xff\xd8") and b"\xff\xd9" not in content[-4096:]


def printable(path: Path) -> str:
    """The path as text that any terminal and file can hold; the middle of one of many folders is left out."""
    text = plain(os.fsencode(path).decode("utf-8", "replace"))
    half = 300
    return text if len(text) <= 2 * half else f"{text[:half]}…{text[-half:]}"
