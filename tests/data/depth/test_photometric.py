"""Depth from brightness: closed forms under a light at the camera, and robustness."""

import math

import numpy as np
import pytest

from palpate.data.depth.photometric import DARKEST, photometric_depth

HEIGHT, WIDTH = 240, 428
HALF = math.tan(math.radians(30))
COLUMNS, ROWS = np.meshgrid(
    (np.arange(WIDTH) - (WIDTH - 1) / 2) * 2 * HALF / WIDTH, (np.arange(HEIGHT) - (HEIGHT - 1) / 2) * 2 * HALF / WIDTH
)
"""Slopes x/z and y/z of every pixel's ray at a field of view of 60 degrees."""
INNER = (slice(20, -20), slice(20, -20))


def encode(linear) -> np.ndarray:
    """sRGB in [0, 1] of a linear brightness, grey, shape [H, W, 3]."""
    linear = np.clip(linear, 0, 1)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.repeat(coded[..., None], 3, axis=2).astype(np.float32)


def plane(tilt_deg: float, distance: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Depth z of a plane turned about the vertical axis and its brightness cosθ/R² under a light at the camera."""
    normal = np.array([math.sin(math.radians(tilt_deg)), 0, math.cos(math.radians(tilt_deg))])
    z = distance * normal[2] / (normal[0] * COLUMNS + normal[2])
    length = np.sqrt(COLUMNS**2 + ROWS**2 + 1)
    cosine = (normal[0] * COLUMNS + normal[2]) / length
    return z, cosine / (z * length) ** 2


def run(image: np.ndarray) -> np.ndarray:
    return photometric_depth(np.ascontiguousarray(image))


def relative_error(depth, truth) -> np.ndarray:
    """Error after the one free scale is taken out."""
    ratio = depth[INNER] / truth[INNER]
    return np.abs(ratio / np.median(ratio) - 1)


@pytest.mark.parametrize("distance", [1.1, 2.0, 4.0])
def test_a_plane_parallel_to_the_image_is_recovered_with_its_distance(distance):
    z, brightness = plane(0.0, distance)
    depth = run(encode(brightness))
    # Albedo 1 in these units, so even the scale is right.
    np.testing.assert_allclose(depth[INNER], z[INNER], rtol=0.01)


@pytest.mark.parametrize(("tilt", "allowed"), [(5.0, 0.04), (-10.0, 0.06), (20.0, 0.11)])
def test_a_tilted_plane_within_the_neglected_cosine(tilt, allowed):
    """z is off by sqrt(cosθ/cosα), the only approximation: bounded here by its largest value over the picture."""
    z, brightness = plane(tilt)
    error = relative_error(run(encode(brightness)), z)
    normal = np.array([math.sin(math.radians(tilt)), math.cos(math.radians(tilt))])
    neglected = np.sqrt((normal[0] * COLUMNS + normal[1])[INNER])
    assert error.max() == pytest.approx(np.abs(np.median(neglected) / neglected - 1).max(), abs=0.02)
    assert np.median(error) < allowed
    assert np.corrcoef(run(encode(brightness))[INNER].ravel(), z[INNER].ravel())[0, 1] > 0.98


def test_depth_changes_with_brightness_and_nothing_else():
    """Flicker is neither hidden nor amplified: 10 % more light is 1/sqrt(1.1) of the depth, in every pixel."""
    _, brightness = plane(8.0)
    first, second = run(encode(brightness)), run(encode(1.1 * brightness))
    np.testing.assert_allclose(second / first, 1.1**-0.5, rtol=1e-3)


def test_one_part_of_the_picture_does_not_change_another():
    """No normalisation by the frame: a bright tool on the left leaves the right as it was."""
    _, brightness = plane(0.0)
    with_tool = brightness.copy()
    with_tool[:, :80] = 0.9
    first, second = run(encode(brightness)), run(encode(with_tool))
    assert np.array_equal(first[:, 150:], second[:, 150:])
    assert second[:, :40].max() < 0.6 * first[:, :40].min()


def test_highlights_and_vessels_are_suppressed():
    z, brightness = plane(0.0)
    rng = np.random.default_rng(1)
    spotted = brightness.copy()
    for row, column in zip(rng.integers(30, 210, 25), rng.integers(30, 398, 25), strict=True):
        spotted[row - 2 : row + 3, column - 2 : column + 3] = 1.0
    spotted[:, 100:104] *= 0.5
    assert relative_error(run(encode(spotted)), z).max() < 0.05


def test_dark_pixels_are_invalid_and_do_not_spread():
    _, brightness = plane(0.0)
    vignetted = brightness.copy()
    vignetted[:, :60] = DARKEST / 2
    clean, depth = run(encode(brightness)), run(encode(vignetted))
    assert (depth[:, :55] == 0).all()
    assert (depth[:, 65:] > 0).all()
    # Right beside the dark part the mean runs over lit pixels only.
    np.testing.assert_allclose(depth[:, 65:], clean[:, 65:], rtol=0.03)
    assert (run(np.zeros((60, 80, 3), np.float32)) == 0).all()


@pytest.mark.parametrize("size", [(64, 100), (480, 854), (37, 51)])
def test_any_picture_size(size):
    depth = run(np.full((*size, 3), 0.5, np.float32))
    assert depth.shape == size
    assert np.isfinite(depth).all()
    # Brighter is nearer, and the picture's corner looks less far along z than its centre.
    assert depth[0, 0] < depth[size[0] // 2, size[1] // 2]
