"""Contacts as if they had begun at other instants."""

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.onset import onset_error, onset_perturbations
from palpate.physics.load import Press, held
from palpate.physics.mesh import grid_mesh
from palpate.physics.observation import Observation

STEP = 0.005
CONTACT = Interaction(
    mesh=grid_mesh(np.dstack([*np.meshgrid([0.0, 0.01], [0.0, 0.01]), np.ones((2, 2))]), np.ones((2, 2), bool)),
    load=Press.at(0, np.array([0.0, 0.0, -1.0], np.float32), held(50, 200)),
    observation=Observation.of_point(0, 0.04 * np.arange(1, 5), np.arange(12).reshape(4, 3), 0.001),
    time_step=STEP,
)


def test_later_beginnings_leave_less_time_for_the_same_motion() -> None:
    """Frames of 40 ms are 8 steps: what was observed in the 8th step happened 4 or 12 steps after other beginnings."""
    assert onset_perturbations(CONTACT, 0.0, 2) == [CONTACT]
    found = onset_perturbations(CONTACT, 0.04, 2)
    expected = [[step, step + 8, step + 16, step + 24] for step in (15, 11, 7, 3)]
    expected.append([7, 15, 23])  # the tissue was still at rest in the first of the frames
    assert [each.observation.steps(STEP).tolist() for each in found] == expected
    np.testing.assert_array_equal(found[-1].observation.displacement, CONTACT.observation.displacement[:, 1:])
    for each in found:
        assert each.load_seconds == pytest.approx(0.25)
        assert each.load.steps == 208  # what was observed in the load's last step may lie a frame behind it
    assert len(onset_perturbations(CONTACT, 0.04, 4)) == 4
    (alone,) = onset_perturbations(CONTACT, 0.04, 5)
    np.testing.assert_array_equal(alone.observation.times, CONTACT.observation.times)


def test_a_frame_is_what_is_not_known() -> None:
    assert onset_error("between", 25.0) == pytest.approx(0.04)
    assert onset_error("stamp", 25.0) == 0.0
