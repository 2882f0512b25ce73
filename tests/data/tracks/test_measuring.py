"""Points measured in drawn pictures where their motion is known roughly, beside what drags windows along."""

import cv2
import numpy as np
import pytest

from palpate.data.tracks.measuring import Fine, fine, measure
from tests.data.tracks.test_following import HEIGHT, NO_TOOL, WIDTH, Motion, bulge, texture, warped

POINTS = np.stack(np.meshgrid(np.arange(24, WIDTH - 20, 8), np.arange(24, HEIGHT - 20, 8)), axis=-1).reshape(-1, 2)
STILL = np.zeros((HEIGHT, WIDTH, 2), np.float32)


def prepared(picture: np.ndarray, tool: np.ndarray = NO_TOOL) -> Fine:
    return fine(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), picture.min(axis=2), ~tool)


def unmasked(picture: np.ndarray) -> Fine:
    return Fine(prepared(picture).gray, np.ones((HEIGHT, WIDTH), np.float32))


def found(picture: np.ndarray, motion: np.ndarray = STILL, tool: np.ndarray = NO_TOOL) -> np.ndarray:
    """Motion of the points from one texture to another picture."""
    return measure(prepared(texture(), tool), prepared(picture, tool), POINTS, motion).moved


def everywhere(motion: Motion) -> np.ndarray:
    places = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)
    return np.array(motion(places.reshape(-1, 2).astype(np.float64))).reshape(places.shape).astype(np.float32)


def exactly_shifted(columns: float, rows: float) -> np.ndarray:
    """By the Fourier transform, without interpolation."""
    phase = np.fft.fftfreq(HEIGHT)[:, None] * rows + np.fft.fftfreq(WIDTH) * columns
    spectrum = np.fft.fft2(texture(), axes=(0, 1)) * np.exp(-2j * np.pi * phase)[..., None]
    return np.fft.ifft2(spectrum, axes=(0, 1)).real.round().clip(0, 255).astype(np.uint8)


def dull(picture: np.ndarray) -> np.ndarray:
    return (120 + 0.3 * (picture.astype(float) - 140)).astype(np.uint8)


def grainy(picture: np.ndarray, size: float, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=picture.shape)
    return (picture + size * noise).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("way", [(0.05, 0.0), (0.1, -0.3), (0.5, 0.5), (-0.8, 0.2)])
def test_shifts_below_a_pixel_are_found_without_bias(way: tuple[float, float]) -> None:
    off = found(exactly_shifted(*way)) - way
    assert np.abs(np.nanmean(off, axis=0)).max() < 0.01
    assert np.isfinite(off).all(axis=1).mean() > 0.95


def test_what_a_model_leaves_of_a_swelling_is_found() -> None:
    picture, true = warped(texture(), bulge(1.0)), bulge(1.0)(POINTS.astype(np.float64))
    off = found(picture, everywhere(bulge(0.9))) - true
    assert np.sqrt(np.nanmean(np.square(off))) < 0.03


@pytest.mark.parametrize("light", [0.8, 1.2])
def test_light_that_changes_moves_nothing(light: float) -> None:
    moved = found((texture() * np.float32(light)).clip(0, 255).astype(np.uint8))
    assert np.abs(np.nanmean(moved, axis=0)).max() < 0.01
    assert np.nanmax(np.abs(moved)) < 0.2


def test_an_instrument_that_stays_holds_no_window_back() -> None:
    """A striped band across the picture, in front of tissue that moves."""
    tool = np.broadcast_to(np.abs(np.arange(WIDTH) - 84) < 6, (HEIGHT, WIDTH))

    def before(picture: np.ndarray) -> np.ndarray:
        stripes = np.where(np.arange(HEIGHT)[:, None, None] % 8 < 4, 250, 60).astype(np.uint8)
        return np.where(tool[..., None], stripes, picture)

    one, other = before(texture()), before(exactly_shifted(0.0, 0.8))
    masked = measure(prepared(one, tool), prepared(other, tool), POINTS, STILL)
    beside = (np.abs(POINTS[:, 0] - 84) < 16) & np.isfinite(masked.moved).all(axis=1)
    assert beside.sum() > 10
    dragged = measure(unmasked(one), unmasked(other), POINTS[beside], STILL)
    assert np.abs(masked.moved[beside] - [0.0, 0.8]).max() < 0.15
    assert np.abs(np.nanmedian(dragged.moved[:, 1]) - 0.8) > 0.2


def test_highlights_that_stay_hold_no_window_back() -> None:
    def lit(picture: np.ndarray) -> np.ndarray:
        for column in range(12, WIDTH, 24):
            for row in range(12, HEIGHT, 24):
                cv2.circle(picture, (column, row), 4, (255, 255, 255), -1)
        return picture

    one, other = (lit(dull(picture)) for picture in (texture(), exactly_shifted(0.6, 0.0)))
    kept = measure(prepared(one), prepared(other), POINTS, STILL).moved
    assert np.isfinite(kept).all(axis=1).mean() > 0.5
    assert abs(np.nanmean(kept[:, 0]) - 0.6) < 0.03
    assert np.nanmean(measure(unmasked(one), unmasked(other), POINTS, STILL).moved[:, 0]) < 0.3


@pytest.mark.parametrize("size", [2.0, 8.0])
def test_the_noise_is_the_errors_whatever_pictures_noise_is(size: float) -> None:
    pictures = [grainy(dull(each), size, seed) for seed, each in enumerate((texture(), exactly_shifted(0.3, 0.2)))]
    moved, noise = measure(*map(prepared, pictures), POINTS, STILL)
    off = (moved - [0.3, 0.2]) / noise[:, None]
    assert 0.55 < np.sqrt(np.nanmean(np.square(off))) < 1.0


def test_a_window_of_which_less_is_seen_than_needed_is_not_found() -> None:
    """Points at a tool's edge or under it see 10 of their window's 21 columns, or 11; those a spacing away 18."""
    tool = np.broadcast_to(np.arange(WIDTH) < 88, (HEIGHT, WIDTH))
    moved = found(exactly_shifted(0.3, 0.0), tool=tool)
    assert np.isnan(moved[POINTS[:, 0] <= 88]).all()
    assert np.isfinite(moved[POINTS[:, 0] == 96]).all()


def test_windows_that_differ_more_than_others_are_not_found() -> None:
    """To the right other tissue shows through, by less than makes windows resemble each other no more."""
    through = (0.8 * dull(texture()) + 0.2 * dull(texture(seed=1))).astype(np.uint8)
    right = np.arange(WIDTH)[None, :, None] > 110
    picture = np.where(right, through, dull(texture()))
    pictures = (grainy(each, 1.0, seed) for seed, each in enumerate((dull(texture()), picture)))
    moved = measure(*map(prepared, pictures), POINTS, STILL).moved
    assert np.isnan(moved[POINTS[:, 0] > 124]).mean() > 0.9
    assert np.isfinite(moved[POINTS[:, 0] < 96]).all()
