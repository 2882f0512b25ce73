"""What of a photometric depth is shape: planes come out as they are, texture doesn't turn normals."""

import numpy as np
import pytest

from palpate.data.depth.shading import organ_shape
from palpate.data.source.camera import Camera, back_project

CAMERA = Camera.from_field_of_view(60, 107, 60)
EVERYWHERE = np.ones((60, 107), bool)


def photometric(normal: np.ndarray, albedo: np.ndarray | float = 1.0) -> np.ndarray:
    """What the photometric model makes of a lit plane: cos^1.5 of the ray's angle over the root of its brightness."""
    rays = back_project(np.ones((60, 107), np.float32), CAMERA)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return (rays[..., 2] ** 1.5 / np.sqrt(albedo * (rays @ normal) ** 3)).astype(np.float32)


def angles(depth: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Between a depth map's normals and a plane's [degrees], shape [58, 105]."""
    points = back_project(depth, CAMERA)
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    found = np.cross(across, down)
    lengths = np.maximum(np.linalg.norm(found, axis=-1), 1e-12)
    return np.degrees(np.arccos(np.clip(found @ normal / lengths, -1, 1)))


def tilted(degrees: float, towards: float) -> np.ndarray:
    tilt, direction = np.deg2rad([degrees, towards])
    return np.array([np.sin(tilt) * np.cos(direction), np.sin(tilt) * np.sin(direction), np.cos(tilt)])


@pytest.mark.parametrize("degrees", [0, 15, 30, 45])
@pytest.mark.parametrize("towards", [20, 200])
def test_a_tilted_plane_is_recovered(degrees, towards):
    normal = tilted(degrees, towards)
    found = organ_shape(photometric(normal), EVERYWHERE, CAMERA)
    assert angles(found, normal).max() < 1
    truth = 1 / (back_project(np.ones((60, 107), np.float32), CAMERA) @ normal)
    ratio = found / truth
    assert ratio.std() / ratio.mean() < 1e-3


def test_texture_does_not_turn_normals():
    """Stripes by a factor of two, eight pixels wide: read as distance they would turn normals by far more."""
    normal = tilted(20, 70)
    stripes = np.where(np.arange(107) // 8 % 2, 1.0, 0.5)[None, :] * np.ones((60, 1))
    raw = photometric(normal, stripes)
    found = organ_shape(raw, EVERYWHERE, CAMERA)
    assert np.median(angles(found, normal)) < 5
    assert angles(raw, normal).max() > 60


def test_what_is_no_tissue_does_not_count():
    """An instrument lies on the tissue's plane, whatever it looks like; a hole without light stays one."""
    normal = tilted(25, 0)
    raw, tissue = photometric(normal), EVERYWHERE.copy()
    tissue[20:40, :50] = False
    raw[20:40, :50] = 0.1
    raw[50:55, 70:80] = 0
    found = organ_shape(raw, tissue, CAMERA)
    assert angles(found, normal)[22:35, 5:45].max() < 2
    assert not found[50:55, 70:80].any()
    assert angles(found, normal)[10, 60] < 2
    valid = tissue & (raw > 0)
    assert np.median(found[valid] / raw[valid]) == pytest.approx(1, abs=0.02)


def test_too_little_tissue_stays_as_it_is():
    raw = photometric(tilted(10, 0))
    few = np.zeros_like(EVERYWHERE)
    few[:10, :10] = True
    assert np.array_equal(organ_shape(raw, few, CAMERA), raw)
