"""Contacts as if they had begun at other instants, and what estimates of them are together."""

from __future__ import annotations

import numpy as np
import pytest

from data.samples import ContactCase
from estimators.onset import begun_otherwise, onset_error, together
from physics.mesh import grid_mesh

CASE = ContactCase(
    mesh=grid_mesh(np.dstack([*np.meshgrid([0.0, 0.01], [0.0, 0.01]), np.ones((2, 2))]), np.ones((2, 2), bool)),
    vertex=0,
    direction=np.array([0.0, 0.0, -1.0], np.float32),
    load_steps=50,
    steps=np.array([7, 15, 23, 31]),
    displacement=np.arange(12, dtype=np.float32).reshape(4, 3),
    weight=np.ones(4, np.float32),
    noise=0.001,
)


def test_later_beginnings_leave_less_time_for_the_same_motion() -> None:
    """Frames of 40 ms are 8 steps: what was seen in the 8th step happened 4 or 12 steps after other beginnings."""
    assert begun_otherwise(CASE, 0.0, 0.005, 2) == [CASE]
    found = begun_otherwise(CASE, 0.04, 0.005, 2)
    assert [case.steps.tolist() for case in found] == [
        [15, 23, 31, 39],
        [11, 19, 27, 35],
        [7, 15, 23, 31],
        [3, 11, 19, 27],
        [7, 15, 23],  # the tissue was still at rest in the first of the frames
    ]
    np.testing.assert_array_equal(found[-1].displacement, CASE.displacement[1:])
    assert {case.load_steps for case in found} == {50}
    assert len(begun_otherwise(CASE, 0.04, 0.005, 4)) == 4
    assert begun_otherwise(CASE, 0.04, 0.005, 5) == [CASE]


def test_together_they_are_a_mixture() -> None:
    """Mean and covariance of draws of which every distribution gives as many."""
    generator = np.random.default_rng(0)
    means = np.array([[0.0, 1.0], [2.0, -1.0], [1.0, 0.5]])
    factors = np.array([[[1.0, 0.0], [0.5, 0.3]], [[0.2, 0.0], [0.0, 2.0]], [[1.0, 0.0], [-0.4, 0.1]]])
    draws = np.concatenate(
        [mean + generator.normal(size=(200_000, 2)) @ f.T for mean, f in zip(means, factors, strict=True)]
    )
    mean, covariance = together(means, factors @ factors.transpose(0, 2, 1))
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.02)


def test_a_frame_is_what_is_not_known() -> None:
    assert onset_error("between", 25.0) == pytest.approx(0.04)
    assert onset_error("stamp", 25.0) == 0.0
