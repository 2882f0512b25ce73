"""Neighbours on a grid with holes, and fields that a few numbers give, against brute force."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from estimators.grip.lattice import (
    KNOT,
    LEVEL,
    SPREAD,
    TYPICAL_ANCHOR,
    continued,
    knotted,
    lattice_springs,
    uniform,
)

BEYOND = 3


def grid(columns: int, rows: int, spacing: int = 8) -> np.ndarray:
    row, column = np.mgrid[:rows, :columns]
    return (spacing * np.column_stack([column.ravel() + 3, row.ravel() + 2])).astype(np.float32)


def beside(points: np.ndarray, spacing: float) -> set[tuple[int, int]]:
    """All pairs no farther apart than a diagonal."""
    pairs = combinations(range(len(points)), 2)
    return {pair for pair in pairs if np.abs(points[pair[0]] - points[pair[1]]).max() < 1.5 * spacing}


@pytest.mark.parametrize("share", [1.0, 0.7, 0.3])
def test_springs_join_neighbours_once(share: float) -> None:
    points = grid(9, 7)
    points = points[np.random.default_rng(0).random(len(points)) <= share]
    springs = lattice_springs(points, 8)
    found = [tuple(sorted(pair)) for pair in springs.tolist()]
    assert len(found) == len(set(found)) > 10
    assert set(found) == beside(points, 8)


def test_a_whole_grid_has_springs_along_four_directions() -> None:
    assert len(lattice_springs(grid(6, 5), 8)) == 5 * 5 + 6 * 4 + 2 * 5 * 4


def test_opposite_edges_are_no_neighbours() -> None:
    """Where the index of a cell above the first row would wrap round."""
    assert lattice_springs(np.array([[8.0, 8.0], [40.0, 8.0], [40.0, 40.0], [8.0, 40.0]]), 8).shape == (0, 2)
    two = np.array([[8.0, 8.0], [16.0, 24.0]])
    assert len(lattice_springs(two, 8)) == 0
    two[1, 1] = 16
    assert lattice_springs(two, 8).tolist() == [[0, 1]]


def test_one_number_is_the_foundation_of_all() -> None:
    fields = uniform(5)
    np.testing.assert_array_equal(fields.stiffness @ np.array([1.7]), np.zeros(5))
    np.testing.assert_array_equal(fields.anchor @ np.array([1.7]), np.full(5, 1.7))
    np.testing.assert_allclose(fields.mean, [np.log(TYPICAL_ANCHOR)])
    np.testing.assert_allclose(fields.precision, [[1 / SPREAD**2]])


def knots(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Points, the place of every knot among them, and how many there are along either axis."""
    points = grid(columns, rows)
    shape = tuple(round((side - 1) / KNOT) + 1 for side in (columns, rows))
    sides = [np.linspace(low, high, count) for low, high, count in zip(points[0], points[-1], shape, strict=True)]
    column, row = np.meshgrid(*sides, indexing="ij")
    return points, np.column_stack([column.ravel(), row.ravel()]), shape


def test_fields_are_bilinear_between_knots() -> None:
    """What is bilinear everywhere is so in each cell; the sum of the weights is 1."""
    points, places, shape = knots(22, 15)
    assert shape == (4, 3)
    fields = knotted(points, len(points), 8, 1.0)
    half = len(fields.mean) // 2
    assert half == len(places) == 12

    def plane(at: np.ndarray) -> np.ndarray:
        return 1.5 + 0.03 * at[:, 0] - 0.01 * at[:, 1] + 2e-4 * at[:, 0] * at[:, 1]

    nothing = np.zeros(half)
    np.testing.assert_allclose(fields.stiffness @ np.r_[plane(places), nothing], plane(points), rtol=1e-6)
    np.testing.assert_allclose(fields.anchor @ np.r_[nothing, plane(places)], plane(points), rtol=1e-6)
    np.testing.assert_array_equal(fields.stiffness @ np.r_[nothing, plane(places)], 0)
    np.testing.assert_array_equal(fields.anchor @ np.r_[plane(places), nothing], 0)
    weights = fields.stiffness.toarray()
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-6)


def test_a_knot_counts_only_in_the_cells_around_it() -> None:
    points, places, _ = knots(22, 15)
    weights = knotted(points, len(points), 8, 1.0).stiffness.toarray()[:, : len(places)]
    for knot, place in enumerate(places):
        away = np.abs(points - place) / (8 * KNOT)
        expected = np.prod(np.maximum(1 - away, 0), axis=1)
        np.testing.assert_allclose(weights[:, knot], expected, atol=1e-6)


def test_the_prior_punishes_steps_between_knots_and_levels() -> None:
    points, places, (columns, rows) = knots(22, 15)
    roughness = 0.4
    fields = knotted(points, len(points), 8, roughness)
    half = len(places)
    np.testing.assert_allclose(fields.mean, [0.0] * half + [np.log(TYPICAL_ANCHOR)] * half)
    numbers = np.random.default_rng(0).normal(size=2 * half)
    expected = 0.0
    for values, level in ((numbers[:half], LEVEL), (numbers[half:], SPREAD)):
        square = values.reshape(columns, rows)
        steps = sum(np.square(np.diff(square, axis=axis)).sum() for axis in (0, 1))
        expected += steps / roughness**2 + values.mean() ** 2 / level**2
    assert numbers @ fields.precision @ numbers == pytest.approx(expected)
    assert np.linalg.eigvalsh(fields.precision).min() > 0


def test_few_points_still_have_four_knots() -> None:
    points = grid(3, 1)
    fields = knotted(points, len(points), 8, 1.0)
    assert fields.stiffness.shape == (3, 8)
    np.testing.assert_allclose(fields.anchor @ np.r_[np.zeros(4), np.ones(4)], 1)
    np.testing.assert_allclose(fields.anchor @ np.r_[np.zeros(4), 0, 0, 1, 1], [0, 0.5, 1])


def test_a_sheet_goes_on_where_nothing_is_seen() -> None:
    """Behind a hole and beyond the edges, every place once, the points first."""
    whole = grid(9, 7)
    points = whole[np.hypot(*(whole - whole[30]).T) > 17].astype(np.float64)
    nodes = continued(points, 8, BEYOND)
    np.testing.assert_array_equal(nodes[: len(points)], points)
    column, row = np.meshgrid(*(8.0 * np.arange(low - BEYOND, high + BEYOND) for low, high in ((3, 12), (2, 9))))
    assert sorted(map(tuple, nodes)) == sorted(zip(column.ravel(), row.ravel(), strict=True))


def test_beyond_the_points_a_field_is_as_at_their_edge() -> None:
    points, places, _ = knots(22, 15)
    nodes = continued(points.astype(np.float64), 8, BEYOND)
    weights = knotted(nodes, len(points), 8, 1.0).stiffness.toarray()[:, : len(places)]
    nearest = np.clip(nodes, points.min(axis=0), points.max(axis=0))
    value = places @ [0.3, -0.2]
    np.testing.assert_allclose(weights @ value, nearest @ [0.3, -0.2], atol=1e-9)
