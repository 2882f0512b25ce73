"""A sheet that is stiffer on one side of a line: where, is found again, and intervals say how well."""

import dataclasses
import math

import numpy as np
import pytest

from palpate.data.synthetic.grip import lattice_matrix
from palpate.estimators.grip import stiffness_fit
from palpate.estimators.grip.sheet import NoSheet, PointGrid, SeenFrame
from palpate.estimators.grip.stiffness_fit import StiffnessField, _Problem, fit_stiffness
from palpate.physics.sheet import equilibrium

SPACING, NOISE, FACTOR, ANCHOR = 8, 0.1, 3.0, 0.1
ROWS, COLUMNS, BEYOND = 36, 44, 16
PICTURE = np.zeros((ROWS * SPACING, COLUMNS * SPACING, 3), np.uint8)


def scene(pull: float = 40.0, factor: float = FACTOR) -> tuple[PointGrid, SeenFrame]:
    """Points and what a frame shows of them: a tool from above pulls what is under its tip."""
    row, column = np.mgrid[: ROWS + 2 * BEYOND, : COLUMNS + 2 * BEYOND] - BEYOND
    places = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    log = np.where(places[:, 0] > 190, math.log(factor), 0.0)
    matrix = lattice_matrix(log.reshape(row.shape), ANCHOR).tocoo()
    upper = matrix.row < matrix.col
    springs = np.column_stack([matrix.row[upper], matrix.col[upper]])
    gripped = np.linalg.norm(places - [176, 120], axis=1) < 12
    motion = np.tile([0.6 * pull, 0.8 * pull], (int(gripped.sum()), 1))
    moved = equilibrium(springs, -matrix.data[upper], np.full(len(log), ANCHOR), gripped, motion).displacement
    inside = ((places >= 0) & (places < [COLUMNS * SPACING, ROWS * SPACING])).all(axis=1)
    apart = np.linalg.norm(np.maximum(np.abs(places - [176, 60]) - [12, 60], 0), axis=1)
    shown, under = inside & (apart > 5), inside & (apart <= 5)
    noise = NOISE * np.random.default_rng(0).standard_normal((int(shown.sum()), 2))
    seen = SeenFrame(moved[shown] + noise, np.full(len(noise), NOISE))
    return PointGrid(places[shown], apart[shown], places[under], SPACING), seen


def fitted(**changes) -> tuple[StiffnessField, np.ndarray, np.ndarray]:
    points, frame = scene(**changes)
    return fit_stiffness(points, frame, PICTURE), points.points, frame.moved


def test_a_stiffer_side_is_found_with_intervals_that_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    # Errors are drawn for every point on its own here, and don't grow with the motion.
    monkeypatch.setattr(stiffness_fit, "TOGETHER", 1.0)
    monkeypatch.setattr(stiffness_fit, "STRAINED", 0.0)
    field, points, moved = fitted()
    moves = np.linalg.norm(moved, axis=1) > 5
    log, sd = field.at(points[moves])
    far = np.abs(points[moves, 0] - 190) > 32  # the field is bilinear between knots 32 px apart
    stiff = points[moves, 0] > 190
    contrast = log[stiff & far].mean() - log[~stiff & far].mean()
    assert 0.7 < contrast / math.log(FACTOR) < 1.1
    truth = math.log(FACTOR) * (field.moving[:, 0] > 190)
    held = np.abs(log - math.log(FACTOR) * stiff + truth.mean()) < 1.645 * sd
    assert held.mean() > 0.85
    assert field.excess < 0.03


def test_a_sheet_that_is_alike_everywhere_is_told_so() -> None:
    field, points, moved = fitted(factor=1.0)
    log, sd = field.at(points[np.linalg.norm(moved, axis=1) > 5])
    assert np.abs(log).max() < 0.3
    assert (np.abs(log) < 1.645 * sd).mean() > 0.9


def test_nothing_is_known_where_nothing_moves() -> None:
    field, points, moved = fitted()
    far = np.linalg.norm(moved, axis=1)
    assert field.known(points[far > 5]).mean() > 0.9
    assert field.known(points[far < 0.5]).mean() < 0.1
    # As sure as before anything was observed, and no surer.
    weak = dataclasses.replace(field, covariance=field.expected)
    assert not weak.known(points).any()


def test_a_field_is_bilinear_between_its_knots_and_less_sure_there() -> None:
    field = fitted()[0]
    knots = field.knots.reshape(*field.shape, 2)
    one, two, middle = knots[3, 4], knots[4, 4], (knots[3, 4] + knots[4, 4]) / 2
    log, sd = field.at(np.array([one, two, middle]))
    assert log[2] == pytest.approx((log[0] + log[1]) / 2)
    assert sd[2] > field.roughness / 2  # a random walk's, half-way between its known ends
    assert sd[2] > sd[:2].max()
    assert field.at(field.moving)[0].mean() == pytest.approx(0, abs=1e-9)


def test_the_slopes_are_those_of_the_residual() -> None:
    problem = _Problem(*scene())
    numbers = problem.mean + 0.1 * np.random.default_rng(1).standard_normal(len(problem.mean))
    problem.look(numbers)
    way = np.random.default_rng(2).standard_normal(len(numbers))
    more, less = (0.5 * np.square(problem.residual(numbers + step * way)).sum() for step in (1e-4, -1e-4))
    # But for the work of the forces, whose prior is so wide that its slope is left out.
    gradient = problem.jacobian(numbers).T @ problem.residual(numbers)
    assert gradient @ way == pytest.approx((more - less) / 2e-4, rel=0.05)


def test_what_tells_nothing_is_refused() -> None:
    points, frame = scene()
    far = points._replace(distance=points.distance + 100, hidden=points.hidden[:0])
    for grid, share, words in (
        (points, 0.01, "50 are needed"),
        (points, 0.1, "moves by more than 5 px"),
        (far, 1.0, "may act on 0 places"),
    ):
        with pytest.raises(NoSheet, match=words):
            fit_stiffness(grid, SeenFrame(share * frame.moved, frame.noise), PICTURE)
