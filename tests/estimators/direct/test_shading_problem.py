"""The light around a press as a least-squares problem."""

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.data.shading.light import FINE
from palpate.data.shading.sequence import ShadingSequence
from palpate.estimators.direct import shading_fit
from palpate.estimators.direct.motion import FITTED
from palpate.estimators.direct.shading_fit import shading_problem
from palpate.estimators.estimate import NoEstimate
from palpate.observations.base import JointLikelihood
from palpate.observations.lit_sheet import SIDE
from palpate.observations.shading import OTHERS, coded, without_amplitude
from palpate.physics.load import Press, held
from palpate.physics.mechanics import RECOMMENDED
from palpate.physics.observation import Observation
from tests.observations.test_lit_sheet import lit

FRAME_S = 0.04
TIMES = FRAME_S * np.arange(1, 11)


def lit_contact(noise: float = 0.02) -> Interaction:
    """A press for five frames; some places at rest, and others in single frames, show no tissue."""
    generator, shape = np.random.default_rng(6), (3, FINE * SIDE, FINE * SIDE)
    rest = generator.normal(-1.5, 0.2, shape)
    light = rest + generator.normal(0, 0.02, (len(TIMES), *shape))
    rest[:, 19:23, 15:18], light[..., 8:12, 24:30], light[3, :, 30:34, 18:22] = np.nan, np.nan, np.nan
    light[..., 18:24, 14:19] += 0.6  # what hides there is no tissue, and another light
    sheet = lit(rest=rest)
    load = Press.at(sheet.vertex, sheet.normal, held(0.2 / FITTED.time_step, FITTED.steps))
    nothing = Observation.of_point(sheet.vertex, TIMES, np.full((len(TIMES), 3), np.nan), np.nan)
    sequence = ShadingSequence(TIMES, light.astype(np.float32), rest, np.full(3, noise))
    return Interaction(sheet.mesh, load, {"point": nothing, "shading": sequence}, FITTED.time_step)


@pytest.fixture(scope="module")
def problem() -> JointLikelihood:
    return shading_problem(lit_contact(), FITTED.matched(FRAME_S), 1.5 * FRAME_S, np.zeros(2))


def start(problem: JointLikelihood) -> np.ndarray:
    free = problem.box(RECOMMENDED.log_box).shape[1] - OTHERS - 3
    return problem.started(np.concatenate([np.log([0.6, 0.05, 0.03]), np.zeros(free)]))


def predicted(problem: JointLikelihood, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light, and the law's part of it."""
    return problem.first.predicted(logs, problem.motion.quick(problem.press(logs)))


def test_places_that_come_to_show_count_from_the_next_look_on(problem):
    """Else the sum of squares has steps, and optima are found at them."""
    logs, shading = start(problem), problem.first
    problem.look(logs)
    shows = np.isfinite(predicted(problem, logs)[0])
    harder = logs + np.array([0, 0, 2.5, *[0] * (len(logs) - 3)])  # tissue is shifted farther
    light, _ = predicted(problem, harder)
    comes = np.isfinite(light) & ~shows & np.isfinite(shading.observed)
    assert comes.any()
    assert (shading.compared(light)[1][comes] == 0).all()
    problem.look(harder)
    assert (shading.compared(light)[1][comes] > 0).all()


def test_derivatives_by_the_press_and_by_the_law(problem):
    logs = start(problem)
    logs[-1] = 0.0  # without a lag
    light, slopes = problem.first.tangent(*problem.motion.at(problem.press(logs)), logs)
    expected, law = predicted(problem, logs)
    known = np.isfinite(light)
    np.testing.assert_allclose(light[known], expected[known], atol=1e-3)
    np.testing.assert_allclose(slopes[..., -4][known], law[known], atol=2e-3)  # by the response's logarithm
    step = 1e-3 * np.eye(len(logs))[0]
    ahead, behind = (predicted(problem, each)[0][known] for each in (logs + step, logs - step))
    numeric = (ahead - behind) / 2e-3
    assert np.linalg.norm(slopes[..., 0][known] - numeric) < 0.05 * np.linalg.norm(numeric)


def test_coded_light_stays_until_it_is_more_than_the_lag_off():
    """The backlash of a coder, place by place; what is seen anew is coded anew."""
    light = np.array([[0.1, 0.1], [0.35, 0.35], [0.5, np.nan], [0.45, 0.4], [0.2, 0.2]])
    followed = np.array([[True, True], [True, True], [True, False], [True, False], [True, True]])
    found = coded(light, np.zeros(2), np.array([0.15, 0.15]), followed)
    np.testing.assert_allclose(found, [[0, 0], [0.2, 0.2], [0.35, np.nan], [0.35, 0.4], [0.35, 0.35]])
    np.testing.assert_array_equal(coded(light, np.zeros(2), np.zeros(2), followed), light)


def test_marginalised_amplitude_is_the_inverse_of_the_whole_covariance():
    generator = np.random.default_rng(3)
    white, along = generator.normal(size=(6, 4, 2)), generator.normal(size=(6, 4, 1))
    found = without_amplitude(white, along)
    for place in range(4):
        covariance = np.eye(6) + along[:, place] @ along[:, place].T
        expected = white[:, place].T @ np.linalg.solve(covariance, white[:, place])
        np.testing.assert_allclose(found[:, place].T @ found[:, place], expected, rtol=1e-10)


def test_a_contact_in_which_nothing_moves_stays_a_step(problem, monkeypatch):
    """So does one of a single frame, whose force may have ended before it began."""
    monkeypatch.setattr(problem.motion, "coarse", lambda _: np.zeros((4, 3)))
    logs = start(problem)
    problem.look(logs)
    fitted, found = shading_fit._patched(problem, logs, np.arange(len(TIMES)))
    assert fitted is problem
    assert found is logs
    contact = lit_contact()
    nothing = Press.at(contact.load.vertex, contact.load.direction, held(0.0, FITTED.steps))
    with pytest.raises(NoEstimate, match="too short to show in the light"):
        shading_fit.fit_shading(dataclasses.replace(contact, load=nothing), FRAME_S)
