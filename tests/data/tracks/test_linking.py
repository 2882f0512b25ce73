"""Places of one picture in another one, and how much two places resemble each other."""

from __future__ import annotations

import numpy as np
import pytest

from data.tracks.linking import REACH, STEP, Linker, resemblance
from tests.data.tracks.test_following import HEIGHT, WIDTH, shift, texture, warped

PLACES = np.array([[40.0, 40.0], [88.0, 64.0], [120.0, 90.0]], np.float32)


def gray(picture: np.ndarray) -> np.ndarray:
    return picture.mean(axis=2).astype(np.uint8)


def test_pictures_are_halved() -> None:
    linker = Linker((481, 855))
    assert linker.half(np.zeros((481, 855), np.uint8)).shape == (240, 427)
    np.testing.assert_allclose(linker.shares, [855 / 427, 481 / 240])


@pytest.mark.parametrize("guessed", [False, True])
def test_a_shift_is_found_there_and_back(guessed: bool) -> None:
    """In pixels of the whole picture; a guess is in those of the halved one."""
    one, other = texture(1), warped(texture(1), shift(6.0, -4.0))
    linker = Linker((HEIGHT, WIDTH))
    halves = [linker.half(gray(picture)) for picture in (one, other)]
    guess = np.full((HEIGHT // 2, WIDTH // 2, 2), [3.0, -2.0], np.float32) if guessed else None
    places, returned = linker.link(halves[0], halves[1], PLACES, guess)
    np.testing.assert_allclose(places - PLACES, np.broadcast_to([6.0, -4.0], PLACES.shape), atol=0.25)
    assert returned.max() < 0.2


def test_no_places_are_no_places() -> None:
    linker = Linker((HEIGHT, WIDTH))
    halved = linker.half(gray(texture()))
    places, returned = linker.link(halved, halved, np.zeros((0, 2), np.float32))
    assert places.shape == (0, 2)
    assert returned.shape == (0,)
    assert resemblance(halved, halved, places, places).shape == (0,)


def test_resemblance_is_the_correlation_of_the_patterns() -> None:
    """By hand, and whatever the light: half as bright is the same pattern, its negative the opposite."""
    one, other = gray(texture(1)), gray(texture(2))
    steps = np.arange(-REACH, REACH + 1, STEP)
    for place in PLACES.astype(int):
        columns, rows = np.meshgrid(place[0] + steps, place[1] + steps)
        expected = np.corrcoef(one[rows, columns].ravel(), other[rows, columns].ravel())[0, 1]
        assert resemblance(one, other, place[None], place[None]) == pytest.approx(expected, abs=1e-4)
    assert resemblance(one, one // 2, PLACES, PLACES) == pytest.approx(1, abs=0.01)
    assert resemblance(one, 255 - one, PLACES, PLACES) == pytest.approx(-1, abs=1e-5)


def test_a_plain_surface_resembles_nothing() -> None:
    plain = np.full((HEIGHT, WIDTH), 90, np.uint8)
    np.testing.assert_array_equal(resemblance(plain, plain, PLACES, PLACES), 0)
