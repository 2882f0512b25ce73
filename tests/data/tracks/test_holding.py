"""The piece that moves as its middle does, and the background's motion by least distances."""

from __future__ import annotations

import numpy as np
import pytest

from data.tracks.holding import background_terms, held_distance, least_distances

SPACING = 8


def grid() -> np.ndarray:
    rows, columns = np.mgrid[8:320:8, 8:480:8]
    return np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)


def affine(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))]) @ [[0.01, 0.02], [-0.015, 0.01], [6.0, -4.0]]


def swelling(points: np.ndarray, column: float, row: float, width: float, height: float) -> np.ndarray:
    away = np.square(points - [column, row]).sum(axis=1) / (2 * width**2)
    return np.outer(np.exp(-away), [0.6 * height, 0.8 * height])


@pytest.mark.parametrize("curved", [0.0, 2e-4])
def test_background_is_what_most_points_do(curved: float) -> None:
    """A fifth of them moves otherwise, in one piece; the camera moves over flat or curved tissue."""
    points = grid()
    inside = (np.abs(points - [300, 180]) < [120, 64]).all(axis=1)
    assert 0.18 < inside.mean() < 0.22
    own = np.where(inside[:, None], [30.0, 12.0], 0.0)
    camera = affine(points) + curved * np.square(points - 200)
    terms = background_terms(points, camera=curved > 0)
    np.testing.assert_allclose(terms @ least_distances(terms, camera + own), camera, atol=0.1)


def test_an_affine_background_bears_a_fifth_at_one_side() -> None:
    """Not so a quadratic one, which can bend there."""
    points = grid()
    own = np.where((points[:, :1] > 384), [30.0, 12.0], 0.0)
    terms = background_terms(points, camera=False)
    np.testing.assert_allclose(terms @ least_distances(terms, affine(points) + own), affine(points), atol=0.1)


def test_least_distances_are_least() -> None:
    """No other coefficients come closer; along a line it is the median."""
    random = np.random.default_rng(0)
    terms, moved = random.normal(size=(40, 3)), random.standard_t(2, size=(40, 2))
    found = least_distances(terms, moved)

    def total(coefficients: np.ndarray) -> float:
        return float(np.linalg.norm(moved - terms @ coefficients, axis=1).sum())

    for change in 0.05 * random.normal(size=(20, 3, 2)):
        assert total(found) < total(found + change)
    line = np.column_stack([moved[:39, 0], np.zeros(39)])
    assert least_distances(np.ones((39, 1)), line)[0, 0] == pytest.approx(np.median(line[:, 0]), abs=0.05)


def test_too_few_points_move_with_the_background() -> None:
    """Six terms fit five points; none at all fit nothing."""
    terms = background_terms(grid()[[0, 70, 500, 901, 1302]], camera=True)
    moved = np.arange(10.0).reshape(5, 2)
    np.testing.assert_allclose(terms @ least_distances(terms, moved), moved, atol=1e-4)
    np.testing.assert_array_equal(least_distances(terms[:0], moved[:0]), np.zeros((6, 2)))


def test_held_is_what_moves_as_the_place_does() -> None:
    points = grid()
    moved = swelling(points, 120, 200, 40, 30)
    moved[::7] = np.nan
    distance = held_distance(points, SPACING, moved, np.array([120, 200]), 0.5)
    held = points[distance == 0]
    away = np.linalg.norm(held - [120, 200], axis=1)
    # A swelling is above a share of its height up to √(2 log(1/share)) widths.
    assert away.max() == pytest.approx(40 * np.sqrt(2 * np.log(2)), abs=SPACING)
    expected = np.maximum(np.linalg.norm(points - [120, 200], axis=1) - away.max(), 0)
    np.testing.assert_allclose(distance, expected, atol=2 * SPACING)


@pytest.mark.parametrize(("place", "side"), [((120, 160), 0), ((380, 160), 1)])
def test_one_piece_is_held_not_two(place: tuple[int, int], side: int) -> None:
    """Neither the larger nor the other one, nor what moves the other way beside it."""
    points = grid()
    moved = swelling(points, 120, 160, 30, 25) + swelling(points, 380, 160, 20, 25)
    moved -= swelling(points, 120, 260, 20, 40) + swelling(points, 380, 260, 20, 40)
    held = points[held_distance(points, SPACING, moved, np.array(place), 0.6) == 0]
    assert np.array_equal(held[:, 0] > 250, np.full(len(held), bool(side)))
    assert held[:, 1].max() < 215


def test_where_nothing_is_seen_or_moves_nothing_is_held() -> None:
    points, place = grid(), np.array([100.0, 100.0])
    assert np.isinf(held_distance(points, SPACING, np.full(points.shape, np.nan), place, 0.5)).all()
    assert np.isinf(held_distance(points, SPACING, np.zeros(points.shape), place, 0.5)).all()
    assert held_distance(points[:0], SPACING, np.zeros((0, 2)), place, 0.5).shape == (0,)
