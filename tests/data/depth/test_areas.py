"""Tests of the means of a map over a grid's pixels, label by label."""

import cv2
import numpy as np
import pytest

from palpate.data.depth.areas import ORDER, label_areas

GRID = 120, 214


@pytest.mark.parametrize("size", [(720, 1280), (480, 854), (480, 856), (121, 300), (80, 100)])
def test_areas_are_those_of_opencv_to_the_bit(size: tuple[int, int]) -> None:
    random = np.random.default_rng(5)
    labels = cv2.resize(random.choice(np.uint8([*ORDER, 7]), (9, 16)), size[::-1], interpolation=cv2.INTER_NEAREST)
    depth = np.where(random.random(size) < 0.1, 0, random.random(size)).astype(np.float32)
    how = cv2.INTER_AREA if size[0] >= GRID[0] else cv2.INTER_LINEAR
    for found, label in zip(np.moveaxis(label_areas(depth, labels, GRID), 1, 0), ORDER, strict=True):
        member = (labels == label).astype(np.float32)
        expected = member, member * (depth > 0), member * depth
        assert np.array_equal(found, [cv2.resize(each, GRID[::-1], interpolation=how) for each in expected])
