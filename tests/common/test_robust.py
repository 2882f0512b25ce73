"""Spreads and affine motions of which some values are far off."""

import numpy as np
import pytest

from palpate.common import robust


def test_a_spread_does_not_know_of_what_is_far_off_or_missing() -> None:
    values = np.random.default_rng(0).normal(0, 0.7, 10_000)
    values[:500], values[500:600] = 1e6, np.nan
    assert robust.median_sd(values) == pytest.approx(0.7, rel=0.1)
    assert robust.median_sd(np.full(3, np.nan)) == 0.0


def test_an_affine_motion_is_continued() -> None:
    points = np.random.default_rng(0).uniform(0, 100, (30, 2))
    motion = robust.affine_terms(points) @ [[1.0, 2.0], [-3.0, 0.5], [4.0, 5.0]]
    used = np.arange(30) < 12
    motion_seen = np.where(used[:, None], motion, np.nan)
    np.testing.assert_allclose(robust.affine_motion(points, motion_seen, used, points), motion)
    np.testing.assert_allclose(robust.affine_terms(points).std(axis=0), [1, 1, 0])


def test_a_trimmed_fit_leaves_out_what_is_far_off() -> None:
    place = np.linspace(0, 1, 50)
    terms, values = np.column_stack([place, np.ones(50)]), 3 * place - 1
    values[::7] += 20
    np.testing.assert_allclose(robust.trimmed_fit(terms, values, 4, 3.0), 3 * place - 1, atol=1e-9)
