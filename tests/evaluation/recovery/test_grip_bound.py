"""The bound of a grip against brute force, and against a twin that draws noise and reaches it."""

from functools import partial

import numpy as np
import pytest
from scipy.linalg import block_diag

from palpate.estimators.grip.sheet import SIZE, PointGrid, load_precision, loaded_cells
from palpate.evaluation.recovery.grip_bound import Following, GripBound, grip_bound, measure_following, ring_correlation
from palpate.physics.sheet import response

SPACING, LOG = 8, np.log(0.2)
PULLS = np.array([0.6, 1.0])
TRACKED = Following(np.empty(0), 6.0, 0.1, np.array([[1.0, 0.5], [0.5, 1.0]]))


def grid() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of a grid and their distances from a tool that hides two others [px]."""
    row, column = np.mgrid[1:13, 1:17]
    places = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    hidden = np.isin(places[:, 0], [64.0]) & np.isin(places[:, 1], [40.0, 48.0])
    distance = np.linalg.norm(places - [64, 44], axis=1)
    return places[~hidden], distance[~hidden] + 12, places[hidden]


def problem() -> tuple[np.ndarray, np.ndarray, Following]:
    """Cells from loaded ones to points [n, M, 2], all nuisances [T, M + 3, 2], and how points are followed."""
    points, distance, hidden = grid()
    cells, loaded = np.rint(points / SPACING).astype(int), loaded_cells(PointGrid(points, distance, hidden, SPACING))
    assert 3 < len(loaded) < 15
    generator = np.random.default_rng(0)
    loads = generator.normal(3.0, 1.0, (len(loaded), 2)) * [2.0, 1.0]
    nuisances = PULLS[:, None, None] * np.concatenate([loads, [[0.5, 0.1], [0.3, -0.2], [1.0, 0.4]]])
    sizes = np.where(distance < 30, 0.4, 0.1) * generator.uniform(0.8, 1.2, len(points))
    following = Following(sizes, 6.0, 0.05, np.array([[1.2, 0.5], [0.5, 1.0]]))
    return cells[:, None] - loaded, nuisances, following


def design(apart: np.ndarray, log_anchor: float) -> np.ndarray:
    points = grid()[0]
    terms = np.column_stack([(points - points.mean(axis=0)) / points.std(axis=0), np.ones(len(points))])
    return np.hstack([response(float(np.exp(log_anchor)), SIZE)[tuple(np.moveaxis(apart, -1, 0) % SIZE)], terms])


def bound() -> GripBound:
    apart, nuisances, following = problem()
    answer = response(float(np.exp(LOG)), SIZE)[tuple(np.moveaxis(apart, -1, 0) % SIZE)]
    moved = np.einsum("nm,tma->tna", answer, nuisances[:, :-3])
    points, distance, hidden = grid()
    return grip_bound(PointGrid(points, distance, hidden, SPACING), moved, following, LOG)


@pytest.fixture(autouse=True)
def no_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.evaluation.recovery.grip_bound.load_precision", partial(load_precision, energy=1e9))


def test_the_bound_is_that_of_all_unknowns_at_once() -> None:
    apart, nuisances, following = problem()
    count, axes = nuisances.shape[1], 2
    covariance = np.kron(following.in_time, following.covariance(grid()[0]))
    more, less = (design(apart, LOG + step) for step in (0.005, -0.005))
    information = np.zeros((1 + axes * len(PULLS) * count,) * 2)
    linear = block_diag(*[design(apart, LOG)] * len(PULLS))
    for axis in range(axes):
        slope = np.concatenate([(more - less) / 0.01 @ frame[:, axis] for frame in nuisances])
        own = np.zeros((len(slope), len(information)))
        own[:, 0] = slope
        own[:, 1 + axis * linear.shape[1] : 1 + (axis + 1) * linear.shape[1]] = linear
        information += own.T @ np.linalg.solve(covariance, own)
    variance = np.linalg.inv(information)
    force = nuisances[-1, :-3].sum(axis=0)
    by_force = np.zeros(len(information))
    for axis in range(axes):
        last = 1 + axis * linear.shape[1] + count
        by_force[last : last + count - 3] = force[axis] / (force @ force)
    expected = np.sqrt([variance[0, 0], by_force @ variance @ by_force])
    assert bound() == pytest.approx(expected, rel=2e-3)


def test_an_estimator_that_knows_the_noise_reaches_the_bound() -> None:
    """Generalised least squares of drawn noise: log foundation where three values' parabola has its lowest point."""
    apart, nuisances, following = problem()
    generator, draws, step = np.random.default_rng(1), 400, 0.05
    in_place, in_time = (np.linalg.cholesky(item) for item in (following.covariance(grid()[0]), following.in_time))
    true = np.einsum("nm,tma->nta", design(apart, LOG), nuisances)
    noise = np.einsum("nm,ts,dmsa->dnta", in_place, in_time, generator.normal(size=(draws, *true.shape)), optimize=True)
    seen, whiten = true + noise, np.linalg.inv(in_time)
    losses, forces = [], []
    for log_anchor in LOG + step * np.array([-1.0, 0.0, 1.0]):
        rows = np.linalg.solve(in_place, design(apart, log_anchor))
        right = np.linalg.solve(in_place, np.moveaxis(seen, 0, -1).reshape(len(rows), -1))
        found = np.linalg.lstsq(rows, right)[0]
        left = (right - rows @ found).reshape(len(rows), len(PULLS), 2, draws)
        losses.append(np.square(np.einsum("ts,nsad->ntad", whiten, left)).sum(axis=(0, 1, 2)))
        forces.append(found.reshape(-1, len(PULLS), 2, draws)[:-3, -1].sum(axis=0))
    less, middle, more = losses
    off = 0.5 * step * (less - more) / (less + more - 2 * middle)
    force = forces[1] + (forces[2] - forces[0]) / (2 * step) * off
    size = np.linalg.norm(nuisances[-1, :-3].sum(axis=0))
    reached = off.std(), np.log(np.linalg.norm(force, axis=0) / size).std()
    # 400 draws tell a standard deviation to within 3.5 %.
    assert reached == pytest.approx(bound(), rel=0.12)


def test_drawn_errors_are_measured() -> None:
    row, column = np.mgrid[:40, :50]
    points = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    sizes = np.where(np.arange(len(points)) % 5 == 0, 0.8, 0.2)
    true = Following(sizes, TRACKED.reach, TRACKED.shared, TRACKED.in_time)
    places = np.linalg.cholesky(true.covariance(points) + 1e-9 * np.eye(len(points)))
    generator, times = np.random.default_rng(2), np.linalg.cholesky(true.in_time)
    errors = np.einsum("nm,ts,sma->tna", places, times, generator.normal(size=(2, len(points), 2)), optimize=True)
    errors[0, :10] = np.nan
    grid = PointGrid(points, np.zeros(len(points)), np.empty((0, 2)), SPACING)
    found = measure_following(grid, 1.7 * sizes, errors)
    # As far as errors of points are correlated, so many fewer count.
    np.testing.assert_allclose(found.sizes, sizes, rtol=0.15)
    assert 0.05 < found.shared < 0.2
    np.testing.assert_allclose(found.in_time, true.in_time, atol=0.15)
    even = Following(np.ones(len(points)), TRACKED.reach, TRACKED.shared, TRACKED.in_time)
    shared = np.linalg.cholesky(even.covariance(points)) @ generator.normal(size=(len(points), 2))
    again = measure_following(grid, np.ones(len(points)), shared[None])
    assert abs(again.reach / TRACKED.reach - 1) < 0.2


def test_correlation_is_found_ring_by_ring() -> None:
    row, column = np.mgrid[:30, :30]
    points = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    wave = np.cos(np.pi * column.ravel() / 3)
    found = ring_correlation(points, SPACING, np.column_stack([wave, wave]))
    assert found[0] == 1
    assert found[3] < -0.2 < 0.2 < found[1]
    white = np.random.default_rng(3).normal(size=(900, 2))
    assert np.abs(ring_correlation(points, SPACING, white)[1:10]).max() < 0.1
