"""The tracker follows known motions of the tissue, whatever the tool does."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.tracks.following import Shown
from palpate.data.tracks.tissue import TissueTracker

HEIGHT, WIDTH = 240, 320


def texture(seed: int = 0, contrast: float = 40.0) -> np.ndarray:
    """Random smooth tissue texture, RGB uint8."""
    rng = np.random.default_rng(seed)
    noise = sum(cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH)), (0, 0), sigma) * sigma for sigma in (2, 4, 8))
    gray = np.clip(130 + contrast * noise / noise.std(), 0, 255)
    return np.dstack([gray, gray * 0.6, gray * 0.5]).astype(np.uint8)


def shifted(image: np.ndarray, du: float, dv: float) -> np.ndarray:
    matrix = np.float32([[1, 0, du], [0, 1, dv]])
    return cv2.warpAffine(image, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


TISSUE = np.ones((HEIGHT, WIDTH), np.uint8)
POINTS = np.array([[100.0, 120.0], [201.5, 80.25]])


def followed(first: np.ndarray, second: np.ndarray, points=POINTS, labels=(TISSUE, TISSUE)) -> np.ndarray:
    """Points by the tissue around them."""
    tracker, pair = TissueTracker(), [*map(Shown.of_view, zip((first, second), labels, strict=True))]
    return np.array([tracker.near(*pair, point) for point in points])


@settings(max_examples=15, deadline=None)
@given(st.floats(-9, 9), st.floats(-9, 9), st.integers(0, 5))
def test_translation_is_followed_below_a_third_of_a_pixel(du, dv, seed):
    image = texture(seed)
    moved = followed(image, shifted(image, du, dv))
    assert np.abs(moved - POINTS - [du, dv]).max() < 0.3


def test_local_deformation_is_followed_where_it_is():
    image = texture(3)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    bump = 4 * np.exp(-((u - 100) ** 2 + (v - 120) ** 2) / (2 * 35.0**2)).astype(np.float32)
    # The inverse warp moves the top of the bump by d = 4 exp(-d²/2450) = 3.97 px.
    deformed = cv2.remap(image, u, v - bump, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    moved = followed(image, deformed, np.array([[100.0, 120.0], [280.0, 30.0]]))
    assert moved == pytest.approx(np.array([[100, 123.97], [280, 30]]), abs=0.3)


@pytest.mark.parametrize("speed", [3, 8])
def test_moving_tool_does_not_drag_static_tissue(speed):
    image, shaft = texture(1), texture(9, contrast=70.0)

    def scene(offset: int) -> tuple[np.ndarray, np.ndarray]:
        picture, labels = image.copy(), TISSUE.copy()
        rows = slice(100 + offset, 130 + offset)
        picture[rows, : 160 + offset] = 255 - shaft[100:130, : 160 + offset]
        labels[rows, : 160 + offset] = 2
        return picture, labels

    pictures, labels = zip(scene(0), scene(speed), strict=True)
    contact = np.array([[163.0 + speed, 115.0]])
    assert np.abs(followed(*pictures, contact, labels) - contact).max() < 0.5


def test_point_that_leaves_the_picture_is_lost():
    image = texture(4)
    moved = followed(image, shifted(image, -8, 0), np.array([[4.0, 120.0], [90, 90]]))
    assert np.isnan(moved).tolist() == [[True, True], [False, False]]


def test_points_that_are_followed_each_for_itself_are_lost_each_for_itself():
    image, labels = texture(6), TISSUE.copy()
    labels[:, :90] = 0
    points = np.array([[80.0, 120.0], [100.0, 120.0], [201.5, 80.25], [316.0, 100.0]])
    pair = (Shown.of_view((picture, labels)) for picture in (image, shifted(image, 6, -3)))
    moved = TissueTracker().each(*pair, points)
    assert np.isfinite(moved).all(axis=1).tolist() == [False, True, True, False]
    assert np.abs(moved[1:3] - points[1:3] - [6, -3]).max() < 0.3
