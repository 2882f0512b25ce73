"""What is drawn on a frame, and the video file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from estimators.estimate import FrameEstimate
from evaluation import overlay
from evaluation.overlay import OverlayVideo, canvas_size, draw_overlay

SIZE = (640, 360)
OK = FrameEstimate(7, 0.28, "ok", stiffness=0.5, damping=0.1, force=2.0, contact=True, contact_u=400.0, contact_v=200.0)


def grey(size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.full((size[1], size[0], 3), 90, np.uint8)


def labels() -> np.ndarray:
    found = np.zeros((180, 320), np.uint8)
    found[80:150, 150:300] = overlay.TISSUE
    found[60:80, 200:220] = overlay.TOOL
    return found


@pytest.mark.parametrize(
    ("size", "expected"), [((854, 480), (854, 480)), ((741, 539), (742, 540)), ((213, 119), (640, 358))]
)
def test_canvas_is_even_and_wide_enough(size: tuple[int, int], expected: tuple[int, int]) -> None:
    assert canvas_size(size) == expected


def test_outlines_lie_where_the_masks_end() -> None:
    plain = draw_overlay(grey(), SIZE, None, FrameEstimate(7, 0.28, "no_contact"))
    drawn = draw_overlay(grey(), SIZE, labels(), FrameEstimate(7, 0.28, "no_contact"))
    changed = (plain != drawn).any(axis=2)
    rows, columns = np.nonzero(changed)
    # Label pixel i covers the picture's pixels 2i and 2i + 1; the smoothed line is a few pixels wide.
    assert abs(columns.min() - 300) <= 6
    assert abs(columns.max() - 599) <= 6
    assert abs(rows.min() - 120) <= 6
    assert abs(rows.max() - 299) <= 6
    assert not changed[180:280, 330:580].any()


def test_contact_ring_and_arrow_are_drawn_there() -> None:
    plain = draw_overlay(grey(), SIZE, None, FrameEstimate(7, 0.28, "ok", stiffness=0.5, damping=0.1, force=2.0))
    drawn = draw_overlay(grey(), SIZE, None, OK, arrow=((500.0, 120.0), (400.0, 200.0)))
    changed = (plain != drawn).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert changed[160, 450]
    assert columns.min() >= 385
    assert columns.max() <= 510
    assert rows.max() <= 235


def test_unreadable_frame_is_black_with_its_status() -> None:
    picture = draw_overlay(None, SIZE, None, FrameEstimate(3, 0.1, "unreadable"))
    assert picture.shape == (360, 640, 3)
    assert picture[150:300].max() < 20
    assert picture[:60, :200].max() > 200


def test_panel_shows_numbers_only_where_there_are_some() -> None:
    names = [name for name, _ in overlay._number_lines(OK)]
    assert names == ["stiffness k_s", "damping k_d", "force |F|"]
    assert overlay._number_lines(FrameEstimate(1, 0.0, "no_tool")) == []
    with_sd = FrameEstimate(1, 0.0, "ok", stiffness=0.5, stiffness_sd=0.0123)
    assert overlay._number_lines(with_sd) == [("stiffness k_s", "0.5 ± 0.012")]


def test_undetermined_is_said() -> None:
    estimate = FrameEstimate(1, 0.0, "ok", verdict="undetermined", stiffness=0.5)
    assert overlay._notes(estimate, "scene units") == ["scene units", "undetermined by what was seen so far"]


@pytest.mark.parametrize("with_av", [True, False])
def test_video_keeps_rate_count_and_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_av: bool) -> None:
    if with_av:
        pytest.importorskip("av")
    else:
        monkeypatch.setattr(overlay, "av", None)
    path = tmp_path / "overlay.mp4"
    video = OverlayVideo(path, (321, 241), 30000 / 1001)
    for level in range(12):
        video.write(np.full((482, 642, 3), 20 * level, np.uint8))
    video.close()
    assert video.encoder == ("libx264" if with_av else "mp4v")
    reader = cv2.VideoCapture(str(path))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 12
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(29.97, abs=0.01)
    frames = [reader.read()[1] for _ in range(12)]
    assert [abs(float(frame.mean()) - 20 * level) < 6 for level, frame in enumerate(frames)] == [True] * 12


@pytest.mark.parametrize("with_av", [True, False])
def test_missing_folder_is_an_os_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_av: bool) -> None:
    if with_av:
        pytest.importorskip("av")
    else:
        monkeypatch.setattr(overlay, "av", None)

    def attempt() -> None:
        video = OverlayVideo(tmp_path / "nowhere" / "overlay.mp4", SIZE, 25.0)
        video.write(grey())
        video.close()

    with pytest.raises(OSError, match=r"write|No such"):
        attempt()
