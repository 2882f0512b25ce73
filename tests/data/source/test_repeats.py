"""Repeated pictures are told from still scenes, with noise and without."""

import numpy as np
import pytest

from palpate.data.source.frames import Frame
from palpate.data.source.repeats import mark_repeats


def marked(pictures: list[np.ndarray], *, look_ahead: bool = True) -> list[int]:
    frames = (Frame(index, index, index / 25, picture) for index, picture in enumerate(pictures))
    return [frame.index for frame, repeats in mark_repeats(frames, look_ahead) if repeats]


def moving(count: int, noise: float, still: tuple[int, ...] = ()) -> list[np.ndarray]:
    """A bright square that goes 4 px a frame, and stands in some frames."""
    rng, place, pictures = np.random.default_rng(0), 0, []
    for index in range(count):
        place += 0 if index in still else 4
        picture = np.full((64, 96, 3), 100.0)
        picture[20:40, place : place + 16] = 200
        pictures.append(np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8))
    return pictures


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_picture_that_repeats_between_others_that_move_is_found(noise: float) -> None:
    pictures = moving(12, noise)
    assert marked(pictures) == []
    pictures[7] = pictures[6]
    assert marked(pictures) == [7]


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_of_25_frames_recorded_at_50_every_second_one_repeats(noise: float) -> None:
    doubled = [picture for picture in moving(12, noise) for _ in range(2)]
    found = marked(doubled)
    assert set(range(7, 22, 2)) <= set(found) <= set(range(1, 24, 2))


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_still_scene_does_not_repeat(noise: float) -> None:
    """Not before anything moves, nor between moves; with noise not even for one frame."""
    assert marked(moving(16, noise, still=(0, 1, 2, 3, 4, 9, 10, 11, 12))) == []
    if noise:
        assert marked(moving(12, noise, still=(7,))) == []


def test_noise_tells_long_repeats_and_needs_no_later_frames() -> None:
    pictures = moving(16, 2.0)
    pictures[6:14] = [pictures[5]] * 8
    assert marked(pictures, look_ahead=False) == list(range(6, 14))
    pictures = moving(12, 0.0)
    pictures[7] = pictures[6]
    assert marked(pictures, look_ahead=False) == []
