"""Instruments keep their numbers, and touch with their free ends."""

import cv2
import numpy as np
import pytest

from palpate.data.contact.geometry import GeometrySettings, frame_geometry
from palpate.data.contact.instruments import MISSED, InstrumentNumbers
from palpate.data.contact.tips import free_ends
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame

SIZE = (120, 214)
TEXTURE = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (480, 1200, 3)), (0, 0), 4)
TEXTURE = np.clip((TEXTURE - TEXTURE.mean()) * 6 + 120, 30, 255).astype(np.uint8)


def shaft(labels: np.ndarray, tip: tuple[int, int], entry: tuple[int, int]) -> None:
    cv2.line(labels, entry, tip, 2, 9)


def frame(number: int, *shafts: tuple[tuple[int, int], tuple[int, int]]) -> PreparedFrame:
    """Instruments with a texture of their own that moves with their tips."""
    labels, picture = np.ones(SIZE, np.uint8), TEXTURE[:120, :214].copy()
    for index, (tip, entry) in enumerate(shafts):
        own = np.zeros(SIZE, np.uint8)
        shaft(own, tip, entry)
        shown = TEXTURE[index * 150 : index * 150 + 120, 400 - tip[0] : 614 - tip[0]]
        picture[own > 0], labels[own > 0] = shown[own > 0], 2
    return PreparedFrame(
        Frame(number, number, number / 25, picture), "ok", "", np.ones(SIZE, np.float32), labels, labels
    )


def crossing(step: int) -> PreparedFrame:
    """One from the left and one from the right go towards each other, cross, and go back."""
    far = 60 + 8 * min(step, 12 - step)
    return frame(step, ((far, 50), (0, 20)), ((214 - far, 50), (213, 20)))


def test_numbers_go_from_left_to_right_and_stay_through_a_crossing():
    numbers = InstrumentNumbers()
    seen = [numbers.push(crossing(step)) for step in range(13)]
    assert cv2.connectedComponents((crossing(6).labels == 2).astype(np.uint8))[0] == 2  # one part
    for each in seen:
        assert set(np.unique(each)) == {0, 1, 2}
        assert (each[:, 5].max(), each[:, 208].max()) == (1, 2)
    np.testing.assert_array_equal(np.unique(seen[-1][:, :100]), [0, 1])


@pytest.mark.parametrize(("missing", "number"), [(MISSED, 1), (MISSED + 1, 2)])
def test_a_number_is_kept_for_half_a_second(missing, number):
    numbers, place = InstrumentNumbers(), ((90, 60), (0, 20))
    numbers.push(frame(0, place))
    for step in range(missing):
        assert not numbers.push(frame(1 + step)).any()
    assert numbers.push(frame(20, place)).max() == number


def test_contact_lies_at_the_free_end_although_the_shaft_is_nearer_to_tissue():
    labels, depth = np.ones(SIZE, np.uint8), np.full(SIZE, 0.6, np.float32)
    shaft(labels, (150, 60), (0, 60))
    columns = np.arange(SIZE[1])
    depth[labels == 2] = np.broadcast_to(0.59 - 0.0005 * columns, SIZE)[labels == 2]
    ends = free_ends(labels == 2, np.ones(SIZE, bool))
    assert (np.flatnonzero(ends.any(axis=0))[[0, -1]] == [132, 155]).all()
    camera, settings = Camera.from_focal(200.0, SIZE[1], SIZE[0]), GeometrySettings()
    anywhere, at_end = (frame_geometry(depth, labels, camera, settings, ends=each) for each in (None, ends))
    assert anywhere.pixel[0] < 20
    assert 125 < at_end.pixel[0] < 160
