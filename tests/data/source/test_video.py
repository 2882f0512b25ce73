"""Video files as they are written."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.source.video import Video


def test_video_keeps_rate_count_and_size(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    opened = Video(path, (642, 482), 30000 / 1001)
    for level in range(12):
        opened.write(np.full((482, 642, 3), 20 * level, np.uint8))
    opened.close()
    reader = cv2.VideoCapture(str(path))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 12
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(29.97, abs=0.01)
    frames = [reader.read()[1] for _ in range(12)]
    assert [abs(float(frame.mean()) - 20 * level) < 6 for level, frame in enumerate(frames)] == [True] * 12


def test_missing_folder_is_an_os_error(tmp_path: Path) -> None:
    def attempt() -> None:
        opened = Video(tmp_path / "nowhere" / "overlay.mp4", (640, 360), 25.0)
        opened.write(np.full((360, 640, 3), 90, np.uint8))
        opened.close()

    with pytest.raises(OSError, match=r"write|No such"):
        attempt()


def test_a_pyav_without_the_encoder_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Video, "encoder", "none")
    with pytest.raises(OSError, match="PyAV lacks the encoder none; install its wheel"):
        Video(tmp_path / "overlay.mp4", (640, 360), 25.0)
