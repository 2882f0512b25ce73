"""Neighbours on a grid with holes, and fields between the knots of a grid, against brute force."""

from itertools import combinations

import numpy as np
import pytest

from palpate.estimators.grip.lattice import bilinear, continued, lattice_springs, smoothness

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


def test_opposite_edges_are_no_neighbours() -> None:
    """Where the index of a cell above the first row would wrap round."""
    assert lattice_springs(np.array([[8.0, 8.0], [40.0, 8.0], [40.0, 40.0], [8.0, 40.0]]), 8).shape == (0, 2)
    two = np.array([[8.0, 8.0], [16.0, 24.0]])
    assert len(lattice_springs(two, 8)) == 0
    two[1, 1] = 16
    assert lattice_springs(two, 8).tolist() == [[0, 1]]


def test_a_sheet_goes_on_where_nothing_is_seen() -> None:
    """Behind a hole and beyond the edges, every place once, the points first."""
    whole = grid(9, 7)
    points = whole[np.hypot(*(whole - whole[30]).T) > 17].astype(np.float64)
    nodes = continued(points, 8, BEYOND)
    np.testing.assert_array_equal(nodes[: len(points)], points)
    column, row = np.meshgrid(*(8.0 * np.arange(low - BEYOND, high + BEYOND) for low, high in ((3, 12), (2, 9))))
    assert sorted(map(tuple, nodes)) == sorted(zip(column.ravel(), row.ravel(), strict=True))


def test_fields_are_bilinear_between_knots() -> None:
    """What is bilinear everywhere is so in each cell; a knot counts only in the cells around it."""
    shape = np.array([4, 3])
    places = np.random.default_rng(0).uniform(0, shape - 1, (50, 2))
    weights, knots = bilinear(places, shape).toarray(), np.argwhere(np.ones(shape, bool))

    def plane(at: np.ndarray) -> np.ndarray:
        return 1.5 + 3 * at[:, 0] - at[:, 1] + 0.2 * at[:, 0] * at[:, 1]

    np.testing.assert_allclose(weights @ plane(knots), plane(places))
    away = np.abs(places[:, None] - knots)
    np.testing.assert_allclose(weights, np.maximum(1 - away, 0).prod(axis=2), atol=1e-12)


def test_steps_between_knots_are_summed_up() -> None:
    values = np.random.default_rng(0).normal(size=(4, 3))
    steps = sum(np.square(np.diff(values, axis=axis)).sum() for axis in (0, 1))
    assert values.ravel() @ smoothness(np.array([4, 3])) @ values.ravel() == pytest.approx(steps)
