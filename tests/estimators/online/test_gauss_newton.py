"""Gauss–Newton steps: where Adam goes, in fewer steps; what they rest on against finite differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from estimators.online.adam import Adam
from estimators.online.gauss_newton import GaussNewton, bumps
from estimators.online.mapping import Mapping
from estimators.online.objective import Objective, Weights
from physics.pbd.simulation import Stepping
from physics.pbd.stiffness import Stiffness
from tests.estimators.online.test_objective import BODIES, setting
from tests.physics.pbd.particles import sheet


def test_bumps_share_every_particle_out_and_leave_few_their_own():
    rest = sheet(9, 7).rest
    shares = bumps(rest, 5)
    np.testing.assert_allclose(shares.sum(axis=1), 1, rtol=1e-12)
    assert shares.max(axis=0).min() > 0.5  # at its knot one counts more than all others
    apart = np.linalg.norm(rest[:, None] - rest[shares.argmax(axis=0)], axis=2)
    nearest = shares[np.arange(len(rest)), apart.argmin(axis=1)]
    np.testing.assert_allclose(nearest, shares.max(axis=1), rtol=1e-12)  # the nearest knot has most
    np.testing.assert_array_equal(bumps(rest, len(rest)), np.eye(len(rest)))


@pytest.mark.parametrize("name", BODIES)
def test_carrying_is_the_transpose_of_pulling_back(name):
    objective, fields, start, places, matches, _ = setting(BODIES[name])
    state = objective.stepped(fields, start, places[None]).positions[0, 1]
    residual = objective.mapped(state, matches)
    one, other = np.random.default_rng(4).normal(size=(2, *start.shape))
    held = objective.body.pinned.copy()
    held[objective.gripped] = True
    one[held] = 0
    forth, back = (residual.carried(one) * other).sum(), (one * residual.pulled_back(other)).sum()
    assert forth == pytest.approx(back, rel=1e-10)


@pytest.mark.parametrize("parts", [1, 3])
def test_responses_touch_the_terms_slopes(parts):
    """JᵀR, residuals weighted alike, is the gradient of gap and history, with several time steps a frame as well."""
    objective, fields, start, places, matches, snapshots = setting(BODIES["sheet"])
    objective = dataclasses.replace(objective, parts=parts)
    found = objective.evaluate(fields, start, places, matches, snapshots)
    direction = np.random.default_rng(5).normal(size=objective.body.count)
    ahead = Stiffness((fields.distance + 1e-6 * direction)[None], fields.shape[None])
    changes = objective.responses(fields, ahead, found, start, places, snapshots)[:, 0] / 1e-6
    moved = objective.stepped(
        fields, np.stack([start, *snapshots]),
        np.stack([places, *(state[objective.gripped] for state in snapshots)])[:, None],
    ).positions[:, -1]  # fmt: skip
    edge = objective.body.layout.rest[objective.body.kinds[0]].mean()
    residuals = [found.residual.deformation, *(now - before for now, before in zip(moved[1:], snapshots, strict=True))]
    weights = [objective.weights.gap, *[objective.weights.history] * len(snapshots)]
    stacked = np.concatenate(
        [np.sqrt(w / (edge * np.linalg.norm(r))) * r.ravel() for w, r in zip(weights, residuals, strict=True)]
    )
    smooth = dataclasses.replace(objective, weights=dataclasses.replace(objective.weights, smoothness=0.0))
    slope = smooth.evaluate(fields, start, places, matches, snapshots).slopes.distance
    assert stacked @ changes == pytest.approx(slope @ direction, rel=1e-4)


@pytest.mark.slow
def test_it_gets_where_adam_gets_in_a_tenth_of_the_steps():
    """On one frame, whose objective stays the same; without smoothness, whose kinks Adam only swings about."""
    body = sheet(5, 4, pinned_rows=1)
    random = np.random.default_rng(6)
    objective = Objective(
        body, np.array([18, 19]), Stepping(iterations=8), Mapping(10), weights=Weights(history=0.3, smoothness=0.0)
    )
    true = Stiffness(random.uniform(1.0, 4.0, body.count), np.full(body.count, 0.01))
    _, start, places, matches, snapshots = (None, *setting(body)[2:])
    seen = objective.stepped(true, start, places[None]).positions[0, 1]
    matches[1].observed[:] = seen[::3]
    begun = Stiffness(np.full(body.count, 2.0), np.full(body.count, 0.01))

    def descend(steps: int, newton: bool) -> list[float]:
        logits, fields, values = objective.bounds.logits(begun), begun, []
        adam, gauss = Adam(0.1), GaussNewton(objective, body.count)
        for _ in range(steps):
            found = objective.evaluate(fields, start, places, matches[1:], snapshots)
            values.append(sum(found.terms))
            if newton:
                logits = gauss.step(logits, found, fields, start, places, snapshots)
            else:
                logits = adam.step(logits, objective.bounds.by_logits(fields, found.slopes))
            fields = objective.bounds.fields(logits, float(fields.volume))
        return values

    slow, quick = descend(200, newton=False), descend(20, newton=True)
    assert quick[-1] < slow[0] - 0.98 * (slow[0] - min(slow))
