"""Frames that wait on disk come back in order, nearly as they were, and leave nothing behind."""

from pathlib import Path

import numpy as np

from palpate.results.spool import FrameSpool, Shown
from tests.results.fields import FIELD_SEEN


def picture(index: int) -> np.ndarray:
    row, column = np.mgrid[:48, :64]
    return np.stack([2 * row + index, 2 * column, row + column], axis=-1).astype(np.uint8)


def test_frames_come_back_in_order(tmp_path: Path) -> None:
    spool, labels = FrameSpool(tmp_path), np.arange(12, dtype=np.uint8).reshape(3, 4) % 3
    for index in range(3):
        spool.add(Shown(picture(9 * index), labels, FIELD_SEEN))
    spool.add(Shown(None, None, None))
    assert len(spool) == 4
    found = list(spool.drain())
    assert len(spool) == 0
    for index, frame in enumerate(found[:3]):
        assert np.abs(frame.image.astype(int) - picture(9 * index)).max() <= 12
        np.testing.assert_array_equal(frame.labels, labels)
        np.testing.assert_array_equal(frame.field.positions, FIELD_SEEN.positions)
    assert found[3].image is None
    assert found[3].labels is None
    spool.add(Shown(picture(20), None, None))  # a drained spool takes frames again
    (frame,) = spool.drain()
    assert np.abs(frame.image.astype(int) - picture(20)).max() <= 12
    assert list(tmp_path.iterdir()) == []  # its file has no name
    spool.close()
