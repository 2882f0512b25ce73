"""Image files are read by their bytes, and a cut one is refused before a decoder fills it up or complains."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from data.source.images import read_image
from data.source.layout import InputError


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_cut_image_is_refused_silently(tmp_path, capfd, suffix):
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    content = cv2.imencode(suffix, picture)[1].tobytes()
    path = tmp_path / f"手術{suffix}"
    path.write_bytes(content)
    assert read_image(path).shape == (48, 64, 3)
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(
        InputError, match=r"手術.* can't be decoded as an image \(truncated or damaged\); copy it again"
    ):
        read_image(path)
    assert capfd.readouterr().err == ""


def test_channels_come_as_rgb(tmp_path):
    path = tmp_path / "red.png"
    path.write_bytes(cv2.imencode(".png", np.full((2, 2, 3), (0, 0, 200), np.uint8))[1].tobytes())
    assert read_image(path)[0, 0].tolist() == [200, 0, 0]
