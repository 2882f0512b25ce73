"""The plan's picture shows both ways."""

import dataclasses

import numpy as np

from palpate.planning.pictures import draw_plan
from palpate.planning.roadmap import Plan
from palpate.planning.scene import read_plan_scene
from tests.planning.test_scene import SHIPPED

SCENE = read_plan_scene(SHIPPED)


def test_both_ways_are_drawn_with_their_costs() -> None:
    straight = Plan(np.array([SCENE.start, SCENE.goal]), 1.0, 80.0, 8.9)
    around = dataclasses.replace(straight, places=np.array([SCENE.start, [0, 0], SCENE.goal]), deformation=0, way=94.0)
    (panel,) = draw_plan(SCENE, {"planned": around, "shortest": straight}).axes
    lines = {line.get_label(): np.array(line.get_data()) for line in panel.lines}
    assert list(lines) == ["planned: cost 8.9", "shortest: cost 8.9"]
    np.testing.assert_allclose(lines["planned: cost 8.9"].T, 1000 * around.places)
