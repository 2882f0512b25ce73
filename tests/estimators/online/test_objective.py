"""The objective's terms against their definitions, and its slopes against finite differences."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import eye_array

from palpate.estimators.online.objective import PAPER, Bounds, Chamfer, Objective, Tracks, Weights
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.simulation import Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness
from tests.physics.pbd.particles import block, sheet

BODIES = {"sheet": sheet(6, 5, pinned_rows=1), "block": block((2, 2, 1))}
WEIGHTS = Weights(gap=1.0, history=0.7, smoothness=0.5)


def setting(body: Body, kinds: str = "both"):
    """Objective, field, start, grip, matches and snapshots of a body whose last two particles are pulled."""
    random = np.random.default_rng(0)
    objective = Objective(body, np.array([body.count - 1, body.count - 2]), Stepping(iterations=8), weights=WEIGHTS)
    fields = Stiffness(random.uniform(0.5, 3, body.count), random.uniform(0.005, 0.015, body.count), 1e10)
    start, *snapshots = body.rest + 2e-4 * random.normal(size=(4, *body.rest.shape))
    places = body.rest[objective.gripped] + [0.001, 0.003, 0.002]
    share = np.clip(body.rest[:, 1:2] / body.rest[:, 1].max(), 0, 1)
    seen = body.rest + share**2 * [0.001, 0.002, 0.002]
    matches = [Chamfer(seen, np.unique(body.faces)), Tracks(eye_array(body.count).tocsr()[::3], seen[::3])]
    chosen = {"both": matches, "chamfer": matches[:1], "tracks": matches[1:]}[kinds]
    return objective, fields, start, places, chosen, snapshots


@pytest.mark.parametrize("kinds", ["both", "chamfer", "tracks"])
@pytest.mark.parametrize("name", BODIES)
def test_slopes_equal_finite_differences(name, kinds):
    """Along directions that leave the order of neighbours' stiffness as it is, where the smoothness has a slope."""
    objective, fields, *rest = setting(BODIES[name], kinds)
    *_, slopes = objective.evaluate(fields, *rest)
    random, step = np.random.default_rng(1), 1e-6
    for of in ("distance", "shape"):
        field = getattr(fields, of)
        for direction in random.normal(size=(3, len(field))) * field.mean():
            ends = ({of: field + sign * step * direction} for sign in (1, -1))
            up, down = (sum(objective.evaluate(fields._replace(**end), *rest)[2]) for end in ends)
            assert (getattr(slopes, of) * direction).sum() == pytest.approx((up - down) / (2 * step), rel=1e-4)


def test_terms_are_as_defined():
    body = BODIES["sheet"]
    objective, fields, start, places, matches, snapshots = setting(body)
    _, residual, terms, _ = objective.evaluate(fields, start, places, matches, snapshots)
    edge = np.linalg.norm(body.rest[body.edges[:, 0]] - body.rest[body.edges[:, 1]], axis=1).mean()
    assert terms.gap == pytest.approx(np.linalg.norm(residual.deformation) / edge)
    moved = 0.0
    for state in snapshots:  # one at a time, with the grip left where it was
        held = dataclasses.replace(body, pinned=body.pinned | np.isin(np.arange(body.count), objective.gripped))
        after = simulate(held, fields, 1, objective.stepping, start=state).positions[0, 1]
        moved += np.linalg.norm(after - state)
    assert terms.history == pytest.approx(0.7 * moved / edge)
    assert objective.evaluate(fields, start, places, matches, [])[2].history == 0
    one, two, three = body.faces.T
    apart = [
        np.abs(field[side] - field[other]).sum() / bound
        for field, bound in ((fields.distance, 10.0), (fields.shape, 0.02))
        for side, other in ((one, two), (one, three), (two, three))
    ]
    assert terms.smoothness == pytest.approx(0.5 * sum(apart) / (3 * len(body.faces)))


def test_values_out_of_range_are_refused():
    with pytest.raises(ValueError, match="the weight of history is -1"):
        Weights(history=-1)
    with pytest.raises(ValueError, match="elastic is nan"):
        Objective(BODIES["sheet"], np.array([3]), elastic=float("nan"))
    with pytest.raises(ValueError, match="the bound of shape is 0"):
        Bounds(shape=0.0)


FIELDS = Stiffness(np.array([0.2, 5.0, 9.9]), np.array([0.005, 0.01, 0.019]), 7.0)


def test_logits_lead_back_and_none_outside():
    logits = PAPER.logits(FIELDS)
    assert logits[:, 1] == pytest.approx([0.0, 0.0])  # both in the middle
    found = PAPER.fields(logits, 7.0)
    np.testing.assert_allclose(found[:2], FIELDS[:2], rtol=1e-12)
    assert found.volume == 7.0
    found = Bounds(4.0, 0.5).fields(np.array([[-1e4, 1e4], [-1e4, 1e4]]), 0.0)
    assert found.distance.tolist() == [0.0, 4.0]
    assert found.shape.tolist() == [0.0, 0.5]


def test_slopes_by_logits_equal_finite_differences():
    random = np.random.default_rng(0)
    slopes, direction = Stiffness(*random.normal(size=(2, 3)), 0.0), random.normal(size=(2, 3))
    logits = PAPER.logits(FIELDS)
    up, down = (PAPER.fields(logits + sign * 1e-6 * direction, 0.0) for sign in (1, -1))
    change = sum((slopes[one] * (up[one] - down[one])).sum() for one in (0, 1)) / 2e-6
    assert (PAPER.by_logits(FIELDS, slopes) * direction).sum() == pytest.approx(change, rel=1e-7)
