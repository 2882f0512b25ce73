"""DiffCloud's way: fields that many epochs over the same frames bring nearer to what was seen."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import eye_array

from palpate.estimators.online.matching import Chamfer, Tracks
from palpate.estimators.online.objective import Objective
from palpate.evaluation.online.batch_fit import fit_batch
from palpate.physics.pbd.stiffness import Stiffness
from tests.physics.pbd.particles import sheet

BODY = sheet(5, 4, pinned_rows=1)
GRIPPED = np.array([18, 19])
PLACES = BODY.rest[GRIPPED] + np.linspace(0.2, 1, 6)[:, None, None] * np.array([0.002, 0.006, 0.003])


def uniform(distance: float) -> Stiffness:
    return Stiffness(np.full(BODY.count, distance), np.full(BODY.count, 0.01))


@pytest.mark.parametrize("kind", ["tracks", "chamfer"])
def test_epochs_bring_fields_nearer_to_what_was_seen(kind: str) -> None:
    objective = Objective(BODY, GRIPPED)
    seen = objective.stepped(uniform(2.0), BODY.rest, PLACES).positions[0, 1:]
    all_of = eye_array(BODY.count).tocsr()
    matches = [[Tracks(all_of, state) if kind == "tracks" else Chamfer(state, BODY.surface)] for state in seen]
    fields, left = fit_batch(objective, uniform(0.5), PLACES, matches, 0.1, epochs=25)
    assert len(left) == 25
    assert left[-1] < 0.3 * left[0]
    free = ~BODY.pinned
    assert np.mean(fields.distance[free]) > 1.0
    edge = BODY.layout.rest[BODY.kinds[0]].mean()
    apart = objective.stepped(uniform(0.5), BODY.rest, PLACES).positions[0, 1:] - seen
    if kind == "tracks":
        assert left[0] == pytest.approx(np.square(apart).sum() / (6 * BODY.count * edge**2))
