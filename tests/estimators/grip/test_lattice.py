"""Neighbours on a grid with holes against brute force, and sheets fitted to frames made by the simulator."""

from itertools import combinations

import numpy as np
import pytest

from palpate.common.robust import affine_terms
from palpate.estimators.grip import lattice
from palpate.estimators.grip.lattice import (
    ALPHAS,
    GripFrame,
    SheetFit,
    continued,
    fit_sheets,
    lattice_springs,
    posterior,
)
from palpate.physics.sheet import equilibrium

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


POINTS = grid(20, 16).astype(np.float64)
GRIPPED = (POINTS[:, 0] <= 7 * 8) & (np.abs(POINTS[:, 1] - 80) < 24)
"""30 nodes at the middle of the left edge."""
PULLS = np.linspace(6, 24, 8)


def pulled(alpha: float, noise: float = 0.02) -> np.ndarray:
    """Displacement of the points under a grip that pulls and turns a little, shape [T, N, 2]."""
    nodes = continued(POINTS, 8, lattice.BEYOND)
    springs, held = lattice_springs(nodes, 8), np.append(GRIPPED, np.zeros(len(nodes) - len(POINTS), bool))
    off = POINTS[GRIPPED] - POINTS[GRIPPED].mean(axis=0)
    motion = np.array([1.0, 0.4]) + 0.01 * off @ np.array([[0, 1], [-1, 0]])
    found = equilibrium(springs, np.ones(len(springs)), np.full(len(nodes), alpha), held, motion)
    moved = PULLS[:, None, None] * found.displacement[: len(POINTS)]
    return moved + np.random.default_rng(0).normal(0, noise, moved.shape)


def fitted(moved: np.ndarray, background: np.ndarray | None = None) -> SheetFit:
    still = np.zeros((len(moved), 3, 2))
    return fit_sheets(POINTS, 8, GRIPPED, moved, still if background is None else background)


@pytest.mark.parametrize("index", [4, 7, 10])
def test_alpha_and_forces_are_found_again(index: int) -> None:
    moved = pulled(ALPHAS[index])
    moved[(np.random.default_rng(2).random(moved.shape[:2]) < 0.3) & ~GRIPPED] = np.nan
    fit = fitted(moved)
    assert np.argmax(posterior(fit.squares, fit.counts)) == np.argmax(posterior(fit.refitted, fit.counts)) == index
    assert fit.skill(4) > 0.97
    force, sd = fit.relative_force()
    np.testing.assert_allclose(force, PULLS / PULLS[-1], rtol=0.02)
    assert sd.max() < 0.01


def test_an_affine_background_changes_no_force() -> None:
    moved = pulled(ALPHAS[8])
    ways = np.random.default_rng(4).normal(0, 5, (len(PULLS), 3, 2))
    still, carried = fitted(moved), fitted(moved + affine_terms(POINTS) @ ways, ways)
    assert carried.skill(4) == pytest.approx(still.skill(4), abs=1e-6)
    np.testing.assert_allclose(carried.force, still.force, atol=1e-6)
    np.testing.assert_allclose(carried.refitted, still.refitted, rtol=1e-6)


def test_a_force_is_what_the_foundation_holds() -> None:
    fit = fitted(pulled(ALPHAS[8], noise=0.0))
    nodes = continued(POINTS, 8, lattice.BEYOND)
    springs, held = lattice_springs(nodes, 8), np.append(GRIPPED, np.zeros(len(nodes) - len(POINTS), bool))
    motion = pulled(ALPHAS[8], noise=0.0)[-1][GRIPPED]
    found = equilibrium(springs, np.ones(len(springs)), np.full(len(nodes), ALPHAS[8]), held, motion)
    np.testing.assert_allclose(fit.force[8, -1], ALPHAS[8] * found.displacement.sum(axis=0), rtol=1e-6)


def test_forces_spread_as_alpha_does() -> None:
    """Two values of alpha as likely as each other, and a force across the last frame's that counts nothing."""
    squares, force = np.ones((2, 2)), np.array([[[1.0, 9.0], [2.0, 0.0]], [[3.0, 0.0], [4.0, 0.0]]])
    fit = SheetFit(squares, squares, np.ones(2), np.full(2, 98), force)
    mean, sd = fit.relative_force()
    np.testing.assert_allclose(mean, [0.625, 1])
    np.testing.assert_allclose(sd, [0.125, 0])
    # Two pieces, so four numbers in two frames whose errors are alike: a factor e in their size is e² in density.
    found = posterior(np.exp(2 * np.array([[0.0, 0.0], [1.0, 1.0]])), np.full(2, 2 * lattice.PIECE**2))
    assert found[0] / found[1] == pytest.approx(np.exp(4))


def test_a_frame_counts_if_enough_is_visible_and_moves() -> None:
    count = lattice.LEAST_GRIPPED + lattice.LEAST_AROUND
    moved = np.broadcast_to([3.0, 4.0], (count, 2)).copy()
    gripped = np.arange(count) < lattice.LEAST_GRIPPED
    assert lattice.length(moved) == pytest.approx(5.0)
    assert GripFrame(moved, gripped).moves
    assert not GripFrame(moved, gripped & (np.arange(count) > 0)).moves
    lost = moved.copy()
    lost[-1, 1] = np.nan
    assert not GripFrame(lost, gripped).moves
    assert not GripFrame(np.where(gripped[:, None], moved, [0.6, 0.79]), gripped).moves  # 0.99 px
    assert GripFrame(np.where(gripped[:, None], moved, [0.6, 0.81]), gripped).moves
