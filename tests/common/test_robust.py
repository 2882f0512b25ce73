"""Errors of which some are large: their weights, size and density, and what they leave of an affine motion."""

import numpy as np
import pytest

from palpate.common import robust


def test_weights_are_the_slope_of_the_loss() -> None:
    """d loss / d(r²/2) is weight / variance: what reweighting minimises is Student's density."""
    squares, variance, step = np.array([0.01, 1.0, 40.0]), np.array([0.5, 1.0, 2.0]), 1e-6
    for index, row in enumerate(step * np.eye(3)):
        slope = (robust.student_loss(squares + row, variance) - robust.student_loss(squares - row, variance)) / (
            2 * step
        )
        assert 2 * slope * variance[index] == pytest.approx(robust.student_weights(squares, variance)[index], rel=1e-6)
    assert robust.student_weights(np.zeros(1), np.ones(1)) == pytest.approx((robust.FREEDOM + 2) / robust.FREEDOM)


@pytest.mark.parametrize("scale", [0.0, 0.3, 2.0])
def test_the_size_of_errors_beside_the_known_one_is_found(scale: float) -> None:
    generator = np.random.default_rng(0)
    known = generator.uniform(0.1, 0.3, 20_000)
    off = generator.normal(size=(len(known), 2)) * np.sqrt(known + scale)[:, None]
    off *= 1.0 if scale else 0.6  # smaller than known: there is no other error
    found = 0.0
    for _ in range(20):
        found = robust.error_scale(np.square(off).sum(axis=1), known, np.ones(len(known)), found, 0.01)
    assert found == pytest.approx(scale, rel=0.05)


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
