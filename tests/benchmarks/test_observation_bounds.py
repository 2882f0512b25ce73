"""The table's rows: every kind of observation looks where it says, and more observations never tell less."""

from __future__ import annotations

import numpy as np

from benchmarks.observation_bounds import FINE, FRAME, limits, observations
from data.synthetic.contacts import draw_contacts
from data.synthetic.settings import SceneSettings


def test_more_observations_never_tell_less() -> None:
    contact = draw_contacts(SceneSettings(width=214, height=120, regime="critical"), 3, 1, 0.005)[0]
    kinds = observations(contact)
    assert kinds["final"][0].tolist() == [FINE.steps - 1]
    assert kinds["trajectory, K = 4"][0].tolist() == [FRAME - 1, 2 * FRAME - 1, 3 * FRAME - 1, 4 * FRAME - 1]
    found = {name: limits(contact, *kinds[name]) for name in ("final", "trajectory, K = 4", "trajectory, K = 25")}
    assert (found["final"] > 100).all()  # one vector, almost along one direction, for three unknowns
    assert (found["trajectory, K = 25"] <= found["trajectory, K = 4"] * (1 + 1e-6)).all()
    assert np.isfinite(found["trajectory, K = 25"]).all()
