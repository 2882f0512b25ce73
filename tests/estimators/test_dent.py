"""The deepest dent against rest, frame by frame."""

import numpy as np
import pytest

from palpate.estimators.dent import LEAST_REST, MOST_REST, DentRecorder, deepest, median_of_valid

ROWS, COLUMNS = np.mgrid[:60, :80]
SHAPE = np.exp(-((ROWS - 30) ** 2 + (COLUMNS - 40) ** 2) / (2 * 12.0**2))


def seen(depths: list[float], noise: float = 0.0) -> DentRecorder:
    chance, recorder = np.random.default_rng(0), DentRecorder((0.0, 0.9))
    for number, depth in enumerate([0.0] * 10 + depths):
        frame = 0.5 + depth * SHAPE + chance.normal(0, noise, SHAPE.shape)
        frame[:3] = 0  # invalid
        frame[number % 20, 5] = 0.9  # a wild pixel
        recorder.push(number, 0.1 * number, frame.astype(np.float32))
    return recorder


def test_dents_either_way_are_in_proportion_and_noise_is_smoothed() -> None:
    wanted = np.array([0.01, 0.03, 0.05])
    exact = seen(wanted.tolist())
    assert (exact.frames, exact.times) == ([10, 11, 12], pytest.approx([1.0, 1.1, 1.2]))
    assert np.array(exact.depths) / wanted == pytest.approx(0.97, abs=0.02)  # the blur takes a little off
    assert seen((-wanted).tolist()).depths == pytest.approx(exact.depths, rel=1e-3)
    assert seen(wanted.tolist(), noise=0.002).depths == pytest.approx(exact.depths, abs=0.0015)


def test_without_rest_there_is_no_dent_and_rest_is_bounded() -> None:
    short, long = DentRecorder((0.0, 1.0)), DentRecorder((0.0, 1e3))
    for number in range(LEAST_REST - 1):
        short.push(number, 0.1 * number, np.ones((4, 4)))
    short.push(99, 2.0, np.ones((4, 4)))
    assert short.depths == []
    for number in range(3 * MOST_REST):
        long.push(number, number, np.ones((4, 4)))
    assert len(long._at_rest) == MOST_REST


def test_places_that_are_rarely_valid_count_as_unknown() -> None:
    maps = [np.array([[1.0, 0.0, 2.0]]), np.array([[3.0, 5.0, 0.0]]), np.array([[2.0, 0.0, 4.0]])]
    assert median_of_valid(maps).tolist() == [[2.0, 0.0, 3.0]]
    assert deepest(np.zeros((8, 8)), np.ones((8, 8))) == 0.0
