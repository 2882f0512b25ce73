"""Where a fit of a slab begins, and that it goes down."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.depth_sequence import DepthSequence, SequenceNoise
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_descent import descend, find_tip, slab_start
from palpate.estimators.direct.slab_motion import SlabMotion
from tests.estimators.direct.slabs import COARSE, LOGS, TIMES, VERTEX_PLACE, contact_of, seen, slab_of
from tests.estimators.direct.test_field import MESH, SIDE, SIGMA, SIZE


def test_the_tips_middle_is_found() -> None:
    """The depth-change sequence of a tip that presses beside the contact's vertex."""
    place = (VERTEX_PLACE[0] + 1.3, VERTEX_PLACE[1] - 0.8)
    contact, slab = contact_of(), slab_of()
    empty = DepthSequence(TIMES, np.zeros((10, SIDE, SIDE), np.float32), SequenceNoise(SIGMA, 0.0), SIZE)
    contact = dataclasses.replace(contact, sequence=empty)

    def problem_of(tried: tuple[float, float]) -> SequenceProblem[SlabMotion]:
        def motion(vertices: np.ndarray, times: np.ndarray) -> SlabMotion:
            return SlabMotion(contact, slab, MESH.pixels[vertices], times, place=tried)

        found = SequenceProblem(contact, motion)
        moved = SlabMotion(contact, slab, MESH.pixels[found.patches.vertices], TIMES, place=place).at(LOGS)[0]
        found.observed = found.patches.shown(found.patches.sunk(moved), found.patches.covering(moved))
        return found

    found = find_tip(problem_of, VERTEX_PLACE)
    np.testing.assert_allclose(found, place, atol=0.4)
    np.testing.assert_allclose(find_tip(problem_of, found), place, atol=0.15)


@pytest.mark.slow
def test_a_start_is_near_and_a_descent_goes_down() -> None:
    contact = seen(LOGS, 1, COARSE)
    problem = SequenceProblem(
        contact, lambda vertices, times: SlabMotion(contact, slab_of(), MESH.pixels[vertices], times)
    )
    start = slab_start(problem)
    assert np.abs(start - LOGS).max() < 1.0
    far = LOGS + 0.5 * np.eye(3)[0]
    problem.look(far)
    before = np.square(problem.residual(far)).sum()
    assert np.square(problem.residual(descend(problem, far, problem.motion.box, 1.0))).sum() < before - 20
