"""Distances to what was seen, against brute force and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from palpate.estimators.online.matching import Chamfer, Tracks

RANDOM = np.random.default_rng(0)
POINTS, CLOUD = RANDOM.normal(size=(20, 3)), RANDOM.normal(size=(90, 3))
SEEN = np.array([0, 3, 4, 7, 11, 19])
SHARES = RANDOM.dirichlet(np.ones(20), size=8)


def terms():
    observed = RANDOM.normal(size=(8, 3))
    observed[2] = np.nan
    return {"chamfer": Chamfer(CLOUD, SEEN), "tracks": Tracks(csr_array(SHARES), observed)}


def test_chamfer_is_that_of_brute_force():
    apart = np.square(POINTS[SEEN][:, None] - CLOUD).sum(axis=2)
    expected = apart.min(axis=1).mean() + apart.min(axis=0).mean()
    assert Chamfer(CLOUD, SEEN).slope(POINTS)[0] == pytest.approx(expected, rel=1e-12)


def test_followed_points_count_where_they_are_seen():
    observed = SHARES @ POINTS + 0.1
    observed[[1, 5]] = np.nan
    assert Tracks(csr_array(SHARES), observed).slope(POINTS)[0] == pytest.approx(0.03, rel=1e-12)


@pytest.mark.parametrize("name", ["chamfer", "tracks"])
def test_derivatives_equal_finite_differences(name):
    term, direction = terms()[name], RANDOM.normal(size=POINTS.shape)
    (up, above, _), (down, below, _) = (term.slope(POINTS + sign * 1e-6 * direction) for sign in (1, -1))
    _, gradient, curved = term.slope(POINTS)
    assert (gradient * direction).sum() == pytest.approx((up - down) / 2e-6, rel=1e-7)
    np.testing.assert_allclose(curved @ direction, (above - below) / 2e-6, atol=1e-8)


def test_bad_input_is_said():
    for cloud in (np.empty((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(ValueError, match="the cloud has shape"):
            Chamfer(cloud, SEEN)
    with pytest.raises(ValueError, match="no particle is seen"):
        Chamfer(CLOUD, np.empty(0, int))
    for value in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match="not finite"):
            Chamfer(CLOUD, SEEN).slope(np.where(np.arange(20)[:, None] == 7, value, POINTS))
    with pytest.raises(ValueError, match="observed has shape"):
        Tracks(csr_array(SHARES), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="none of the followed points"):
        Tracks(csr_array(SHARES), np.full((8, 3), np.nan))
