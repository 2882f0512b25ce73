"""Pictures as they come: in order, none silently lost, and never older than asked for."""

import io
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.data.source.live import LiveSource, open_live

PICTURE = np.zeros((48, 64, 3), np.uint8)


def marked(count: int, begin: int = 0) -> list[np.ndarray]:
    return [np.full_like(PICTURE, number) for number in range(begin, begin + count)]


def test_pictures_come_in_order_and_one_frame_apart():
    source = LiveSource("somewhere", marked(5), 20.0, 60.0)
    assert (source.size, source.length) == ((64, 48), 0)
    frames = list(source)
    assert [frame.picture[0, 0, 0] for frame in frames] == [0, 1, 2, 3, 4]
    assert [(frame.index, frame.number, frame.time_s) for frame in frames] == [(k, k, k / 20) for k in range(5)]
    assert (sorted(source.came), source.dropped) == ([0, 1, 2, 3, 4], 0)


def test_what_waits_too_long_is_dropped_and_counted():
    source = LiveSource("somewhere", marked(6), 20.0, 0.01)
    time.sleep(0.1)
    (frame,) = source  # the last one is never dropped
    assert (frame.picture[0, 0, 0], frame.number, source.dropped) == (5, 0, 5)


def test_a_gap_in_time_is_a_jump_in_numbers():
    later = threading.Event()

    def pictures() -> Iterator[np.ndarray]:
        yield PICTURE
        yield PICTURE
        later.wait(10)
        yield PICTURE

    source = LiveSource("somewhere", pictures(), 20.0, 60.0, clocked=True)
    frames = iter(source)
    before = [next(frames), next(frames)]
    time.sleep(0.3)
    later.set()
    (after,) = frames
    assert [frame.number for frame in before] == [0, 1]
    assert after.number >= 6
    assert after.time_s == pytest.approx(after.number / 20, abs=0.05)


def test_a_source_that_changes_its_size_or_breaks_is_survived_and_said():
    def pictures() -> Iterator[np.ndarray]:
        yield PICTURE
        yield np.zeros((96, 64, 3), np.uint8)
        yield PICTURE
        raise OSError("the cable came off")

    source, frames = LiveSource("somewhere", pictures(), 20.0, 60.0), []
    with pytest.raises(OSError, match="came off"):
        frames += source
    found = iter(LiveSource("somewhere", pictures(), 20.0, 60.0))
    frames = [next(found) for _ in range(3)]
    assert [frame.image is None for frame in frames] == [False, True, False]
    assert "64x96 while the clip is 64x48" in frames[1].error


def test_a_source_that_stalls_can_be_stopped():
    later = threading.Event()

    def pictures() -> Iterator[np.ndarray]:
        yield PICTURE
        later.wait(60)
        yield PICTURE

    source = LiveSource("somewhere", pictures(), 20.0, 60.0)
    threading.Timer(0.2, source.stop).start()
    begun = time.monotonic()
    assert [frame.number for frame in source] == [0]
    assert time.monotonic() - begun < 10
    later.set()
    assert list(source) == []


def test_a_pipe_gives_whole_pictures():
    data = b"".join(picture.tobytes() for picture in marked(7)) + b"half"
    source = open_live("-", 60.0, (64, 48), None, io.BytesIO(data), every=3)
    frames = list(source)
    assert [frame.picture[0, 0, 0] for frame in frames] == [0, 3, 6]
    assert [frame.time_s for frame in frames] == pytest.approx([0, 0.12, 0.24])


@pytest.mark.parametrize(
    ("where", "data", "reason"),
    [
        ("-", b"", "gives no picture"),
        ("nowhere.mp4", b"", "is no file, stream or camera"),
        ("97", b"", "camera 97 can't be opened"),
    ],
)
def test_what_is_not_there_is_said(where, data, reason):
    with pytest.raises(InputError, match=reason):
        open_live(where, 1.0, (64, 48) if where == "-" else None, None, io.BytesIO(data))


def test_a_pipe_has_no_size_of_its_own():
    with pytest.raises(InputError, match="give --size"):
        open_live("-", 1.0, None, None, io.BytesIO(b""))
