"""Residual, Jacobian and information of an observed motion."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from palpate.physics import Likelihood, Mechanics, Observation, Press, contact_normal, ramped
from palpate.physics.identifiability import log_jacobian
from palpate.physics.mechanics import theta_of
from palpate.physics.msd.simulation import simulate, simulate_sensitivities
from tests.physics.sheets import loose, pressed, sheet

MECHANICS = Mechanics(time_step=0.0025, scheme="dkd")
MESH = sheet(9, 9)
PRESS = Press.on_patch(MESH, 40, 2.2, contact_normal(MESH, 40), ramped(10, 30, 10, 100))
LOGS = np.log([0.5, 0.06, 0.1])
TIMES = np.array([0.04, 0.08, 0.12, 0.2])
STEPS = np.array([15, 31, 47, 79])
POINTS = np.array([39, 30, 50])
NOISE = np.array([1e-4, 2e-4, 1e-3])


def observed(logs=LOGS, noise=NOISE, points=POINTS, off=0.0) -> Observation:
    """What a motion at φ shows of some points, moved by a constant."""
    path = simulate(theta_of(logs), MESH, PRESS, MECHANICS, watch=points, dtype=np.float64)[STEPS]
    return Observation(points, TIMES, (np.swapaxes(path, 0, 1) + off).astype(np.float32), np.asarray(noise))


def test_at_the_truth_nothing_is_left_and_information_is_that_of_the_jacobian():
    logs, likelihood = LOGS, Likelihood(MESH, PRESS, observed(), MECHANICS)
    around = likelihood.linearise(logs)
    theta = likelihood.theta(logs)
    _, slopes = simulate_sensitivities(theta, MESH, PRESS, MECHANICS, watch=POINTS, dtype=np.float64)
    slopes = np.swapaxes(log_jacobian(slopes, theta)[STEPS], 0, 1)
    rows = (slopes / NOISE[:, None]).reshape(36, len(logs))
    np.testing.assert_allclose(around.residual, 0, atol=1e-4)  # single precision of what was observed
    np.testing.assert_allclose(around.jacobian, rows, rtol=1e-9, atol=1e-9 * np.abs(rows).max())
    np.testing.assert_allclose(likelihood.information(logs), rows.T @ rows, rtol=1e-9)
    weight = np.diag(np.tile(NOISE, 12) ** -2.0)  # Σ⁻¹, which differs by axis
    by_weight = slopes.reshape(36, -1).T @ weight @ slopes.reshape(36, -1)
    np.testing.assert_allclose(likelihood.information(logs), by_weight, rtol=1e-9)
    assert np.linalg.eigvalsh(likelihood.information(logs)).min() > 0.1


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_gradient_is_the_misfit_s_derivative(dtype):
    likelihood = Likelihood(MESH, PRESS, observed(off=2e-4), MECHANICS, dtype)
    logs = LOGS + 0.1
    around = likelihood.linearise(logs)
    assert around.misfit == pytest.approx(0.5 * np.square(likelihood.residual(logs)).sum())
    exact = Likelihood(MESH, PRESS, likelihood.observation, MECHANICS)
    for index in range(len(logs)):
        offset = 1e-5 * np.eye(len(logs))[index]
        central = (exact.linearise(logs + offset).misfit - exact.linearise(logs - offset).misfit) / 2e-5
        assert around.gradient[index] == pytest.approx(central, rel=1e-4 if dtype == np.float32 else 1e-7)


def test_what_was_not_seen_does_not_count():
    whole = observed(off=1e-4)
    hidden = whole.displacement.copy()
    hidden[0, 1], hidden[2, :, 2] = np.nan, np.nan
    seen = Observation(POINTS, TIMES, hidden, np.broadcast_to(NOISE, hidden.shape) * (1 + np.arange(4))[:, None])
    likelihood, kept = Likelihood(MESH, PRESS, seen, MECHANICS), np.isfinite(hidden)
    around = likelihood.linearise(LOGS + 0.05)
    assert around.residual.shape == (36 - 3 - 4,)
    full = Likelihood(MESH, PRESS, whole, MECHANICS).linearise(LOGS + 0.05)
    scale = np.broadcast_to((1 + np.arange(4))[:, None], hidden.shape)[kept]
    np.testing.assert_allclose(around.residual, full.residual[kept.ravel()] / scale, rtol=1e-12)
    np.testing.assert_allclose(around.jacobian, full.jacobian[kept.ravel()] / scale[:, None], rtol=1e-12)
    nothing = Observation(POINTS, TIMES, np.full_like(hidden, np.nan), NOISE)
    assert not Likelihood(MESH, PRESS, nothing, MECHANICS).information(LOGS).any()


def test_points_add_up_and_every_instant_is_at_the_nearest_step():
    """Information of several points is the sum of each one's, and the whole field tells most."""
    alone = sum(Likelihood(MESH, PRESS, observed(points=POINTS[[i]]), MECHANICS).information(LOGS) for i in range(3))
    together = Likelihood(MESH, PRESS, observed(), MECHANICS).information(LOGS)
    np.testing.assert_allclose(together, alone, rtol=1e-9)
    field = Likelihood(MESH, PRESS, observed(points=np.arange(81)), MECHANICS).information(LOGS)
    assert np.linalg.eigvalsh(field - together).min() > 0
    late = Observation(POINTS, TIMES + 0.4 * MECHANICS.time_step, observed().displacement, NOISE)
    np.testing.assert_array_equal(Likelihood(MESH, PRESS, late, MECHANICS).information(LOGS), together)


def test_a_chaotic_motion_tells_nothing():
    mesh = loose(sheet(21, 21))
    press = pressed(mesh, 220, 50, 200)
    seen = Observation.of_point(220, np.array([0.5, 0.9]), np.zeros((2, 3)), 1e-3)
    mechanics = Mechanics()
    wild = Likelihood(mesh, press, seen, mechanics, np.float32).linearise(np.log([5.34, 1e-6, 1.0]))
    assert not wild.jacobian.any()
    assert not wild.information.any()
    assert np.abs(wild.residual).max() > 0
    assert Likelihood(mesh, press, seen, mechanics, np.float32).jacobian(np.log([0.7, 0.05, 0.1])).any()


def test_one_likelihood_serves_several_threads():
    """What one thread remembers is not what another one gets."""
    likelihood = Likelihood(MESH, PRESS, observed(off=1e-4), MECHANICS)
    places = [LOGS + 0.02 * index for index in range(6)] * 20
    expected = [likelihood.linearise(at).misfit for at in places]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda at: likelihood.linearise(at).misfit, places)) == expected


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (Observation.of_point(40, np.array([]), np.zeros((0, 3)), 1e-3), "or none at all"),
        (Observation.of_point(40, np.array([0.0]), np.zeros((1, 3)), 1e-3), "outside the load's 100 steps"),
        (Observation.of_point(40, np.array([0.3]), np.zeros((1, 3)), 1e-3), "outside the load's 100 steps"),
        (Observation.of_point(40, np.array([0.1]), np.zeros((1, 3)), 0.0), "noise of a seen point isn't a positive"),
        (Observation.of_point(40, np.array([0.1]), np.zeros((1, 3)), np.nan), "noise of a seen point isn't a positive"),
    ],
)
def test_impossible_observations_are_refused(seen, said):
    with pytest.raises(ValueError, match=said):
        Likelihood(MESH, PRESS, seen, MECHANICS)


def test_a_point_outside_the_mesh_is_named():
    seen = Observation.of_point(81, np.array([0.1]), np.zeros((1, 3)), 1e-3)
    with pytest.raises(ValueError, match="watch names vertex 81; the mesh has 81 vertices"):
        Likelihood(MESH, PRESS, seen, MECHANICS).linearise(LOGS)
