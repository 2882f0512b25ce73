"""From pictures to light: the response undone, and what is no tissue left out."""

import numpy as np
import pytest

from palpate.data.labels import TISSUE, TOOL
from palpate.data.shading.light import FINE, SRGB, brightness, log_light

GRID = (30, 40)
COLOUR = np.array([0.4, 0.15, 0.1])


def picture(light: np.ndarray | float = 1.0, size: tuple[int, int] = (240, 320)) -> np.ndarray:
    """A picture of tissue of one colour under some light, in sRGB."""
    linear = np.broadcast_to(np.asarray(light, float), size)[..., None] * COLOUR
    return np.searchsorted(SRGB, linear).astype(np.uint8)


def labels(size: tuple[int, int] = (240, 320)) -> np.ndarray:
    return np.full(size, TISSUE, np.uint8)


@pytest.mark.parametrize("light", [0.2, 0.5, 1.0, 2.0])
def test_twice_the_light_is_log_two_whatever_the_level(light):
    change = log_light(picture(light), labels(), GRID) - log_light(picture(light / 2), labels(), GRID)
    assert change.shape == (3, FINE * 30, FINE * 40)
    # A level of 8 bits is up to 8 % of the light in the dark.
    np.testing.assert_allclose(change, np.log(2), atol=0.08)


def test_brightness_is_the_mean_of_red_and_green():
    found = brightness(log_light(picture(), labels(), GRID))
    np.testing.assert_allclose(np.exp(found), COLOUR[:2].mean(), rtol=0.02)


def test_light_is_averaged_before_its_logarithm_is_taken():
    checks = np.where(np.indices((240, 320)).sum(axis=0) % 2, 0.4, 1.6)
    flat, checked = (log_light(picture(light), labels(), GRID) for light in (1.0, checks))
    np.testing.assert_allclose(checked, flat, atol=0.02)


def test_instruments_and_their_edges_are_left_out():
    mask = labels()
    mask[100:140, 150:200] = TOOL
    known = np.isfinite(log_light(picture(), mask, GRID)).all(axis=0)
    assert not known[24:36, 37:51].any()
    assert known[:20].all()
    assert known[40:].all()


def test_highlights_saturated_and_dark_places_are_left_out():
    shown = picture()
    shown[100:108, 100:108] = 235  # white as the lamp, not full
    shown[180:200, 100:120] = 255
    shown[100:120, 200:220] = 3
    known = np.isfinite(log_light(shown, labels(), GRID)).any(axis=0)
    for rows, columns in ((100, 100), (184, 108), (108, 208)):
        assert not known[rows // 4 : rows // 4 + 2, columns // 4 : columns // 4 + 2].any()
    assert known.mean() > 0.95
