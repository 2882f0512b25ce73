"""Brightness sequences: light at rest, gain taken off, noise as it is."""

from types import SimpleNamespace

import numpy as np
import pytest

from palpate.data.shading.light import FINE
from palpate.data.shading.sequence import KEPT, MARGIN, REACH, RestingLight, ShadingRecorder, change_of_light, smoothed

SHAPE = (120, 160)
SIDE = FINE * (2 * (REACH + MARGIN) + 1)


TEXTURE = np.random.default_rng(1).normal(-1, 0.3, (3, *SHAPE))
"""Three colours at rest."""


def seen(light: np.ndarray) -> SimpleNamespace:
    """A frame of a camera that stands still."""
    return SimpleNamespace(light=light, light_view=None)


def recorder(row: int = 30, column: int = 40) -> ShadingRecorder:
    return ShadingRecorder(TEXTURE, np.array([row, column]))


def test_rest_is_the_median_of_what_was_seen():
    rest = RestingLight()
    for value in (1.0, 5.0, 2.0, np.nan):
        rest.push(lambda value=value: np.full(SHAPE, value))
    assert len(rest) == 4
    np.testing.assert_allclose(rest.median(), 2.0)
    rest.clear()
    assert len(rest) == 0


@pytest.mark.parametrize("count", [1, 2, 5, KEPT])
def test_rest_is_that_of_the_frames_that_show_a_place(count):
    generator = np.random.default_rng(count)
    frames = generator.normal(size=(KEPT + 1, *SHAPE)).astype(np.float32)[:count]
    frames[generator.random(frames.shape) < 0.3] = np.nan
    rest = RestingLight()
    for frame in frames:
        rest.push(lambda frame=frame: frame)
    known = np.isfinite(frames).any(axis=0)
    np.testing.assert_array_equal(rest.median()[known], np.nanmedian(frames[:, known], axis=0))
    assert np.isnan(rest.median()[~known]).all()


def test_gain_and_a_slope_over_the_picture_are_taken_off_and_a_dent_stays():
    noise, (rows, columns) = np.random.default_rng(2).normal(0, 0.01, (3, *SHAPE)), np.indices(SHAPE) / 160
    noise *= np.array([1, 2, 3])[:, None, None]
    dent = np.zeros(SHAPE)
    dent[58:66, 76:84] = -0.5
    gains = np.array([0.2, 0.3, -0.1])[:, None, None]
    light = TEXTURE + gains - 0.1 * rows + 0.05 * columns + dent + noise
    np.testing.assert_allclose(change_of_light(light[0], TEXTURE[0]), dent + noise[0], atol=0.003)
    made = recorder()
    found = made.record(np.array([0.04]), [made.frame(seen(light))])
    first = FINE * (np.array([30, 40]) - REACH - MARGIN)
    window = np.s_[:, first[0] : first[0] + SIDE, first[1] : first[1] + SIDE]
    np.testing.assert_allclose(found.light[0] - found.rest, (dent + noise)[window], atol=0.006)
    np.testing.assert_allclose(found.noise, [0.01, 0.02, 0.03], rtol=0.1)


def test_what_lies_outside_the_picture_is_not_known():
    made = recorder(2, 3)
    found = made.record(np.array([0.04]), [made.frame(seen(TEXTURE))]).light[0]
    outside = FINE * (REACH + MARGIN - np.array([2, 3]))
    assert np.isnan(found[:, : outside[0]]).all()
    assert np.isnan(found[..., : outside[1]]).all()
    assert np.isfinite(found[:, outside[0] :, outside[1] :]).all()


def test_a_frame_that_shows_too_little_tells_no_gain():
    light = TEXTURE.copy()
    light[..., 20:] = np.nan
    assert recorder().frame(seen(light)) is None
    assert change_of_light(np.full(SHAPE, np.nan), TEXTURE[0]) is None


def test_some_frames_of_a_sequence():
    made = recorder()
    frames = [made.frame(seen(TEXTURE + gain)) for gain in (0.0, 0.1, 0.2)]
    found = made.record(np.array([0.1, 0.2, 0.3]), frames).chosen(np.array([0, 2]))
    np.testing.assert_array_equal(found.times, [0.1, 0.3])
    assert found.light.shape == (2, 3, SIDE, SIDE)


def test_means_of_changes_leave_out_what_a_mask_leaves_of_an_instrument():
    change = np.full((40, 40), -0.1)
    change[10:14, 10:14] = -2.0
    np.testing.assert_allclose(smoothed(change)[20:], -0.1, rtol=1e-5)
    assert np.nanmin(smoothed(change)) > -0.11
