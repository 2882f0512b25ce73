"""Measures of masks against drawn outlines, on masks whose errors are known."""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks import instruments
from palpate.data.labels import TISSUE, TOOL
from palpate.data.source.frames import Frame

LENGTH, WIDTH = 200, 20
"""Columns of the drawn shaft, which enters on the left, and its rows [px]."""


def shaft(length: int) -> np.ndarray:
    """Mask of a shaft, bool [224, 384]."""
    mask = np.zeros((224, 384), bool)
    mask[100 : 100 + WIDTH, :length] = True
    return mask


class Masks:
    """A mask source that finds a shaft as long as the picture is bright; its network is not looked at."""

    def __init__(self, _: Path, **__: object) -> None: ...

    def reset(self) -> None: ...

    def __call__(self, frame: Frame) -> np.ndarray:
        return np.where(shaft(int(frame.picture[0, 0, 0])), TOOL, TISSUE).astype(np.uint8)


def measured(folder: Path, found: list[int], drawn: list[int]) -> pd.Series:
    pictures = []
    for number, (bright, length) in enumerate(zip(found, drawn, strict=True)):
        picture, mask = folder / f"{number}.png", folder / f"{number}_tool.png"
        cv2.imwrite(str(picture), np.full((224, 384, 3), bright, np.uint8))
        cv2.imwrite(str(mask), 255 * shaft(length).astype(np.uint8))
        pictures.append((picture, mask))
    rows = [{"source": "drawn", **row} for row in instruments.measured(Path("x.onnx"), pictures)]
    return instruments.table(pd.DataFrame(rows)).iloc[0]


def test_masks_that_end_early_lose_overlap_and_beyond_sixteen_pixels_their_tips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(instruments, "AutomaticMasks", Masks)
    found = measured(tmp_path, [LENGTH, LENGTH - 14, LENGTH - 20, 30], [LENGTH, LENGTH, LENGTH, LENGTH + 20])
    assert found["IoU"] == pytest.approx(np.mean([1, 186 / 200, 180 / 200, 30 / 220]))
    assert (found["pictures"], found["below 0.05"], found["tips"]) == (4, 0, 0.5)
    assert (found["stray pixels"], found["tool-free"]) == (0, 0)


def test_what_is_found_where_nothing_is_drawn_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instruments, "AutomaticMasks", Masks)
    found = measured(tmp_path, [30, LENGTH, 0], [0, 100, 0])
    assert (found["tool-free"], found["tool found there"]) == (2, 1)
    beyond = (LENGTH - 100 - 4) * WIDTH
    assert found["stray pixels"] == pytest.approx((30 * WIDTH + beyond) / 3)
    assert found["above 100"] == pytest.approx(2 / 3)
    assert (found["tips"], found["IoU"]) == (0, 0.5)
