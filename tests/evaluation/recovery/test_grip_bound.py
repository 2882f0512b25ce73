"""The bound of a grip against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.grip.lattice import continued, lattice_springs
from estimators.grip.sheet_fit import BEYOND, GripFrame
from evaluation.recovery.grip_bound import grip_bound
from physics.sheet import Equilibrium, equilibrium

SPACING, COLUMNS, ROWS, LOG = 8, 9, 8, np.log(0.2)


def grid(columns: int, rows: int) -> np.ndarray:
    row, column = np.mgrid[:rows, :columns]
    return SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)


def test_the_bound_is_that_of_all_unknowns_at_once() -> None:
    points = grid(COLUMNS, ROWS)
    gripped = (points < 2.5 * SPACING).all(axis=1)
    nodes = continued(points, SPACING, BEYOND)
    springs, count = lattice_springs(nodes, SPACING), int(gripped.sum())
    held = np.append(gripped, np.zeros(len(nodes) - len(points), bool))

    def sheet(unknown: np.ndarray) -> Equilibrium:
        foundation = np.full(len(nodes), np.exp(unknown[0]))
        return equilibrium(springs, np.ones(len(springs)), foundation, held, unknown[1:].reshape(count, 2))

    def seen(unknown: np.ndarray) -> np.ndarray:
        return sheet(unknown).displacement[: len(points)].ravel()

    def log_force(unknown: np.ndarray) -> np.ndarray:
        return np.array([np.log(np.linalg.norm(sheet(unknown).reaction.sum(axis=0)))])

    true = np.concatenate([[LOG], np.tile([5.0, 2.0], count) + np.random.default_rng(0).normal(0, 0.5, 2 * count)])
    steps = 1e-4 * np.eye(len(true))
    by_all, by_force = (
        np.array([(of(true + step) - of(true - step)) / 2e-4 for step in steps]).T for of in (seen, log_force)
    )
    covariance = np.linalg.inv(by_all.T @ by_all)
    expected = np.sqrt(covariance[0, 0]), np.sqrt((by_force @ covariance @ by_force.T)[0, 0])
    frame = GripFrame(seen(true).reshape(-1, 2), gripped)
    assert grip_bound(points, SPACING, frame, LOG) == pytest.approx(expected, rel=1e-4)
