"""A followed sheet: each part of the step predicts better than the step without it."""

from typing import get_args, get_type_hints

import numpy as np
import pytest
from scipy.sparse import eye_array

from palpate.estimators.online.objective import Objective, Tracks
from palpate.estimators.online.session import Adam, Method, Session
from palpate.physics.load import Grip
from palpate.physics.pbd.simulation import Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness
from tests.physics.pbd.particles import sheet

BODY = sheet(9, 6, pinned_rows=1)
GRIPPED = np.array([50, 51])
FRAMES, HORIZON, SUBSTEPS = 36, 10, 4
METHODS = get_args(get_type_hints(Method)["name"])


def path(steps: int) -> np.ndarray:
    """Displacement of the grip, shape [steps, 2, 3] [m]."""
    ramp = np.linspace(1 / steps, 1, steps)[:, None, None]
    return np.repeat(ramp * [0.004, 0.02, 0.006], 2, axis=1)


def truth() -> tuple[np.ndarray, np.ndarray]:
    """States [T, N, 3] and the true field: finer steps, more sweeps, and a half that is three times as stiff."""
    field = np.where(BODY.rest[:, 1] < 0.5 * BODY.rest[:, 1].max(), 3.0, 1.0)
    fields = Stiffness(field, np.full(BODY.count, 0.01))
    finer = Stepping(time_step=1 / SUBSTEPS, iterations=40)
    # Without velocities a step is worth k Δt²: SUBSTEPS of them flow as far as one of 1 with k times SUBSTEPS.
    flowing = Stiffness(*(SUBSTEPS * values for values in fields[:2]))
    motion = simulate(BODY, flowing, Grip(GRIPPED, path(FRAMES * SUBSTEPS)), finer)
    return motion.positions[0, SUBSTEPS::SUBSTEPS], field


START = Stiffness(np.full(BODY.count, 5.0), np.full(BODY.count, 0.01))


def seen(state: np.ndarray) -> list[Tracks]:
    """All particles as they are."""
    return [Tracks(eye_array(BODY.count).tocsr(), state)]


def follow(method: Method, states: np.ndarray) -> tuple[float, Session]:
    """Mean future gap, and the session after the last frame."""
    session, gaps = Session(Objective(BODY, GRIPPED), START, method), []
    for frame in range(FRAMES - HORIZON):
        session.step(states[frame, GRIPPED], seen(states[frame]))
        if frame % 5 == 4:
            later = states[frame + 1 : frame + 1 + HORIZON]
            for state, true in zip(session.ahead(later[:, GRIPPED]), later, strict=True):
                gaps.append(np.linalg.norm(session.objective.mapped(state, seen(true)).deformation))
    return float(np.mean(gaps)), session


def test_mapping_predicts_better_than_none_and_optimised_fields_better_still():
    states, field = truth()
    gaps, sessions = zip(*(follow(Method(name, "adam"), states) for name in METHODS), strict=True)
    assert gaps[1] < 0.9 * gaps[0]
    assert gaps[2] < 0.9 * gaps[1]
    assert (sessions[1].fields.distance == 5).all()
    found = sessions[2].fields.distance[~BODY.pinned]
    stiff = field[~BODY.pinned] > 1
    assert np.median(found[stiff]) > np.median(found[~stiff])


def test_a_frame_tells_what_was_done():
    state = truth()[0][0]
    sessions = {name: Session(Objective(BODY, GRIPPED), START, Method(name, "adam")) for name in METHODS}
    frames = {name: session.step(state[GRIPPED], seen(state)) for name, session in sessions.items()}
    assert [frames[name].gap is None for name in METHODS] == [True, False, False]
    assert [frames[name].terms is None for name in METHODS] == [True, True, False]
    moved = frames["PBD-RM"].positions - frames["PBD"].positions
    assert np.linalg.norm(moved) == pytest.approx(frames["PBD-RM"].gap)
    np.testing.assert_allclose(frames["PBD-RM-ON"].positions, frames["PBD-RM"].positions, atol=1e-15)
    assert frames["PBD-RM-ON"].gap == pytest.approx(frames["PBD-RM"].gap)
    # Adam's first step is its rate by the logit, which begins at 0: k = 10 σ(±0.1).
    changed = np.abs(frames["PBD-RM-ON"].fields.distance - 5)
    assert changed.max() == pytest.approx(10 / (1 + np.exp(-0.1)) - 5, rel=1e-3)


def test_a_frame_that_shows_nothing_is_simulated_alone():
    session, plain = (Session(Objective(BODY, GRIPPED), START, m) for m in (Method(optimizer="adam"), Method("PBD")))
    places = BODY.rest[GRIPPED] + path(4)[0]
    blind = session.step(places, [])
    assert (blind.gap, blind.terms) == (None, None)
    np.testing.assert_array_equal(blind.positions, plain.step(places, []).positions)
    assert (blind.fields.distance == 5).all()


def test_snapshots_are_four_of_the_last_twenty_frames():
    session, counts = Session(Objective(BODY, GRIPPED), START, Method("PBD-RM")), []
    for amount in 1e-6 * np.arange(25):
        session.step(BODY.rest[GRIPPED], seen(np.add(BODY.rest, [0, 0, amount])))
        counts.append(len(session._snapshots()))
    assert counts[:6] == [1, 2, 3, 4, 4, 4]
    kept = [next(i for i, past in enumerate(session._past) if past is state) for state in session._snapshots()]
    assert (len(session._past), kept) == (20, [0, 6, 13, 19])


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Method(rate=0.0), "rate is 0.0; give a positive number"),
        (lambda: Method("RM"), "name is 'RM'; give one of PBD, PBD-RM, PBD-RM-ON"),  # ty: ignore[invalid-argument-type]
    ],
)
def test_another_method_and_a_rate_out_of_range_are_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


def test_equal_slopes_make_equal_steps():
    """Both means are then the slope and its square, whatever the count."""
    adam, values = Adam(0.05, guard=0.0), np.zeros(2)
    for count in range(1, 30):
        values = adam.step(values, np.array([3.0, -0.1]))
        np.testing.assert_allclose(values, [-0.05 * count, 0.05 * count], rtol=1e-12)


def test_steps_are_those_of_the_sums():
    """The means as weighted sums over all slopes so far, instead of the recurrence."""
    slopes, adam, values = np.random.default_rng(0).normal(size=(7, 4)), Adam(), np.zeros(4)
    expected = np.zeros(4)
    for count in range(1, 8):
        values = adam.step(values, slopes[count - 1])
        back = np.arange(count)[::-1]
        mean, square = (
            (1 - decay) * (decay**back) @ slopes[:count] ** power / (1 - decay**count)
            for decay, power in ((0.9, 1), (0.999, 2))
        )
        expected -= 0.1 * mean / (np.sqrt(square) + 1e-8)
    np.testing.assert_allclose(values, expected, rtol=1e-12)
