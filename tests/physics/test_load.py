"""Presses and grips: what they hold, and what is refused."""

import numpy as np
import pytest

from palpate.physics.load import Grip, Press, PressShape, held, ramped
from tests.physics.sheets import sheet

Z = np.array([0.0, 0.0, -1.0])
PAIR = np.array([3, 4])


def press(vertices=PAIR, weights=(0.5, 0.5), direction=Z, factor=(1.0, 1.0)) -> Press:
    return Press(np.asarray(vertices), np.asarray(weights), np.asarray(direction), np.asarray(factor))


def grip(vertices=PAIR, displacement=None) -> Grip:
    return Grip(np.asarray(vertices), np.zeros((5, 2, 3)) if displacement is None else displacement)


def test_a_patch_spreads_the_force_over_the_pixels_within_its_radius():
    mesh = sheet(15, 15)
    load = Press.on_patch(mesh, 7 * 15 + 7, 5.0, Z, np.ones(4))
    apart = np.linalg.norm(mesh.pixels[load.vertices] - [7, 7], axis=1)
    assert load.vertex == load.vertices[0] == 7 * 15 + 7
    assert len(load.vertices) == 69  # pixels of a disc of radius below 5
    np.testing.assert_allclose(load.weights, (1 - (apart / 5) ** 2) / (1 - (apart / 5) ** 2).sum(), rtol=1e-12)
    assert load.weights.sum() == pytest.approx(1, abs=1e-12)
    assert (np.diff(apart) >= 0).all()
    np.testing.assert_array_equal(Press.on_patch(mesh, 30, 0.1, Z, np.ones(4)).vertices, [30])


def test_a_press_on_one_vertex_carries_all_of_the_force_and_a_grip_moves_all_of_its_own():
    load = Press.at(9, [0, 0, -1], [1, 1, 0])
    assert (load.vertex, load.steps, load.weights.tolist()) == (9, 3, [1.0])
    np.testing.assert_array_equal(load.until(2).factor, [1, 1])
    path = np.arange(30.0).reshape(5, 2, 3)
    load = grip(displacement=path)
    assert (load.vertex, load.steps) == (3, 5)
    np.testing.assert_array_equal(load.until(2).displacement, path[:2])


def test_held_loads_share_their_last_step_and_ramps_count_with_their_mean_over_each():
    np.testing.assert_allclose(held(2.25, 5), [1, 1, 0.25, 0, 0])
    np.testing.assert_allclose(held(0, 2), [0, 0])
    np.testing.assert_allclose(held(9, 3), [1, 1, 1])
    np.testing.assert_allclose(ramped(2, 1, 4, 9), [0.25, 0.75, 1, 0.875, 0.625, 0.375, 0.125, 0, 0])
    np.testing.assert_allclose(ramped(0, 2, 0, 4), held(2, 4))
    np.testing.assert_allclose(ramped(0, 2.25, 0, 5), held(2.25, 5))
    np.testing.assert_allclose(ramped(0, np.inf, 3, 5), np.ones(5))


@pytest.mark.parametrize(("rise", "hold", "fall"), [(1.3, 2.4, 3.1), (0.4, 0.2, 0.3), (4.5, -2.0, 5.5)])
def test_a_ramp_between_steps_is_the_mean_of_many_values(rise: float, hold: float, fall: float):
    middles = (np.arange(100_000) + 0.5) / 10_000
    fine = np.clip(middles / rise, 0, 1) - np.clip((middles - rise - hold) / fall, 0, 1)
    np.testing.assert_allclose(ramped(rise, hold, fall, 10), fine.reshape(10, -1).mean(axis=1), atol=1e-6)


def test_a_patch_beside_a_vertex_and_one_between_vertices():
    mesh = sheet(15, 15)
    middle = 7 * 15 + 7
    beside = Press.on_patch(mesh, middle, 2.0, Z, np.ones(4), (0.0, 0.5))
    np.testing.assert_allclose(beside.weights[:2], beside.weights[0])
    np.testing.assert_array_equal(np.sort(beside.vertices[:2]), [middle, middle + 1])
    assert beside.weights @ mesh.pixels[beside.vertices] == pytest.approx([7.0, 7.5])
    np.testing.assert_array_equal(Press.on_patch(mesh, middle, 0.3, Z, np.ones(4), (0.4, 0.0)).vertices, [middle])


def test_a_shape_is_a_step_on_a_vertex_or_holds_its_patch_its_course_and_its_lean():
    mesh = sheet(9, 9)
    load = PressShape().press(mesh, 40, Z, 0.0225, 0.01, 5)
    assert load.vertices.tolist() == [40]
    np.testing.assert_allclose(load.factor, held(2.25, 5))
    np.testing.assert_allclose(load.direction, Z)
    shape = PressShape(2.5, (1.0, 0.0), 0.02, 0.03, (0.3, 0.4))
    load = shape.press(mesh, 40, Z, 0.1, 0.01, 12)
    np.testing.assert_allclose(load.factor, ramped(2, 5, 3, 12))
    assert load.weights @ mesh.pixels[load.vertices] == pytest.approx([5.0, 4.0])
    # x is the picture's right, y its lower side, and the camera looks along z.
    np.testing.assert_allclose(load.direction, np.array([0.3, 0.4, -1]) / np.sqrt(1.25), rtol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: press(vertices=5), r"vertices has shape \(\)"),
        (lambda: press(vertices=[[3, 4]]), r"vertices has shape \(1, 2\)"),
        (lambda: press(vertices=[], weights=[]), r"vertices has shape \(0,\)"),
        (lambda: press(vertices=[3.5, 4.0]), "vertices are of type float64; give indices"),
        (lambda: press(vertices=[True, False]), "vertices are of type bool"),
        (lambda: press(weights=[1.0]), r"weights has shape \(1,\); give \(2,\)"),
        (lambda: press(weights=[0.5, 0.6]), "weights add up to 1.1; give shares of one force"),
        (lambda: press(weights=[0.5, np.nan]), "weights holds a number that is not finite"),
        (lambda: press(direction=[0, 1]), r"direction has shape \(2,\); give \(3,\)"),
        (lambda: press(direction=[0, 1, np.inf]), "direction holds a number that is not finite"),
        (lambda: press(factor=[[1.0, 1.0]]), r"factor has shape \(1, 2\)"),
        (lambda: press(factor=[]), r"factor has shape \(0,\)"),
        (lambda: press(factor=[1.0, np.nan]), "factor holds a number that is not finite"),
        (lambda: press().until(0), r"factor has shape \(0,\)"),
        (lambda: Press.on_patch(sheet(4, 4), 5, 0.0, Z, np.ones(3)), "radius is 0.0; give a positive number"),
        (lambda: Press.on_patch(sheet(4, 4), 5, np.nan, Z, np.ones(3)), "radius is nan"),
        (lambda: grip(vertices=[], displacement=np.zeros((5, 0, 3))), r"vertices has shape \(0,\)"),
        (lambda: grip(vertices=[3, 3]), "vertices names one twice"),
        (lambda: grip(vertices=[3.0, 4.0]), "vertices are of type float64"),
        (lambda: grip(displacement=np.zeros((5, 3, 3))), r"displacement has shape \(5, 3, 3\); give \(5, 2, 3\)"),
        (lambda: grip(displacement=np.zeros((0, 2, 3))), r"displacement has shape \(0, 2, 3\)"),
        (lambda: grip(displacement=np.float64(3)), r"displacement has shape \(\)"),
        (lambda: grip(displacement=np.full((5, 2, 3), np.nan)), "displacement holds a number that is not finite"),
    ],
)
def test_impossible_loads_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        wrong()
