"""The law of light against closed forms."""

import numpy as np
import pytest

from palpate.physics.shading import log_brightness, matt, mirrored


def plane(normal: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a plane through (0, 0, distance) along rays [9, 11], and the rays."""
    rays = np.moveaxis(np.indices((9, 11)), 0, -1)[..., ::-1] * 0.01 - [0.05, 0.04]
    rays = np.concatenate([rays, np.ones((9, 11, 1))], axis=-1)
    return distance * normal[2] / (rays @ normal), rays


@pytest.mark.parametrize("tilt", [0.0, 20.0, 70.0])
def test_a_plane_has_its_closed_form(tilt):
    normal = np.array([np.sin(np.radians(tilt)), 0, -np.cos(np.radians(tilt))])
    depth, rays = plane(normal, 0.6)
    length = depth * np.linalg.norm(rays, axis=-1)
    expected = np.log(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1) / length**2)
    np.testing.assert_allclose(sum(log_brightness(depth, rays)), expected, atol=1e-9)


def uneven(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Depth that isn't plane, and its rays."""
    depth, rays = plane(np.array([0.3, -0.2, -0.9]), 0.6)
    return depth + 0.001 * generator.normal(size=depth.shape), rays


def test_the_normal_is_that_of_points_on_the_surface():
    angle = np.arange(-8, 9)[:, None] * 0.004
    rays = np.stack([np.broadcast_to(angle.T, (17, 17)), np.broadcast_to(angle, (17, 17)), np.ones((17, 17))], axis=-1)
    # A sphere of radius 0.2 at (0.05, 0, 0.7): normals are known.
    centre = np.array([0.05, 0, 0.7])
    along, square = rays @ centre, np.square(rays).sum(axis=-1)
    depth = (along - np.sqrt(along**2 - square * (centre @ centre - 0.2**2))) / square
    points = rays * depth[..., None]
    cosine = np.einsum("ijk,ijk->ij", (centre - points) / 0.2, points / np.linalg.norm(points, axis=-1, keepdims=True))
    np.testing.assert_allclose(log_brightness(depth, rays)[0][1:-1, 1:-1], np.log(cosine)[1:-1, 1:-1], atol=1e-3)


def test_scale_of_lengths_does_not_matter():
    depth, rays = uneven(np.random.default_rng(3))
    facing, falloff = log_brightness(depth, rays)
    np.testing.assert_allclose(log_brightness(3 * depth, rays), [facing, falloff - 2 * np.log(3)], atol=1e-13)


@pytest.mark.parametrize("rough", [0.0, 0.25])
def test_rough_tissue_darkens_less_by_oren_and_nayars_law_and_a_wet_one_more(rough):
    angle = np.radians([0.0, 10.0, 40.0, 80.0])
    facing = np.log(np.cos(angle))
    np.testing.assert_allclose(matt(facing, rough), np.cos(angle) + rough * np.sin(angle) ** 2, rtol=1e-12)
    # The lobe is that of a Gaussian where it is narrow.
    narrow = np.radians([0.0, 2.0, 5.0])
    np.testing.assert_allclose(
        mirrored(np.log(np.cos(narrow)), np.log(0.05)), np.exp(-0.5 * (narrow / 0.05) ** 2), rtol=2e-3
    )
