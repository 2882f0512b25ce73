"""The light around a press as a least-squares problem."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.data.brightness.light import FINE
from palpate.data.brightness.sequence import BrightnessSequence
from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct import brightness_fit
from palpate.estimators.direct.brightness import OTHERS, BrightnessProblem
from palpate.estimators.direct.lit_sheet import SIDE
from palpate.estimators.direct.motion import FITTED
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.load import Press, held
from palpate.physics.mechanics import RECOMMENDED, damping_ratio
from palpate.physics.observation import Observation
from tests.estimators.direct.test_lit_sheet import lit

FRAME_S = 0.04
TIMES = FRAME_S * np.arange(1, 11)


def lit_contact(noise: float = 0.02) -> Interaction:
    """A press for five frames; some places at rest, and others in single frames, show no tissue."""
    generator, shape = np.random.default_rng(6), (FINE * SIDE, FINE * SIDE)
    rest = generator.normal(-1.5, 0.2, shape)
    light = rest + generator.normal(0, 0.02, (len(TIMES), *shape))
    rest[19:23, 15:18], light[:, 8:12, 24:30], light[3, 30:34, 18:22] = np.nan, np.nan, np.nan
    light[:, 18:24, 14:19] += 0.6  # what hides there is no tissue, and another light
    sheet = lit(rest=rest)
    load = Press.at(sheet.vertex, sheet.normal, held(0.2 / FITTED.time_step, FITTED.steps))
    nothing = Observation.of_point(sheet.vertex, TIMES, np.full((len(TIMES), 3), np.nan), np.nan)
    sequence = BrightnessSequence(TIMES, light.astype(np.float32), rest, noise)
    return Interaction(sheet.mesh, load, nothing, FITTED.time_step, brightness=sequence)


@pytest.fixture(scope="module")
def problem() -> BrightnessProblem:
    return BrightnessProblem(lit_contact(), FITTED.matched(FRAME_S), 1.5 * FRAME_S, np.zeros(2))


def start(problem: BrightnessProblem) -> np.ndarray:
    free = problem.box(RECOMMENDED.log_box).shape[1] - OTHERS - 3
    return problem.start(np.concatenate([np.log([0.6, 0.05, 0.03]), np.zeros(free)]), np.zeros(2))


def test_places_that_come_to_show_count_from_the_next_look_on(problem):
    """Else the sum of squares has steps, and optima are found at them."""
    logs = start(problem)
    problem.look(logs)
    shows = np.isfinite(problem.predicted(logs, problem.motion.quick(logs[:-OTHERS]))[0])
    harder = logs + np.array([0, 0, 2.5, *[0] * (len(logs) - 3)])  # tissue is shifted farther
    light, _ = problem.predicted(harder, problem.motion.quick(harder[:-OTHERS]))
    comes = np.isfinite(light) & ~shows & np.isfinite(problem.observed) & problem.sheet.inner.ravel()
    assert comes.any()
    assert (problem.compared(light)[1][comes] == 0).all()
    problem.look(harder)
    assert (problem.compared(light)[1][comes] > 0).all()


def test_expected_light_is_that_which_is_predicted_without_a_lag(problem):
    logs = start(problem)
    logs[-1] = 1.5
    change = problem.expected_change(logs)
    assert change.shape == problem.sequence.light.shape
    logs[-1] = 0.0
    predicted, law = problem.predicted(logs, problem.motion.quick(logs[:-OTHERS]))
    known = np.isfinite(predicted)
    expected = predicted - problem.sequence.rest.ravel()
    np.testing.assert_array_equal(change.reshape(predicted.shape)[known], expected[known])
    np.testing.assert_array_equal(change.reshape(predicted.shape)[~known], law[~known])
    assert (~known).any()
    assert np.isfinite(law).all()


def test_what_coding_makes_tissue_seem_slower_by_is_taken_off(problem, monkeypatch):
    """By the logarithm of the damping ratio, the more the less of the light's change is explained; k_s stays."""
    logs = start(problem)
    problem.look(logs)
    nothing = {f"brightness_{name}_slope": 0.0 for name in ("damping", "force")}
    found = [brightness_fit._concluded(problem, logs)]
    monkeypatch.setattr(brightness_fit, "MODEL_ERRORS", SimpleNamespace(**(vars(MODEL_ERRORS) | nothing)))
    found.append(brightness_fit._concluded(problem, logs))
    shifted = np.log(np.abs(found[0].theta / found[1].theta))
    left, ratio = (
        (1 - problem.skill) / brightness_fit.USUALLY_LEFT,
        damping_ratio(*found[1].theta[:2], problem.motion.mechanics.mass),
    )
    slopes = np.array([0.0, MODEL_ERRORS.brightness_damping_slope, MODEL_ERRORS.brightness_force_slope])
    np.testing.assert_allclose(shifted, -slopes * left**2 * np.log(ratio), rtol=1e-6)
    assert np.abs(shifted[1:]).min() > 0.01
    assert found[0].left == 1 - problem.skill


def test_a_contact_in_which_nothing_moves_stays_a_step(problem, monkeypatch):
    """As one of a single frame, whose force may have ended before it began."""
    monkeypatch.setattr(problem.motion, "coarse", lambda _: np.zeros((4, 3)))
    logs = start(problem)
    problem.look(logs)
    fitted, found = brightness_fit._patched(problem, logs, np.arange(len(TIMES)))
    assert fitted is problem
    assert found is logs
    contact = lit_contact()
    nothing = Press.at(contact.load.vertex, contact.load.direction, held(0.0, FITTED.steps))
    with pytest.raises(NoEstimate, match="too short to show in the light"):
        brightness_fit.fit_brightness(dataclasses.replace(contact, load=nothing), FRAME_S)
