"""Video files as they are written, with an encoder of H.264 and without."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.source import video
from palpate.data.source.video import open_video


@pytest.fixture(params=[True, False], ids=["H.264", "without"])
def h264(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    if not request.param:
        monkeypatch.setattr(video.H264, "encoder", "none")
    return request.param


def test_video_keeps_rate_count_and_size(tmp_path: Path, h264: bool) -> None:
    path = tmp_path / "overlay.mp4"
    opened = open_video(path, (642, 482), 30000 / 1001)
    for level in range(12):
        opened.write(np.full((482, 642, 3), 20 * level, np.uint8))
    opened.close()
    assert opened.encoder == ("libx264" if h264 else "mp4v")
    reader = cv2.VideoCapture(str(path))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 12
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(29.97, abs=0.01)
    frames = [reader.read()[1] for _ in range(12)]
    assert [abs(float(frame.mean()) - 20 * level) < 6 for level, frame in enumerate(frames)] == [True] * 12


@pytest.mark.usefixtures("h264")
def test_missing_folder_is_an_os_error(tmp_path: Path) -> None:
    def attempt() -> None:
        opened = open_video(tmp_path / "nowhere" / "overlay.mp4", (640, 360), 25.0)
        opened.write(np.full((360, 640, 3), 90, np.uint8))
        opened.close()

    with pytest.raises(OSError, match=r"write|No such"):
        attempt()
