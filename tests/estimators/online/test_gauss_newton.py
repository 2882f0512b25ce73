"""Recursive Gauss–Newton steps: what they rest on, and the field that they find, from wherever they begin."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import eye_array

from palpate.estimators.online import session
from palpate.estimators.online.objective import Objective, Tracks, Weights
from palpate.estimators.online.session import CHANGE, DRAWN, KNOTS, GaussNewton, Method, Session, bumps, roughness
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.stiffness import Stiffness
from tests.estimators.online.test_objective import BODIES
from tests.physics.pbd.particles import sheet


def fields_of(body: Body, distance: float | np.ndarray) -> Stiffness:
    return Stiffness(np.broadcast_to(distance, body.count).astype(float), np.full(body.count, 0.01))


def pulled(body: Body, frames: int) -> tuple[Objective, np.ndarray]:
    """Its last two particles are pulled; where they are, shape [frames, 2, 3]."""
    objective = Objective(body, np.array([body.count - 1, body.count - 2]))
    way = np.linspace(1 / frames, 1, frames)[:, None, None] * [0.003, 0.012, 0.004]
    return objective, body.rest[objective.gripped] + way


def test_bumps_share_every_particle_out_and_leave_few_their_own():
    rest = sheet(9, 7).rest
    shares = bumps(rest, 5)
    np.testing.assert_allclose(shares.sum(axis=1), 1, rtol=1e-12)
    assert shares.max(axis=0).min() > 0.5  # at its knot one counts more than all others
    apart = np.linalg.norm(rest[:, None] - rest[shares.argmax(axis=0)], axis=2)
    nearest = shares[np.arange(len(rest)), apart.argmin(axis=1)]
    np.testing.assert_allclose(nearest, shares.max(axis=1), rtol=1e-12)  # the nearest knot has most
    np.testing.assert_array_equal(bumps(rest, len(rest)), np.eye(len(rest)))


def test_roughness_counts_differences_of_knots_by_how_near_they_are():
    rest = sheet(9, 7).rest
    shares = bumps(rest, 5)
    knots, values = rest[shares.argmax(axis=0)], np.random.default_rng(0).normal(size=5)
    width = np.mean([sorted(np.linalg.norm(knots - knot, axis=1))[1] for knot in knots])
    apart = [(np.linalg.norm(knots[i] - knots[j]) / width, values[i] - values[j]) for i in range(5) for j in range(i)]
    wanted = sum(np.exp(-(far**2) / 2) * change**2 for far, change in apart)
    assert values @ roughness(rest, shares) @ values == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_the_simulations_carried_along_differ_by_the_fields_slopes(name):
    """After some frames from rest under the same fields: as the adjoint of the same motion says."""
    body = BODIES[name]
    objective, places = pulled(body, 5)
    begun = fields_of(body, np.linspace(1, 3, body.count))
    newton = GaussNewton(objective, begun)
    for place in places:
        newton.carry(place)
    motion = objective.stepped(begun, body.rest, places)
    np.testing.assert_allclose(newton._carried[0], motion.positions[0, -1], rtol=0, atol=1e-15)
    pull = np.random.default_rng(1).normal(size=body.rest.shape)
    pulls = np.zeros_like(motion.positions)
    pulls[0, -1] = pull
    by_logits = objective.bounds.by_logits(begun, Stiffness(*(s[0] for s in motion.gradient(pulls)[:2]), 0.0))
    for which, knots in enumerate(min(count, body.count) for count in KNOTS):
        first = which * min(KNOTS[0], body.count)
        slopes = [((newton._carried[1 + first + k] - newton._carried[0]) * pull).sum() / CHANGE for k in range(knots)]
        np.testing.assert_allclose(slopes, by_logits[which] @ bumps(body.rest, knots), rtol=0.02, atol=2e-5)


def test_one_step_goes_to_the_minimum_of_gap_and_prior(monkeypatch: pytest.MonkeyPatch):
    """The gradient of the majorised objective there is 0, for a small residual that needs no limit of the step."""
    body = BODIES["sheet"]
    objective, places = pulled(body, 4)
    monkeypatch.setattr(session, "LONGEST", 100.0)
    newton = GaussNewton(objective, fields_of(body, 1.0))
    for place in places:
        newton.carry(place)
    before = newton._carried.copy()
    mapped = before[0] + 1e-4 * np.random.default_rng(2).normal(size=body.rest.shape)
    terms = newton.step(mapped)
    size = np.linalg.norm(mapped - before[0])
    assert terms == (pytest.approx(size / objective.edge), 0.0, 0.0)
    slopes = (before[1:] - before[0]).reshape(len(newton._knots), -1) / CHANGE
    left = (mapped - before[0]).ravel() - newton._knots @ slopes
    gradient = newton._prior @ newton._knots - slopes @ left / (objective.edge * max(size, objective.edge))
    assert np.abs(newton._knots).max() > 0
    np.testing.assert_allclose(gradient, 0, atol=1e-10)
    moved = before[0] + (newton._knots @ slopes).reshape(body.rest.shape)
    np.testing.assert_allclose(newton._carried[0], moved + DRAWN * (mapped - moved), rtol=0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("begun", [5.0, 0.2])
def test_the_field_is_found_from_stiff_and_from_soft(begun: float):
    """Where all particles are visible as they are, and the truth is the estimator's own: few, so heavy ones."""
    body, frames = sheet(9, 6, pinned_rows=1), 40
    objective, places = pulled(body, frames)
    objective = dataclasses.replace(objective, weights=Weights(gap=100.0))
    true = np.where(body.rest[:, 1] < 0.5 * body.rest[:, 1].max(), 3.0, 1.0)
    states = objective.stepped(fields_of(body, true), body.rest, places).positions[0, 1:]
    session = Session(objective, fields_of(body, begun), Method(optimizer="gauss-newton"))
    for place, state in zip(places, states, strict=True):
        session.step(place, [Tracks(eye_array(body.count).tocsr(), state)])
    for stiffness in (3.0, 1.0):
        found = session.fields.distance[(true == stiffness) & ~body.pinned]
        assert np.median(found) == pytest.approx(stiffness, rel=0.35)


def test_a_frame_that_shows_nothing_leaves_the_field_and_is_carried_on():
    body = BODIES["sheet"]
    objective, places = pulled(body, 3)
    session = Session(objective, fields_of(body, 1.0), Method(optimizer="gauss-newton"))
    told = session.step(places[0], [])
    assert (told.gap, told.terms) == (None, None)
    assert (told.fields.distance == 1).all()
    np.testing.assert_allclose(session._newton._carried[0], told.positions, rtol=0, atol=1e-15)


def test_weights_count_the_gap_and_the_smoothness():
    body = BODIES["sheet"]
    objectives = (Objective(body, np.array([3]), weights=each) for each in (Weights(), Weights(smoothness=2.0)))
    usual, heavy = (GaussNewton(objective, fields_of(body, 1.0)) for objective in objectives)
    anchor = session.ANCHOR * np.eye(len(usual._prior))
    np.testing.assert_allclose(heavy._prior - anchor, 2 * (usual._prior - anchor), atol=1e-15)
