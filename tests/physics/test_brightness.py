"""The law of light against closed forms, and its derivatives against differences."""

import numpy as np
import pytest

from palpate.physics.brightness import log_brightness, log_brightness_slopes


def plane(normal: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of a plane through (0, 0, distance) on a grid of rays [9, 11], and the rays."""
    rays = np.moveaxis(np.indices((9, 11)), 0, -1)[..., ::-1] * 0.01 - [0.05, 0.04]
    rays = np.concatenate([rays, np.ones((9, 11, 1))], axis=-1)
    return rays * (distance * normal[2] / (rays @ normal))[..., None], rays


@pytest.mark.parametrize("tilt", [0.0, 20.0, 70.0])
def test_a_plane_has_its_closed_form(tilt):
    normal = np.array([np.sin(np.radians(tilt)), 0, -np.cos(np.radians(tilt))])
    points, rays = plane(normal, 0.6)
    length = np.linalg.norm(points, axis=-1)
    expected = np.log(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1) / length**2)
    # Central differences of a plane seen in perspective err by the square of the grid's pitch.
    np.testing.assert_allclose(sum(log_brightness(points))[1:-1, 1:-1], expected[1:-1, 1:-1], atol=2e-4)


def test_facing_tissue_loses_light_by_the_square_of_its_distance():
    (near, _), (far, _) = plane(np.array([0.0, 0, -1]), 0.5), plane(np.array([0.0, 0, -1]), 1.0)
    np.testing.assert_allclose(sum(log_brightness(near)) - sum(log_brightness(far)), np.log(4), rtol=1e-12)


def test_scale_of_lengths_and_winding_of_the_grid_do_not_matter():
    points = plane(np.array([0.3, -0.2, -0.9]), 0.6)[0] + 0.001 * np.random.default_rng(3).normal(size=(9, 11, 3))
    facing, falloff = log_brightness(points)
    np.testing.assert_allclose(log_brightness(3 * points), [facing, falloff - 2 * np.log(3)], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(log_brightness(points[:, ::-1]), [facing[:, ::-1], falloff[:, ::-1]], atol=1e-14)


def test_slopes_are_the_derivatives():
    generator = np.random.default_rng(4)
    points = plane(np.array([0.3, -0.2, -0.9]), 0.6)[0] + 0.001 * generator.normal(size=(9, 11, 3))
    slopes = generator.normal(size=(9, 11, 3, 4))
    found = log_brightness_slopes(points, slopes)
    for index in range(4):
        pairs = zip(*(log_brightness(points + step * slopes[..., index]) for step in (1e-7, -1e-7)), strict=True)
        for part, (ahead, behind) in zip(found, pairs, strict=True):
            np.testing.assert_allclose(part[..., index], (ahead - behind) / 2e-7, rtol=1e-5, atol=1e-4)
