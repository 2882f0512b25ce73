"""Ticks, axes and text."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation import drawing
from evaluation.drawing import Axes, fit_text, nice_ticks, shade, text, text_width, tick_label


def test_ticks_are_round_numbers() -> None:
    np.testing.assert_allclose(nice_ticks(0.0, 1.0, 5), [0, 0.2, 0.4, 0.6, 0.8, 1.0])
    np.testing.assert_allclose(nice_ticks(0.0, 0.0173, 4), [0, 0.005, 0.01, 0.015])


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.integers(2, 12))
def test_ticks_lie_inside_and_are_few(low: float, span: float, count: int) -> None:
    ticks = nice_ticks(low, low + span, count)
    slack = 1e-6 * (span + abs(low))
    assert len(ticks) <= count + 1
    assert all(low - slack <= tick <= low + span + slack for tick in ticks)


@pytest.mark.parametrize(
    ("value", "step", "expected"),
    [(0.5, 0.25, "0.5"), (0.15, 0.05, "0.15"), (-0.0, 0.1, "0.0"), (20.0, 10.0, "20"), (2e-5, 1e-5, "2e-05")],
)
def test_tick_labels_show_what_the_spacing_needs(value: float, step: float, expected: str) -> None:
    assert tick_label(value, step) == expected


def test_axes_map_the_corners_and_keep_outliers_at_the_border() -> None:
    axes = Axes(np.zeros((100, 200, 3), np.uint8), 10, 20, 100, 50, (0.0, 2.0), (-1.0, 1.0))
    np.testing.assert_allclose(axes.pixels([0.0, 2.0, 1.0], [-1.0, 1.0, 5.0]), [[10, 70], [110, 20], [60, 20]])


def test_a_missing_value_is_a_gap_in_the_curve() -> None:
    image = np.full((60, 200, 3), 255, np.uint8)
    axes = Axes(image, 0, 0, 199, 59, (0.0, 4.0), (0.0, 1.0))
    axes.curve(np.arange(5.0), np.array([0.5, 0.5, np.nan, 0.5, 0.5]), (0, 0, 0))
    middle = image[:, 70:130].min(axis=(0, 2))
    assert middle.min() == 255
    assert image[:, 20:30].min() == 0


def test_band_covers_one_standard_deviation_only() -> None:
    image = np.full((101, 101, 3), 255, np.uint8)
    axes = Axes(image, 0, 0, 100, 100, (0.0, 1.0), (0.0, 1.0))
    axes.band(np.array([0.0, 1.0]), np.array([0.4, 0.4]), np.array([0.6, 0.6]), (0, 0, 0))
    assert image[50, 50, 0] == 204  # 20 % black over white
    assert image[70, 50, 0] == image[30, 50, 0] == 255


def test_fit_text_cuts_with_an_ellipsis() -> None:
    line = "a rather long line of text"
    cut = fit_text(line, 90, 16)
    assert cut.endswith("…")
    assert line.startswith(cut[:-1])
    assert text_width(cut, 16) <= 90
    assert fit_text("short", 300, 16) == "short"


def test_stroke_font_stands_in_for_opencv_4(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "_FONT", None)
    image = np.zeros((40, 300, 3), np.uint8)
    text(image, "θ 0.5 ± 0.1", (290, 30), 20, (255, 255, 255), align="right")
    written = np.flatnonzero(image.any(axis=(0, 2)))
    assert written.max() <= 291
    assert abs(np.ptp(written) - text_width("θ 0.5 ± 0.1", 20)) < 8


def test_shade_darkens_only_its_rectangle() -> None:
    image = np.full((20, 20, 3), 200, np.uint8)
    shade(image, (5, 5), (10, 10), 0.5, (0, 0, 0))
    assert image[10, 10, 0] == 100
    assert image[4, 10, 0] == image[15, 10, 0] == 200
