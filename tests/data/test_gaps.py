"""Gaps go with the measurement after them; those that nobody can bridge come as frames."""

import numpy as np
import pytest

from palpate.data.gaps import bridge_gaps, gap
from palpate.data.labels import TISSUE
from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import Frame

SHAPE = (12, 16)


def clip(scales: list[float | None], held: tuple[int, ...] = ()) -> list[PreparedFrame]:
    """Frames of noisy depth of some scales; None = the picture repeats; held = the depth of the frame before."""
    rng, frames = np.random.default_rng(0), []
    for index, scale in enumerate(scales):
        frame = Frame(index, index, index / 25, np.zeros((24, 32, 3), np.uint8))
        if scale is None:
            frames.append(gap(frame, SHAPE))
            continue
        depth = (0.3 * scale + rng.normal(0, 0.001, SHAPE)).astype(np.float32)
        depth = frames[-1].depth if index in held else depth
        frames.append(PreparedFrame(frame, "ok", "", depth, np.full(SHAPE, TISSUE, np.uint8)))
    return frames


def outcome(frames: list[PreparedFrame], *, stored: bool = True) -> list[tuple[int, str, list[str]]]:
    found = list(bridge_gaps(frames, stored))
    assert [frame.frame.index for frame in found] == list(range(len(found)))
    return [(frame.frame.number, frame.status, [each.status for each in frame.skipped]) for frame in found]


def test_measurements_around_repeats_are_neighbours() -> None:
    found = list(bridge_gaps(clip([1, 1, None, None, 1]), True))
    assert [frame.frame.number for frame in found] == [0, 1, 4]
    assert found[2].follows(1)
    assert not found[2].follows(0)


@pytest.mark.parametrize("factor", [0.5, 1.3, 2])
def test_one_map_of_another_scale_is_bad_depth(factor: float) -> None:
    found = outcome(clip([1, 1, 1, 1, factor, 1, 1]))
    assert found[4] == (5, "ok", ["bad_depth"])
    assert [number for number, *_ in found] == [0, 1, 2, 3, 5, 6]


def test_a_scale_that_changes_for_good_ends_what_is_observed() -> None:
    found = outcome(clip([1, 1, 1, 2, 2, 2]))
    assert found[3:] == [(3, "bad_depth", []), (4, "ok", []), (5, "ok", [])]


def test_flicker_of_the_scale_is_no_jump() -> None:
    scales = [1.0, 1.06, 1.0, 1.05, 0.99, 1.13, 1.0, 1.05]
    assert len(outcome(clip(scales))) == len(scales)


def test_stored_depth_that_repeats_is_a_gap_and_guessed_depth_is_not() -> None:
    frames = [1.0] * 8
    assert outcome(clip(frames, held=(5,)))[5] == (6, "ok", ["repeated"])
    assert len(outcome(clip(frames, held=(5,)), stored=False)) == 8


def test_long_gaps_and_those_at_the_end_come_as_frames() -> None:
    long = outcome(clip([1, 1, *[None] * 6, 1]))
    assert [status for _, status, _ in long] == ["ok", "ok", *["repeated"] * 6, "ok"]
    assert outcome(clip([1, None]))[1] == (1, "repeated", [])
