"""Text and panels on frames."""

from __future__ import annotations

import numpy as np
import pytest

from results import drawing
from results.drawing import shade, text, text_width, wrap_text


def test_wrapped_lines_fit_and_lose_nothing() -> None:
    line = "The tissue is pressed at 74° to the line of sight, so its dent may hide its own bottom."
    lines = wrap_text(f"{line} /a/folder/{'name' * 20}.npy", 200, 11)
    assert max(text_width(found, 11) for found in lines) <= 200
    assert " ".join(lines).startswith(line)
    assert "".join(lines).endswith("name" * 3 + ".npy")


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
