"""Pictures of a camera that moves: where places come to lie in the reference, and when there is another one."""

import cv2
import numpy as np
import pytest

from palpate.data.labels import TISSUE, TOOL
from palpate.data.shading.registration import Registration, View
from palpate.data.tracks.following import Shown

SHAPE, GRID = (240, 320), (60, 80)


def texture(seed: int = 1) -> np.ndarray:
    coarse = np.random.default_rng(seed).uniform(90, 200, (30, 40, 3)).astype(np.float32)
    return cv2.resize(coarse, SHAPE[::-1], interpolation=cv2.INTER_CUBIC).clip(60, 240).astype(np.uint8)


def moved(picture: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return cv2.warpPerspective(picture, matrix, SHAPE[::-1], borderMode=cv2.BORDER_REFLECT)


def labels(tool: slice | None = None) -> np.ndarray:
    found = np.full(SHAPE, TISSUE, np.uint8)
    if tool is not None:
        found[:, tool] = TOOL
    return found


def push(registration: Registration, picture: np.ndarray, named: np.ndarray) -> tuple[View, np.ndarray, np.ndarray]:
    view, registered = registration.push(Shown.of_view((picture, named)))
    return view, *registered()


PICTURE = texture()


@pytest.fixture
def registration() -> Registration:
    """Registration of a clip that begins with the picture."""
    begun = Registration(GRID)
    push(begun, PICTURE, labels())
    return begun


def test_a_camera_that_stands_leaves_every_pixel_as_it_is(registration):
    noise = np.random.default_rng(2).normal(0, 2, PICTURE.shape)
    noisy = (PICTURE + noise).clip(0, 255).astype(np.uint8)
    view, shown, named = push(registration, noisy, labels())
    assert view.reference == 1
    assert np.array_equal(view.matrix, np.eye(3))
    assert np.array_equal(shown, noisy)
    assert (named == TISSUE).all()


def test_places_of_a_moved_picture_are_found_in_the_reference_and_back(registration):
    matrix = np.vstack([cv2.getRotationMatrix2D((160, 120), 4, 1.03), [0, 0, 1]])
    matrix[:2, 2] += [6, -3]
    view, shown, _ = push(registration, moved(PICTURE, matrix), labels(slice(150, 170)))
    assert view.reference == 1
    column, row = (matrix @ [100.0, 80.0, 1.0])[:2]
    place = (np.array([row, column]) + 0.5) / 4 - 0.5
    assert view.moved(place) == pytest.approx((np.array([80.0, 100.0]) + 0.5) / 4 - 0.5, abs=0.05)
    assert view.back(view.moved(place)) == pytest.approx(place)
    inner = np.s_[40:-40, 60:-60]
    assert np.abs(shown[inner].astype(float) - PICTURE[inner]).mean() < 2


def test_the_instrument_is_warped_with_its_picture(registration):
    matrix = np.array([[1, 0, 10.0], [0, 1, 0], [0, 0, 1]])
    _, _, named = push(registration, moved(PICTURE, matrix), labels(slice(150, 170)))
    assert (named[120] == TOOL).nonzero()[0][[0, -1]] == pytest.approx([140, 159], abs=1)


@pytest.mark.parametrize("other", ["scene", "far"])
def test_another_scene_and_a_view_far_away_have_another_reference(registration, other):
    following, speed = (texture(2), 0.0) if other == "scene" else (PICTURE, 10.0)
    for step in range(1, 12):
        shift = np.array([[1, 0, speed * step], [0, 1, 0], [0, 0, 1]])
        view, _, _ = push(registration, moved(following, shift), labels())
    assert view.reference == 2
