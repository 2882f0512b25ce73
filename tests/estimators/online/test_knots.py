"""Fields as numbers at knots: how particles share in them, and the Gauss–Newton steps that find them from wherever."""

import numpy as np
import pytest

from palpate.estimators.online.determined import CHANGE, Determined
from palpate.estimators.online.knots import KNOTS, bumps
from palpate.estimators.online.objective import Objective
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


def learner(objective: Objective, begun: Stiffness) -> Determined:
    """Every particle is a point, in hundredths of a millimetre."""
    return Determined(objective, begun, lambda values: values, lambda states: 1e5 * (states - objective.body.rest))


@pytest.mark.parametrize("name", BODIES)
def test_the_simulations_carried_along_differ_by_the_fields_slopes(name):
    """After some frames from rest under the same fields: as the adjoint of the same motion says."""
    body = BODIES[name]
    objective, places = pulled(body, 5)
    begun = fields_of(body, np.linspace(1, 3, body.count))
    newton = learner(objective, begun)
    for place in places:
        newton.step(begun, place, np.full_like(body.rest, np.nan))
    motion = objective.stepped(begun, body.rest, places)
    np.testing.assert_allclose(newton._carried[0], motion.positions[0, -1], rtol=0, atol=1e-15)
    pull = np.random.default_rng(1).normal(size=body.rest.shape)
    pulls = np.zeros_like(motion.positions)
    pulls[0, -1] = pull
    by_logs = [slope[0] * values for slope, values in zip(motion.gradient(pulls)[:2], begun[:2], strict=True)]
    for which, knots in enumerate(min(count, body.count) for count in KNOTS):
        first = which * min(KNOTS[0], body.count)
        slopes = [((newton._carried[1 + first + k] - newton._carried[0]) * pull).sum() / CHANGE for k in range(knots)]
        np.testing.assert_allclose(slopes, by_logs[which] @ bumps(body.rest, knots), rtol=0.02, atol=2e-5)


@pytest.mark.parametrize("begun", [5.0, 0.2])
def test_the_field_is_found_from_stiff_and_from_soft(begun: float):
    """Where all particles are visible as they are, and the truth is the estimator's own."""
    body, frames = sheet(9, 6, pinned_rows=1), 40
    objective, places = pulled(body, frames)
    true = np.where(body.rest[:, 1] < 0.5 * body.rest[:, 1].max(), 3.0, 1.0)
    states = objective.stepped(fields_of(body, true), body.rest, places).positions[0, 1:]
    fields = fields_of(body, begun)
    newton = learner(objective, fields)
    for place, state in zip(places, states, strict=True):
        newton.step(fields, place, 1e5 * (state - body.rest))
        fields = newton.likeliest(fields)
    for stiffness in (3.0, 1.0):
        found = fields.distance[(true == stiffness) & ~body.pinned]
        assert np.median(found) == pytest.approx(stiffness, rel=0.35)
