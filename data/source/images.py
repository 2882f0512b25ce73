"""Image files by their bytes, and paths as text."""

from __future__ import annotations

import os
import threading
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

# Decoder messages about broken files would bury our own sentence.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
import cv2
import numpy as np

from data.source.layout import InputError
from physics.doors import plain
from physics.files import read_file

# The environment's level is read when OpenCV is first imported, which may have been elsewhere.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

MOST_PIXELS = 2**25
"""Larger pictures are not unpacked; those of 8K have fewer."""
MOST_BYTES = 8 * MOST_PIXELS
"""No picture's file is larger: four channels of 16 bits, not packed."""
LONGEST = 600
"""Letters of a path in a sentence."""
_ONE_AT_A_TIME = threading.Lock()
"""Else one thread would keep what another has put in descriptor 2's place."""
_MOST = f"{MOST_PIXELS / 1e6:.0f} million pixels; store it smaller"


def read_image(path: Path, flags: int = cv2.IMREAD_COLOR_RGB, most: float = MOST_PIXELS) -> np.ndarray:
    """Read an image file by its bytes, so that any file name works: RGB uint8 [H, W, 3] by default.

    Args:
        flags: OpenCV's.
        most: pixels; a PNG that declares more is not unpacked, nor any picture that has more than `MOST_PIXELS`.

    Raises:
        InputError: missing, empty, truncated, undecodable or too large file.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for, a device has no end
            raise InputError(f"{printable(path)} is no file; put the picture itself there.")
        content = read_file(path, MOST_BYTES)
    except OSError as error:
        raise InputError(f"{printable(path)} can't be read ({error.strerror}); check the file.") from error
    if not content:
        raise InputError(f"{printable(path)} is an empty file (0 bytes); copy it again.")
    width, height = (int.from_bytes(content[place : place + 4], "big") for place in (16, 20))
    if content[12:16] == b"IHDR":
        if width * height > most != MOST_PIXELS:
            told = f"is {width}x{height}, far larger than its picture; store it at that size"
            raise InputError(f"{printable(path)} {told}.")
        require_pixels(path, width, height)
        if _packed(content) > 9 * width * height + 2**12:  # more than four channels of 16 bits that can't be packed
            raise InputError(f"{printable(path)} is far larger than a picture of {width}x{height}; store it anew.")
    image = None
    if not _truncated(content):
        try:
            with _silence():
                image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        except cv2.error as error:
            if "MAX_IMAGE" in str(error):
                raise InputError(f"{printable(path)} is more than {_MOST}.") from error
    if image is None:
        raise InputError(f"{printable(path)} can't be decoded as an image (truncated or damaged); copy it again.")
    return image


@contextmanager
def _silence() -> Generator[None]:
    """Keep descriptor 2 from what libpng prints there by itself; our sentence says that a file is damaged."""
    with _ONE_AT_A_TIME, ExitStack() as after:
        with suppress(OSError):  # closed by the shell
            kept = os.dup(2)
            after.callback(os.close, kept)
            after.callback(os.dup2, kept, 2)
            nothing = os.open(os.devnull, os.O_WRONLY)
            after.callback(os.close, nothing)
            os.dup2(nothing, 2)
        yield


def require_pixels(path: Path, width: int, height: int) -> None:
    """Refuse a picture by the size that it declares, before it is unpacked.

    Raises:
        InputError: it is larger than `MOST_PIXELS`.
    """
    if width * height > MOST_PIXELS:
        raise InputError(f"{printable(path)} is {width}x{height}, more than {_MOST}.")


def _packed(content: bytes) -> int:
    """Bytes of a PNG's packed pixels."""
    place, found = 8, 0
    while place + 8 <= len(content):
        size = int.from_bytes(content[place : place + 4], "big")
        found += size if content[place + 4 : place + 8] == b"IDAT" else 0
        place += 12 + size
    return found


def _truncated(content: bytes) -> bool:
    """Whether a PNG or JPEG lacks its end marker: decoders may fill up the rest of the picture with grey."""
    if content.startswith(b"\x89PNG"):
        return b"IEND" not in content[-4096:]
    return content.startswith(b"\xff\xd8") and b"\xff\xd9" not in content[-4096:]


def printable(path: Path) -> str:
    """The path as text that any terminal and file can hold; the middle of one of many folders is left out."""
    text = plain(os.fsencode(path).decode("utf-8", "replace"))
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2]}…{text[-LONGEST // 2 :]}"
