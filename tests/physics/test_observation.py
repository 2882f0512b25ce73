"""What was observed: shapes, instants, noise by axis."""

import numpy as np
import pytest

from palpate.physics.observation import Observation

TIMES = np.array([0.1, 0.2, 0.4])


def observation(noise=(1e-3, 1e-3, 1e-2), displacement=None, times=TIMES) -> Observation:
    moved = np.arange(18, dtype=np.float32).reshape(2, 3, 3) if displacement is None else displacement
    return Observation(np.array([4, 7]), times, moved, np.asarray(noise))


def test_one_point_is_the_simplest_and_moved_points_have_another_noise():
    seen = Observation.of_point(5, [0.1, 0.2], np.ones((2, 3)), 2e-3)
    assert (len(seen), seen.vertices.tolist(), seen.displacement.shape) == (2, [5], (1, 2, 3))
    assert seen.displacement.dtype == np.float32
    np.testing.assert_array_equal(seen.noise, [2e-3] * 3)
    moved = observation().moved(np.zeros((2, 3, 3)), 5e-3)
    assert not moved.displacement.any()
    np.testing.assert_array_equal(moved.noise, [5e-3] * 3)
    np.testing.assert_array_equal(moved.times, TIMES)


def test_instants_belong_to_the_nearest_step():
    np.testing.assert_array_equal(observation().steps(0.005), [19, 39, 79])
    np.testing.assert_array_equal(observation(times=np.array([0.0024, 0.0026, 0.0075])).steps(0.005), [-1, 0, 1])


@pytest.mark.parametrize("shape", [(), (3,), (3, 1), (3, 3), (2, 1, 1), (2, 3, 3)])
def test_chosen_instants_keep_their_noise(shape):
    noise = 1e-3 * (1 + np.arange(np.prod(shape, dtype=int)).reshape(shape))
    seen = observation(noise)
    for instants in (np.array([True, False, True]), np.array([0, 2])):
        chosen = seen.chosen(instants)
        np.testing.assert_array_equal(chosen.times, [0.1, 0.4])
        np.testing.assert_array_equal(chosen.displacement, seen.displacement[:, [0, 2]])
        whole = np.broadcast_to(noise, (2, 3, 3))
        np.testing.assert_array_equal(np.broadcast_to(chosen.noise, (2, 2, 3)), whole[:, [0, 2]])
    assert seen.depth_noise == pytest.approx(np.sqrt(np.square(np.broadcast_to(noise, (2, 3, 3))[..., 2]).mean()))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            lambda: observation(displacement=np.zeros((2, 2, 3))),
            r"displacement has shape \(2, 2, 3\); give \(2, 3, 3\)",
        ),
        (lambda: observation(displacement=np.zeros((3, 3))), "displacement has shape"),
        (lambda: observation(noise=np.ones(4)), r"noise has shape \(4,\); give \[3\]"),
        (lambda: observation(noise=np.ones((5, 2, 3, 3))), r"noise has shape \(5, 2, 3, 3\)"),
        (lambda: observation(times=np.array([0.1, np.nan, 0.3])), "times holds a number that is not finite"),
    ],
)
def test_impossible_observations_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        wrong()
