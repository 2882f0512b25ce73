"""Sigmoid bounds: there and back, never outside, and their chain rule."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.estimators.online.bounds import PAPER, Bounds
from palpate.physics.pbd.stiffness import Stiffness

FIELDS = Stiffness(np.array([0.2, 5.0, 9.9]), np.array([0.005, 0.01, 0.019]), 7.0)


def test_logits_lead_back():
    bounds = PAPER
    logits = bounds.logits(FIELDS)
    assert logits[:, 1] == pytest.approx([0.0, 0.0])  # both in the middle
    found = bounds.fields(logits, 7.0)
    np.testing.assert_allclose(found.distance, FIELDS.distance, rtol=1e-12)
    np.testing.assert_allclose(found.shape, FIELDS.shape, rtol=1e-12)
    assert found.volume == 7.0


def test_no_logit_leads_outside():
    found = Bounds(4.0, 0.5).fields(np.array([[-1e4, 1e4], [-1e4, 1e4]]), 0.0)
    assert found.distance.tolist() == [0.0, 4.0]
    assert found.shape.tolist() == [0.0, 0.5]


def test_slopes_equal_finite_differences():
    bounds, random = PAPER, np.random.default_rng(0)
    slopes, direction = Stiffness(*random.normal(size=(2, 3)), 0.0), random.normal(size=(2, 3))
    logits = bounds.logits(FIELDS)
    up, down = (bounds.fields(logits + sign * 1e-6 * direction, 0.0) for sign in (1, -1))
    change = sum((slopes[one] * (up[one] - down[one])).sum() for one in (0, 1)) / 2e-6
    assert (bounds.by_logits(FIELDS, slopes) * direction).sum() == pytest.approx(change, rel=1e-7)


def test_what_lies_outside_is_refused():
    with pytest.raises(ValueError, match="the bound of shape is 0"):
        Bounds(shape=0.0)
    for shape in (0.15, 0.02, 0.0):  # the paper's first start, and the bounds themselves
        with pytest.raises(ValueError, match=r"stiffness of shape begins on its bounds, 0 and 0\.02"):
            PAPER.logits(FIELDS._replace(shape=np.full(3, shape)))
