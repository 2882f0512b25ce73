"""The picture of a clip."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from estimators.estimate import FrameEstimate
from evaluation import summary
from evaluation.drawing import STATUS_COLORS
from evaluation.summary import HEIGHT, WIDTH, draw_summary, write_summary

BLUE = (37, 99, 235)


def clip(count: int = 20, contact_from: int = 10) -> list[FrameEstimate]:
    return [
        FrameEstimate(i, i / 25, "no_tool")
        if i < contact_from
        else FrameEstimate(i, i / 25, "ok", stiffness=0.5, damping=0.1, force=3.0, observed_displacement=0.01)
        for i in range(count)
    ]


def columns_of(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.flatnonzero((image == color).all(axis=2).any(axis=0))


def test_curve_begins_where_contact_does() -> None:
    image = draw_summary(clip(), title="clip")
    assert image.shape == (HEIGHT, WIDTH, 3)
    drawn = columns_of(image, BLUE)
    left, width = 120, WIDTH - 170
    # 20 frames of 40 ms span 0.8 s; contact begins at 0.4 s and the last point lies at 0.76 s.
    assert abs(drawn.min() - (left + 0.5 * width)) < 8
    assert abs(drawn.max() - (left + 0.95 * width)) < 8


def test_status_strip_shows_every_frame() -> None:
    image = draw_summary(clip(), title="clip")
    for status in ("ok", "no_tool"):
        assert len(columns_of(image, STATUS_COLORS[status])) > 0.4 * (WIDTH - 170)
    assert len(columns_of(image, STATUS_COLORS["bad_depth"])) == 0


def test_rings_mark_undetermined_frames() -> None:
    plain = draw_summary(clip(), title="clip")
    rows = [FrameEstimate(**{**vars(row), "verdict": "undetermined"}) if row.status == "ok" else row for row in clip()]
    ringed = draw_summary(rows, title="clip")
    assert (plain == BLUE).all(axis=2).sum() > (ringed == BLUE).all(axis=2).sum()


@pytest.mark.parametrize("rows", [[], [FrameEstimate(0, 0.0, "no_tool")], clip(1, 0), clip(5, 9)])
def test_short_and_empty_clips_are_drawn(rows: list[FrameEstimate]) -> None:
    assert draw_summary(rows, title="x" * 400, subtitle="y" * 400).min() < 255


def test_value_axis_starts_at_zero_and_has_room() -> None:
    assert summary._value_range(np.array([np.nan, 2.0, 1.0])) == pytest.approx((0.0, 2.24))
    assert summary._value_range(np.array([np.nan])) == pytest.approx((0.0, 1.12))


def test_spread_is_shaded_where_the_model_gives_one() -> None:
    rows = [FrameEstimate(i, i / 25, "ok", stiffness=0.5, stiffness_sd=0.1, damping=0.1, force=3.0) for i in range(10)]
    # 20 % of the curve's blue over white.
    band = tuple(round(0.2 * channel + 0.8 * 255) for channel in BLUE)
    assert (np.abs(draw_summary(rows, title="clip").astype(int) - band).max(axis=2) <= 1).sum() > 1000
    assert (np.abs(draw_summary(clip(), title="clip").astype(int) - band).max(axis=2) <= 1).sum() < 200


def test_written_picture_keeps_its_colours(tmp_path: Path) -> None:
    path = tmp_path / "summary.png"
    image = np.zeros((4, 5, 3), np.uint8)
    image[..., 0] = 250
    write_summary(path, image)
    assert cv2.imread(str(path))[0, 0].tolist() == [0, 0, 250]
    assert [file.name for file in tmp_path.iterdir()] == ["summary.png"]
