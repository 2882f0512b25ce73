"""Direct fits recover what made the motion, and say how well they can know it."""

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import trusted_information
from palpate.estimators.direct.estimator import DirectEstimator, DirectSettings
from palpate.estimators.direct.problem import Optimum, combine
from palpate.estimators.estimate import NoEstimate, PressCourse
from palpate.estimators.onset import STAMP
from palpate.physics.depth import DepthSequence, SequenceNoise
from palpate.physics.load import Press, PressShape, held
from palpate.physics.mechanics import Bounds, Mechanics
from palpate.physics.mesh import Mesh, contact_normal
from palpate.physics.msd.simulation import simulate
from palpate.physics.observation import Observation
from tests.estimators.estimates import ESTIMATE
from tests.estimators.sessions import clip_info
from tests.physics.sheets import sheet

MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd")
STEPS = 16 * np.arange(1, 16) - 1
"""Frames at 25 Hz for 0.6 s."""
LOAD = 128
VERTEX = 4 * 9 + 4


def facing_sheet() -> tuple[Mesh, np.ndarray]:
    """A sheet that lies so that its normal at the contact is the line of sight, and that normal."""
    mesh = sheet(9, 9)
    normal = contact_normal(mesh, VERTEX)
    vertices = (mesh.vertices - mesh.vertices[VERTEX] - 0.5 * normal).astype(np.float32)
    return dataclasses.replace(mesh, vertices=vertices), normal


MESH, DIRECTION = facing_sheet()
NOISE = 2e-4
NARROW = Bounds((0.1, 0.5), (0.01, 0.15), (-0.1, -0.02), initial=(0.3, 0.05, -0.05))
REGIMES = {"under-damped": (0.4, 0.015, -0.05), "critical": (0.3, 0.035, -0.05), "over-damped": (0.2, 0.06, -0.06)}


def contact_of(
    theta: tuple[float, float, float], noise: float = NOISE, seed: int | None = None, delays: tuple[int, int] = (0, 0)
) -> Interaction:
    """A contact that moved as the simulator says, with noise where there is a seed.

    Its load began, and ended, `delays` steps later than it says.
    """
    began, ended = delays
    press = Press.at(VERTEX, DIRECTION, held(LOAD + ended - began, int(STEPS.max()) + 1 + max(-began, 0)))
    moved = simulate(np.array(theta), MESH, press, MECHANICS, dtype=np.float64)
    path = np.where((began <= STEPS)[:, None], moved[np.maximum(STEPS - began, 0)], 0)
    if seed is not None:
        path = path + np.random.default_rng(seed).normal(0, noise, path.shape)
    times = MECHANICS.time_step * (STEPS + 1)
    press = Press.at(VERTEX, DIRECTION.astype(np.float32), held(LOAD, MECHANICS.steps))
    return Interaction(MESH, press, {"point": Observation.of_point(VERTEX, times, path, noise)}, MECHANICS.time_step)


def test_most_draws_must_agree_that_a_contact_determines_its_parameters() -> None:
    """Two thirds: seven of ten."""
    draws = [scale * np.diag([100.0, 200.0, 300.0]) for scale in (1, 2, 3, 4, 5, 6, 7, 8, 9, 10)]
    np.testing.assert_array_equal(trusted_information(draws[::-1]), draws[3])
    np.testing.assert_array_equal(trusted_information(draws[:1]), draws[0])


def test_without_a_sequence_there_is_no_estimate_and_it_says_why() -> None:
    session, contact = DirectEstimator(DirectSettings(onset=STAMP)).start(clip_info()), contact_of(REGIMES["critical"])
    with pytest.raises(NoEstimate, match="noise isn't known; set --smoothing"):
        session.fit(contact)
    few = DepthSequence(np.array([0.04, 0.08]), np.zeros((2, 15, 15)), SequenceNoise(NOISE, 0.0), (214, 120))
    with pytest.raises(NoEstimate, match="followed over 2 frames after its onset; 3 are needed"):
        session.fit(contact.having(depth=few))


def test_of_tissue_that_is_hidden_all_the_time_the_depth_around_counts() -> None:
    contact = contact_of(REGIMES["critical"])
    assert contact.unhidden() is contact
    around = DepthSequence(np.array([0.04, 0.08, 0.2]), np.zeros((3, 15, 15)), SequenceNoise(NOISE, 0.0), (214, 120))
    hidden = contact.observed(np.zeros(len(contact.observation), bool))
    assert hidden.unhidden() is hidden
    found = hidden.having(depth=around).unhidden()
    np.testing.assert_array_equal(found.observation.times, around.times)
    assert np.isnan(found.along).all()
    assert (found.noise, found.steps) == (contact.noise, round(0.2 / found.time_step))
    assert DirectEstimator(DirectSettings()).start(clip_info()).needs_point is False


@pytest.mark.parametrize("shape", [None, PressShape(2.0)])
def test_reported_intervals_hold_what_the_model_gets_wrong(
    monkeypatch: pytest.MonkeyPatch, shape: PressShape | None
) -> None:
    session = DirectEstimator(DirectSettings(onset=STAMP)).start(clip_info())
    fitted = dataclasses.replace(ESTIMATE, course=PressCourse(shape=shape))
    monkeypatch.setattr(session, "fit", lambda _: (fitted, (np.zeros(2), np.zeros(2))))
    found, _, _ = session._whole(contact_of(REGIMES["critical"]))
    # 0.1 of k_d/k_s and of F/k_s, 0.1 common; 0.35 of F where the patch that the instrument hides was fitted.
    expected = 0.01 * np.array([[1, 1, 1], [1, 2, 1], [1, 1, 2]])
    expected[2, 2] += 0.0 if shape is None else 0.35**2
    np.testing.assert_allclose(found.covariance - fitted.covariance, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (0.0, "noise is 0.0; give 3e-05 or more"),
        (2.9e-5, r"noise is 2.9e-05; give 3e-05 or more"),
        (float("inf"), "noise is inf"),
    ],
)
def test_impossible_settings_are_refused(wrong: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DirectSettings(noise=wrong)


def test_optima_are_weighed_by_their_evidence() -> None:
    """Two equally good fits, one eight times as wide in every direction: 512 times as much φ explains the data."""
    narrow = Optimum(np.array([0.0, 0.0, 0.0]), 5.0, 6400 * np.eye(3))
    wide = Optimum(np.array([1.0, 0.0, 0.0]), 5.0, 100 * np.eye(3))
    mean, spread, likeliest = combine([narrow, wide], np.zeros((3, 3)))
    share = 512 / 513
    np.testing.assert_allclose(mean, [share, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(spread[0, 0], share / 100 + (1 - share) / 6400 + share * (1 - share), rtol=1e-6)
    assert likeliest is wide
    mean, spread, likeliest = combine([narrow, wide._replace(cost=30.0)], np.zeros((3, 3)))  # e⁻²⁵·512 is nothing
    np.testing.assert_array_equal(mean, narrow.logs)
    np.testing.assert_allclose(spread, np.eye(3) / 6400)
    assert likeliest is narrow
