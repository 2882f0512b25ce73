"""Geometry of synthetic scenes against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from palpate.data.synthetic.scene import CLEARANCE, FARTHEST_DEPTH, NEAREST_DEPTH, SceneError, draw_scene
from palpate.data.synthetic.settings import SceneSettings

SMALL = SceneSettings(width=214, height=120)


def angle_deg(first: np.ndarray, second: np.ndarray) -> float:
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    return math.degrees(math.acos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize("seed", range(5))
def test_curvature_and_waves_leave_the_contact_and_its_normal(seed: int) -> None:
    sheet = draw_scene(SMALL, np.random.default_rng(seed)).sheet
    (x, y), step = sheet.contact_ray, 1e-5

    def point(x: float, y: float) -> np.ndarray:
        return np.array([x, y, 1.0]) * sheet.depth(np.array(x), np.array(y))

    assert sheet.depth(np.array(x), np.array(y)) == pytest.approx(sheet.distance, abs=1e-12)
    normal = np.cross(point(x + step, y) - point(x - step, y), point(x, y + step) - point(x, y - step))
    assert min(angle_deg(normal, sheet.normal), angle_deg(-normal, sheet.normal)) < 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_contact_lies_on_the_organ_and_faces_the_camera(seed: int) -> None:
    scene = draw_scene(SMALL, np.random.default_rng(seed))
    position = scene.mesh.vertices[scene.vertex].astype(float)
    assert angle_deg(scene.direction, -position) < SMALL.max_tilt_deg + 1.0
    assert np.linalg.norm(scene.direction) == pytest.approx(1)
    assert not scene.mesh.rim[scene.vertex]
    row, column = scene.mesh.pixels[scene.vertex]
    assert scene.outline.level(np.array(column), np.array(row)) > 5
    tip = np.array([column, row]) + scene.exit_offset * scene.entry
    assert scene.outline.level(*tip) < -CLEARANCE + 1
    assert scene.mesh.vertices[:, 2].min() > NEAREST_DEPTH
    assert scene.mesh.vertices[:, 2].max() < FARTHEST_DEPTH


def test_tilt_is_what_was_asked_for() -> None:
    tilted = dataclasses.replace(SMALL, max_tilt_deg=15.0, curvature=(0.0, 0.0), relief=0.0)
    scenes = [draw_scene(tilted, np.random.default_rng(seed)) for seed in range(20)]
    angles = [angle_deg(scene.direction, -np.append(scene.sheet.contact_ray, 1.0)) for scene in scenes]
    assert 10 < max(angles) < 15.01


def test_a_scene_that_does_not_fit_is_refused() -> None:
    steep = dataclasses.replace(SMALL, field_of_view_deg=110.0, curvature=(1.5, 1.5), distance=(0.8, 0.8))
    with pytest.raises(SceneError, match="choose smaller"):
        draw_scene(steep, np.random.default_rng(0))


@pytest.mark.parametrize("change", [
    {"width": 32}, {"width": 100}, {"frames": 3}, {"fps": 0.0}, {"force": (0.1, 0.2)}, {"stiffness": (1.0, 0.2)},
    {"stiffness": (1e300, 1e301)}, {"stiffness": (1.0, 2e5)}, {"damping": (0.1, 11.0)}, {"depth_noise": -0.1},
    {"stiffness": (0.2, 1.0), "mass": 1e-12}, {"depth_bits": 12}, {"occlusion": 1.0}, {"field_of_view_deg": 180.0},
])  # fmt: skip
def test_impossible_settings_are_refused(change: dict) -> None:
    with pytest.raises(ValueError, match=f"scene.{next(iter(change))}"):
        dataclasses.replace(SMALL, **change)
