"""The plan's picture shows the forces along both ways."""

import dataclasses

import numpy as np
import pytest

from palpate.planning.pictures import Pressed, draw_plan, force_along
from palpate.planning.roadmap import Plan
from palpate.planning.scene import read_plan_scene
from tests.planning.cases import quick_press
from tests.planning.test_scene import SHIPPED

SCENE = read_plan_scene(SHIPPED)
_, PIECE = SCENE.pieces[1]
KIND = SCENE.objects["curtain"]


def pressed(begin: float, length: float) -> Pressed:
    """1 N a metre, from `begin` on the way on."""
    curve = quick_press(KIND, SCENE.tip_radius, np.zeros(2), 0.0)
    return Pressed("curtain", PIECE, KIND.height, curve, begin, length)


def test_the_force_grows_from_the_touch_on_until_the_tissue_lets_the_tip_by() -> None:
    gone, force = force_along([pressed(0.0325, 0.02)], 0.08)
    assert (gone[0], gone[-1]) == (0, 0.08)
    assert force.max() == pytest.approx(0.02)
    assert gone[force.argmax()] == pytest.approx(0.0525)
    np.testing.assert_allclose(np.interp([0.03, 0.0425, 0.0535], gone, force), [0, 0.01, 0], atol=1e-9)
    shorter = force_along([pressed(0.0325, 0.008)], 0.08)[1]
    assert shorter.max() == pytest.approx(0.008)  # not that of the longest press simulated


def test_presses_at_one_time_add_up() -> None:
    gone, force = force_along([pressed(0.01, 0.02), pressed(0.02, 0.02)], 0.08)
    np.testing.assert_allclose(np.interp([0.025, 0.035], gone, force), [0.02, 0.015], rtol=1e-6)


def test_the_straight_way_s_force_is_drawn_where_the_planned_one_touches_nothing() -> None:
    straight = Plan(np.array([SCENE.start, SCENE.goal]), 1.0, 80.0, 8.9)
    around = dataclasses.replace(straight, places=np.array([SCENE.start, [0, 0], SCENE.goal]), deformation=0, way=94.0)
    ways = {"planned": (around, []), "shortest": (straight, [pressed(0.0325, 0.02)])}
    panel = draw_plan(SCENE, ways).axes[1]
    lines = {line.get_label(): np.array(line.get_data()) for line in panel.lines}
    assert list(lines) == ["planned: touches nothing, 0 N", "shortest: up to 0.02 N"]
    planned, shortest = lines.values()
    assert (planned[0].max(), np.abs(planned[1]).max()) == (pytest.approx(94), 0)
    assert (shortest[0].max(), shortest[1].max()) == (pytest.approx(80), pytest.approx(0.02))
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("distance along the way [mm]", "force of the tip [N]")
    assert panel.get_title() == "Force along both ways"
