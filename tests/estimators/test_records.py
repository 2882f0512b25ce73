"""What an estimate explains, against tissue that keeps still."""

import dataclasses

import numpy as np
import pytest

from palpate.estimators.estimate import LightFit
from tests.estimators.estimates import CONTACT, ESTIMATE, GOOD, NONE
from tests.results.fields import GRIP, PULL


def test_skill_is_against_no_motion() -> None:
    """The contact sinks along the force by 1 mm a frame; half of it is simulated, then all, then none."""
    along = 0.001 * np.arange(1.0, 9)
    moved = along[:, None] * np.asarray(CONTACT.direction)
    seen = dataclasses.replace(CONTACT.observation, displacement=moved[None])
    contact = CONTACT.having(point=seen)
    for share in (0.5, 1.0, 0.0):
        simulated = np.array([0.0, 0.32]), np.array([0.0, 0.008 * share])
        assert dataclasses.replace(GOOD, interaction=contact, simulated=simulated).skill == pytest.approx(share)
    assert np.isnan(dataclasses.replace(GOOD, interaction=contact, simulated=None).skill)
    assert np.isnan(GOOD.skill)  # nothing moved


def test_skill_of_what_is_told_by_light_by_a_pull_and_by_a_field() -> None:
    light = dataclasses.replace(ESTIMATE, light=LightFit(0.25))
    assert dataclasses.replace(GOOD, estimate=light).skill == 0.75
    assert dataclasses.replace(NONE, grip=GRIP).skill == GRIP.skill
    assert dataclasses.replace(NONE, field=PULL).skill == PULL.skill
    assert np.isnan(NONE.skill)
