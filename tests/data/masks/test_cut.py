"""Instruments cut out by strokes, drawn ones and those that people outlined in real pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.instruments import instrument, sources
from palpate.data.masks.cut import InstrumentCut, Stroke
from palpate.data.source.images import read_image
from tests.data.masks.test_outlined import HEIGHT, WIDTH, picture

LEAST = 0.004
"""Smallest instrument, as a share of the picture."""


def filled(polygons: list[np.ndarray], size: tuple[int, ...]) -> np.ndarray:
    mask = np.zeros(size, np.uint8)
    cv2.fillPoly(mask, [np.rint(each).astype(np.int32) for each in polygons], 1)
    return mask > 0


def middle_line(mask: np.ndarray) -> np.ndarray:
    """A line along the widest part of a mask bool [H, W], as a person draws it, shape [2, 2] [px]."""
    depth = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    _, numbers, boxes, _ = cv2.connectedComponentsWithStats((depth > 0.5 * depth.max()).astype(np.uint8))
    places = np.argwhere(numbers == 1 + boxes[1:, cv2.CC_STAT_AREA].argmax())[:, ::-1].astype(float)
    axis = np.linalg.svd(places - places.mean(0), full_matrices=False)[2][0]
    along = (places - places.mean(0)) @ axis
    return places.mean(0) + 0.9 * (places[[along.argmin(), along.argmax()]] - places.mean(0))


def test_one_line_outlines_a_shaft_and_one_beside_it_takes_it_back() -> None:
    image, mask = picture(((200, 120), 0.1), ((300, 250), -0.2))
    _, numbers = cv2.connectedComponents(mask.astype(np.uint8))
    shaft = numbers == numbers[118, 180]
    line = Stroke(middle_line(shaft))
    found = filled(InstrumentCut().outlines(image, [line]), mask.shape)
    assert (found & shaft).sum() / (found | shaft).sum() > 0.85
    assert not (found & mask & ~shaft).any()
    beside = Stroke(np.array([[WIDTH - 20.0, 10.0], [WIDTH - 20.0, HEIGHT - 10.0]]), instrument=False)
    assert (filled(InstrumentCut().outlines(image, [line, beside]), mask.shape) & shaft).sum() > 0.85 * shaft.sum()
    assert InstrumentCut().outlines(image, [beside]) == []
    click = filled(InstrumentCut().outlines(image, [Stroke(np.array([[180.0, 118.0]]))]), mask.shape)
    assert click[118, 180]
    assert not (click & mask & ~shaft).any()


@pytest.mark.slow
def test_lines_outline_instruments_of_real_pictures(real_data: Path) -> None:
    """The mean IoU after one, two and three lines, the later ones along the largest error, reaches 0.65, 0.72, 0.76."""
    cut, overlaps = InstrumentCut(), []
    found = [each for name, of in sources(real_data).items() if "path_traced" not in name for each in of[::3]]
    for file, drawn in found:
        image = read_image(file)
        truth = instrument(drawn, image.shape[:2])
        _, numbers, boxes, _ = cv2.connectedComponentsWithStats((truth == 1).astype(np.uint8))
        for number in 1 + np.flatnonzero(boxes[1:, cv2.CC_STAT_AREA] >= LEAST * truth.size):
            own, strokes, row = numbers == number, [], []
            others, wrong, on = (truth > 0) & ~own, own, True
            for _ in range(3):
                strokes.append(Stroke(middle_line(wrong), on))
                found = filled(cut.outlines(image, strokes), truth.shape) & ~others
                row.append((found & own).sum() / (found | own).sum())
                wrong, on = max(((own & ~found, True), (found & ~own, False)), key=lambda each: each[0].sum())
            overlaps.append(row)
    assert len(overlaps) > 20
    assert (np.mean(overlaps, axis=0) >= (0.65, 0.72, 0.76)).all()
