"""Image files are read by their bytes, and a cut one is refused before a decoder fills it up or complains."""

import zlib

import cv2
import numpy as np
import pytest

from palpate.data.source.images import read_image
from palpate.data.source.layout import InputError


@pytest.mark.parametrize(("suffix", "kept"), [(".png", 0.5), (".jpg", 0.5), (".jpg", 0.9)])
def test_cut_image_is_refused_silently(tmp_path, capfd, suffix, kept):
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    content = cv2.imencode(suffix, picture)[1].tobytes()
    path = tmp_path / f"手術{suffix}"
    path.write_bytes(content)
    assert read_image(path).shape == (48, 64, 3)
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(InputError, match=r"手.* can't be decoded as an image \(truncated or damaged\); copy it again"):
        read_image(path)
    assert capfd.readouterr().err == ""


def chunk(kind: bytes, content: bytes) -> bytes:
    return len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")


def png(width: int, height: int, kind: int, rows: bytes, *more: bytes, woven: int = 0) -> bytes:
    """A picture of 8 bits whose chunks are sound by themselves."""
    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes((8, kind, 0, 0, woven))
    chunks = (chunk(b"IHDR", head), *more, chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


ROWS = (b"\0" + b"\x55" * 192) * 48
"""64x48, without a filter."""


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(png(64, 48, 2, ROWS[:500]), id="short"),
        pytest.param(png(64, 48, 2, ROWS, woven=1), id="interlaced"),
        pytest.param(png(64, 48, 3, ROWS), id="palette"),
        pytest.param(png(0, 0, 2, ROWS), id="empty"),
        pytest.param(png(2**24, 1, 2, ROWS), id="wide"),
        pytest.param(png(64, 48, 2, ROWS)[:-30] + b"abcd" + png(64, 48, 2, ROWS)[-26:], id="checksum"),
    ],
)
def test_what_a_decoder_refuses_is_a_sentence(tmp_path, content):
    (tmp_path / "1.png").write_bytes(content)
    with pytest.raises(InputError, match=r"1\.png can't be decoded as an image"):
        read_image(tmp_path / "1.png")


def test_a_file_that_no_picture_has_is_not_read(tmp_path):
    with (tmp_path / "1.png").open("wb") as file:
        file.truncate(12 * 2**30)
    with pytest.raises(InputError, match=r"1\.png can't be read \(larger than 262144 kB\); check the file\."):
        read_image(tmp_path / "1.png")
