"""A camera that turns: where points come to lie, and how far away they are."""

import numpy as np
import pytest

from palpate.data.source.camera import back_project
from palpate.data.synthetic.scene import draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.turning import CameraTurning


def test_points_keep_their_distance_and_come_to_lie_where_the_rotation_says():
    scene = draw_scene(SceneSettings(width=428, height=240, turning_deg=3.0), np.random.default_rng(2))
    turning, camera = CameraTurning(scene, np.random.default_rng(4)), scene.camera
    assert turning.rotation(0) == pytest.approx(np.eye(3))
    rows, columns = np.mgrid[:240, :428]
    depth = scene.sheet.depth((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy).astype(np.float32)
    labels = np.where(columns < 214, 1, 2).astype(np.uint8)
    image = np.repeat(labels[..., None] * 50, 3, axis=-1)
    shown, named, along = turning.turned(12, image, labels, depth)
    assert np.abs(shown.astype(int) - named[..., None] * 50).mean() < 1
    before, after = back_project(depth, camera), back_project(along, camera)
    turn = turning.rotation(12)
    for row, column in ((60, 100), (180, 300), (120, 250)):
        point = turn @ before[row, column]
        u, v = point[:2] / point[2] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        assert np.hypot(u - column, v - row) > 2
        found = after[round(v), round(u)]
        assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(point), rel=0.005)
        assert named[round(v), round(u)] == labels[row, column]
