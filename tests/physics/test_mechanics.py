"""Settings of the simulator: what is refused, and the stability bound."""

import numpy as np
import pytest

from palpate.physics.mechanics import Bounds, Mechanics, UnstableConfiguration, highest_frequency, require_stable
from tests.physics.sheets import sheet


def test_defaults_are_the_papers():
    mechanics = Mechanics()
    assert (mechanics.mass, mechanics.time_step, mechanics.steps, mechanics.load_steps) == (0.001, 0.005, 200, 50)
    np.testing.assert_allclose(mechanics.times[[0, -1]], [0.005, 1.0])
    bounds = Bounds()
    assert bounds.lower == (0.0, 0.0, -10.0)
    assert bounds.upper == (1.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("make", "settings", "said"),
    [
        (Mechanics, {"mass": 0.0}, "mechanics.mass is 0.0"),
        (Mechanics, {"time_step": float("nan")}, "mechanics.time_step"),
        (Mechanics, {"time_step": 1e9}, "mechanics.time_step is 1000000000.0; give a positive number up to 1"),
        (Mechanics, {"steps": 0}, "mechanics.steps is 0"),
        (Mechanics, {"steps": 20_001}, "give 1 to 20000"),
        (Mechanics, {"load_steps": 201}, "give 0 to 200"),
        (Mechanics, {"window_error": 1.0}, "mechanics.window_error is 1.0"),
        (Mechanics, {"scheme": "rk4"}, "give one of euler, dkd"),
        (Bounds, {"stiffness": (1.0, 1.0)}, "bounds.stiffness"),
        (Bounds, {"damping": (-0.1, 1.0)}, "not physical"),
        (Bounds, {"force": (0.0, float("inf"))}, "bounds.force"),
        (Bounds, {"initial": (0.5, 0.5, -11.0)}, "strictly inside"),
    ],
)
def test_impossible_settings_are_refused(make, settings, said):
    with pytest.raises(ValueError, match=said):
        make(**settings)


def test_highest_frequency_bounds_the_elastic_operator():
    mesh, stiffness, mechanics = sheet(8, 9), 0.7, Mechanics()
    operator = np.zeros((3 * len(mesh.vertices), 3 * len(mesh.vertices)))
    for first, second in mesh.springs:
        along = (mesh.vertices[second] - mesh.vertices[first]).astype(np.float64)
        along /= np.linalg.norm(along)
        row = np.zeros((len(mesh.vertices), 3))
        row[first], row[second] = -along, along
        operator += stiffness * np.outer(row, row)
    exact = np.sqrt(np.linalg.eigvalsh(operator)[-1] / mechanics.mass)
    bound = highest_frequency(mesh.springs, len(mesh.vertices), stiffness, mechanics)
    assert exact <= bound < 1.5 * exact


@pytest.mark.parametrize(("count", "exact"), [(2, 2.0), (3, 3.0)])
def test_highest_frequency_of_tiny_meshes(count, exact):
    springs = np.array([[0, 1], [1, 2], [0, 2]])[: 2 * count - 3]
    assert highest_frequency(springs, count, 1.0, Mechanics()) ** 2 * 0.001 >= exact - 1e-9
    assert highest_frequency(np.empty((0, 2), int), 1, 4.0, Mechanics()) == 0  # without springs nothing swings


def test_stable_box_passes_and_unstable_ones_say_what_to_do():
    mesh = sheet()
    require_stable(mesh.springs, len(mesh.vertices), Bounds(), Mechanics())
    with pytest.raises(UnstableConfiguration, match=r"lower the bound under 1[0-9]\.?\d* or mechanics.time_step under"):
        require_stable(mesh.springs, len(mesh.vertices), Bounds(stiffness=(0.0, 40.0)), Mechanics())


@pytest.mark.parametrize("fps", [10.0, 25.0, 29.97, 30.0, 50.0, 60.0, 240.0, 500.0])
def test_matched_steps_divide_the_frame_interval(fps: float) -> None:
    mechanics = Mechanics(time_step=0.005, steps=200, load_steps=50)
    matched = mechanics.matched(1 / fps)
    ratio = 1 / fps / matched.time_step
    assert ratio == pytest.approx(round(ratio))
    assert matched.time_step <= mechanics.time_step * (1 + 1e-9)
    assert matched.steps * matched.time_step == pytest.approx(1.0, abs=matched.time_step)
    assert (matched is mechanics) == (fps in (10.0, 25.0, 50.0))


def test_frames_too_close_to_simulate_are_refused() -> None:
    with pytest.raises(ValueError, match=r"mechanics\.steps is 10000000; give 1 to"):
        Mechanics(time_step=1.0, steps=1, load_steps=1).matched(1e-7)


def test_the_box_of_logarithms_takes_the_force_as_a_magnitude() -> None:
    box = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1)).log_box
    np.testing.assert_allclose(np.exp(box), [[0.05, 0.005, 0.01], [1.0, 0.5, 0.3]])
