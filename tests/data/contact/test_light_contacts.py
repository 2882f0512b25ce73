"""Contact by the light of tissue: dents beside an instrument, nothing beside one that hovers, and what lies between."""

from types import SimpleNamespace

import numpy as np
import pytest

from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.light_contacts import LightContacts
from palpate.data.labels import TISSUE, TOOL, UNSURE
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import SRGB
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame

GRID = (60, 80)
CAMERA = Camera(fx=70.0, fy=70.0, cx=39.5, cy=29.5, width=80, height=60)
DENT = (34, 40)
"""Row and column [grid pixels]; the instrument ends right above it."""


def prepared(
    index: int, darkness=0.0, tool=True, gain=1.0, wide: int | None = None, shift=0, along=0.5, shadow=False, end=32
) -> PreparedFrame:
    """A frame of textured tissue, an instrument that comes from above, and a dent below its tip, or a shadow.

    A wide one may come from below at a column, and the first lie so far to the right, the dent along with it by a share
    of that [grid pixels].
    """
    texture = np.exp(0.2 * np.random.default_rng(7).normal(size=GRID)).repeat(4, axis=0).repeat(4, axis=1)
    rows, columns = (np.indices((240, 320)) + 0.5) / 4 - 0.5
    dent = np.exp(-0.5 * (np.square(rows - DENT[0]) + np.square(columns - DENT[1] - along * shift)) / 2.5**2)
    colours = [1.0, 1.0, 1.0] if shadow else [0.6, 1.2, 1.2]
    light = 0.6 * gain * texture[..., None] * np.exp(-darkness * dent[..., None] * colours)
    labels = np.full((240, 320), TISSUE, np.uint8)
    if tool:
        labels[: 4 * end, 150 + 4 * shift : 174 + 4 * shift] = TOOL
    if wide is not None:
        labels[4 * 48 :, 4 * wide : 4 * wide + 60] = TOOL
    noise = np.random.default_rng(index).normal(0, 0.004, (240, 320, 1))
    picture = np.searchsorted(SRGB, np.clip(light * [0.7, 0.3, 0.2] + noise, 0, 0.97)).astype(np.uint8)
    picture[labels == TOOL] = 140
    status = "ok" if tool else "no_tool"
    frame = Frame(index, index, index / 25, picture)
    found = PreparedFrame(frame, status, "", np.full(GRID, 0.6, np.float32), labels[2::4, 2::4], labels)
    if tool:  # outlines touch; what they tell beyond that is not looked at
        found.geometry, found.contact_probability = SimpleNamespace(), 0.7
    return found


def decided(frames: list[PreparedFrame]) -> list[PreparedFrame]:
    contacts = LightContacts(CAMERA, GeometrySettings(height=60, width=80))
    found = [each for frame in frames for each in contacts.push(frame)]
    return found + contacts.finish()


def pressed_in(frames: list[PreparedFrame]) -> list[int]:
    """Indices of the frames in which something presses."""
    found = decided(frames)
    assert [frame.frame.index for frame in found] == list(range(len(frames)))
    return [frame.frame.index for frame in found if frame.press is not None]


def test_a_dent_is_a_press_where_it_is_and_as_long_as_it_lasts():
    darkness = [0.0] * 8 + [0.1, 0.3, 0.4, 0.4, 0.4] + [0.02, 0.0, 0.0]
    frames = decided([prepared(index, dark, tool=4 <= index < 13) for index, dark in enumerate(darkness)])
    assert [frame.frame.index for frame in frames] == list(range(16))
    pressed = [frame.frame.index for frame in frames if frame.press is not None]
    # The last frame without a dent may be the first of the press, and the instrument was there four frames before.
    assert pressed[-1] == 12
    assert 4 <= pressed[0] <= 8
    assert pressed == list(range(pressed[0], 13))
    u, v = frames[10].press
    assert abs(u - DENT[1]) <= 1
    assert 0 <= v - DENT[0] <= 2  # the instrument hides its upper half
    assert frames[10].contact_probability > 0.9
    assert [frame.status for frame in frames[13:]] == ["no_tool"] * 3


@pytest.mark.parametrize("gain", [1.0, 0.7, 1.3])
def test_an_instrument_beside_tissue_that_stays_as_bright_does_not_touch(gain):
    """Whatever the exposure does."""
    frames = decided([prepared(index, tool=index >= 4, gain=gain if index >= 6 else 1.0) for index in range(14)])
    # The light at rest is known from the eighth frame on.
    assert [frame.status for frame in frames[8:]] == ["no_contact"] * 6
    assert "the colour that it has at rest" in frames[8].detail
    assert not any(frame.press for frame in frames)


def test_motion_that_is_sure_of_contact_keeps_its_word():
    frames = [prepared(index, tool=index >= 4) for index in range(14)]
    for frame in frames[8:]:
        frame.contact_probability = 0.99
    assert [frame.status for frame in decided(frames)[8:]] == ["ok"] * 6


@pytest.mark.parametrize(("darkness", "count"), [(0.4, 3), (0.0, 14)], ids=["no view of rest", "there all along"])
def test_where_light_tells_nothing_it_stays_what_outlines_say(darkness, count):
    """An instrument that was there all along may press all along."""
    assert [frame.status for frame in decided([prepared(index, darkness) for index in range(count)])] == ["ok"] * count


def test_a_gap_forgets_the_press():
    frames = [prepared(index, 0.4 if index >= 8 else 0.0, tool=index >= 4) for index in range(12)]
    blind = PreparedFrame(frames[0].frame, "unreadable", "", np.zeros(GRID, np.float32), np.zeros(GRID, np.uint8))
    found = decided([*frames, blind, *[prepared(index, 0.4) for index in range(13, 16)]])
    assert found[11].press is not None
    assert all(frame.press is None for frame in found[12:])


def test_a_press_under_the_instrument_is_told_by_what_it_leaves_behind():
    """The instrument covers the dent while it presses, and the dent recovers slowly when it has gone."""
    darkness = [0.0] * 8 + [0.0] * 6 + [0.4, 0.3, 0.2, 0.1, 0.05, 0.0]
    frames = decided([prepared(index, dark, tool=8 <= index < 14, end=40) for index, dark in enumerate(darkness)])
    assert [frame.frame.index for frame in frames] == list(range(20))
    assert [frame.frame.index for frame in frames if frame.press is not None] == list(range(8, 14))
    assert np.abs(np.subtract(frames[10].press, DENT[::-1])).max() <= 1
    assert [frame.status for frame in frames[14:]] == ["no_tool"] * 6


def test_a_press_ends_where_the_instrument_that_hides_it_begins_to_leave():
    frames = [prepared(index, tool=8 <= index < 14, end=40) for index in range(14)]
    frames += [prepared(14, 0.02, shift=2, along=0.0, end=40), prepared(15, 0.02, shift=4, along=0.0, end=40)]
    frames += [prepared(index, dark, tool=False) for index, dark in enumerate([0.4, 0.3, 0.2, 0.1, 0.0], 16)]
    assert pressed_in(frames) == list(range(8, 14))


def test_an_instrument_that_goes_along_with_the_dent_of_oblique_tissue_still_presses():
    """It moves by a grid pixel a frame."""
    frames = [prepared(index, tool=False) for index in range(22)]
    for index in range(8, 18):
        went = min(index, 11) - 8
        frames[index] = prepared(index, [0.02, 0.3, 0.5, 0.7][went], shift=went)
    pressed = pressed_in(frames)
    assert pressed == list(range(pressed[0], 18))
    assert 8 <= pressed[0] <= 11


@pytest.mark.parametrize("wide", [None, 10], ids=["alone", "while a wider instrument stands"])
def test_a_shadow_that_comes_with_the_instrument_is_no_press(wide):
    """It is as dark while the instrument moves as when it stands."""
    frames = []
    for index in range(16):
        frame = prepared(index, 0.0 if index < 6 else 0.3, tool=index >= 6, wide=wide, shadow=True)
        if 6 <= index < 10:  # the instrument comes from the right
            shift, upper = 4 * 4 * (10 - index), np.s_[: 4 * 45]
            frame.frame.picture[upper] = np.roll(frame.frame.picture[upper], shift, axis=1)
            frame.picture_labels[upper] = np.roll(frame.picture_labels[upper], shift, axis=1)
            frame.labels = frame.picture_labels[2::4, 2::4]
        frames.append(frame)
    assert not pressed_in(frames)


def test_a_press_goes_on_while_its_instrument_hides_all_but_the_dent_s_rim():
    """Its mask may do so in frames in which it stands still."""
    darkness = [0.0] * 8 + [0.4, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6]
    frames = [prepared(index, dark, tool=index >= 4) for index, dark in enumerate(darkness)]
    rows, columns = (np.indices((240, 320)) + 0.5) / 4 - 0.5
    for frame in frames[11:13]:
        frame.picture_labels[np.hypot(rows - DENT[0], columns - DENT[1]) < 3.4] = TOOL
    found = pressed_in(frames)
    assert found[-1] == 14
    assert found == list(range(found[0], 15))


@pytest.mark.parametrize("marked", [False, True])
def test_the_part_of_an_instrument_that_its_mask_leaves_out_is_no_dent(marked):
    """Neither what is darker than tissue can be, nor what the mask is unsure of, however dark."""
    frames = [prepared(index, tool=index >= 8) for index in range(18)]
    for frame in frames[11:]:
        frame.frame.image[4 * 32 : 4 * 37, 150:174] = [140, 100, 80] if marked else [60, 35, 28]
        if marked:
            frame.picture_labels[4 * 32 : 4 * 37, 150:174] = UNSURE
    assert pressed_in(frames) == []
