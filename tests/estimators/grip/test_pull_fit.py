"""Force over E of a drawn pull: found again from points, whatever the background does and near points say."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip import pull_fit
from palpate.estimators.grip.pull_fit import PullFit, _Problem, fit_pull
from palpate.estimators.grip.pull_motion import PullMotion
from palpate.estimators.grip.sheet import PointGrid, SeenFrame
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.fem import Inertia, Material, simulate
from palpate.physics.load import Grip
from tests.estimators.grip.test_pull_motion import CELL, FOCAL, slab_of

SPACING, FRAME, FRAMES, SUBSTEPS = 8, 0.04, 15, 2
YOUNG, DAMPING, DENSITY, POISSON = 200.0, 20.0, 1500.0, 0.45
PULL = np.array([0.008, -0.005, 0.0])
TIMES = FRAME * np.arange(3, FRAMES + 1)
SAME, OTHER = (6, 6, 2), (8, 8, 3)


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Places of a grid [px], and their distances from a tool that comes from the left."""
    row, column = np.mgrid[1:60, 1:60]
    places = SPACING * np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    away = np.maximum(np.abs(places - [120, 242]) - [122, 12], 0)
    distance = np.linalg.norm(away, axis=1)
    return places[distance > 5], distance[distance > 5]


def point_grid() -> PointGrid:
    """The grid, of which no place is hidden."""
    points, distance = grid()
    return PointGrid(points, distance, points[:0], SPACING)


@functools.lru_cache
def truth(cells: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Of a neo-Hookean slab: points' true motion [T, N, 2] [px], and force over E [T, 2] [scene units²]."""
    slab, steps = slab_of(cells), FRAMES * SUBSTEPS
    share = np.minimum(np.arange(1, steps + 1) / steps / 0.8, 1)
    path = (share**3 * (10 - 15 * share + 6 * share**2))[:, None] * PULL
    nodes = slab.top[np.hypot(slab.columns[:, None] - slab.place[0], slab.rows - slab.place[1]) <= 10.0]
    law, inertia = Material("neo_hookean", YOUNG, POISSON), Inertia(DENSITY, DAMPING)
    grip = Grip(nodes, np.repeat(path[:, None], len(nodes), axis=1))
    body = simulate(slab.solid, law, slab.held, grip, FRAME / SUBSTEPS, inertia=inertia)
    pixels = (grid()[0] + 0.5) / CELL - 0.5
    low, high = (np.array([slab.columns[end], slab.rows[end]]) for end in (0, -1))
    inside = ((pixels > low) & (pixels < high)).all(axis=1)
    shown = slab.between(pixels[inside, ::-1])
    rest = shown @ slab.solid.rest
    used = np.rint(TIMES / FRAME).astype(int) * SUBSTEPS
    moved = np.zeros((len(used), len(pixels), 2))
    for index, nodes_moved in enumerate(body.displacement[used]):
        place = rest + shown @ nodes_moved
        moved[index, inside] = 4 * FOCAL * (place[:, :2] / place[:, 2:] - rest[:, :2] / rest[:, 2:])
    return moved, body.reaction[used - 1][:, nodes, :2].sum(axis=1) / YOUNG


def seen(cells: tuple[int, int, int], noise: float = 0.0) -> list[SeenFrame]:
    """Points of every frame; some beside the tool are dragged along by 3 px, as their noise says."""
    moved, _ = truth(cells)
    distance, generator = grid()[1], np.random.default_rng(8)
    near = distance < 12
    frames = []
    for frame in moved:
        told = np.where(near, 5.0, 0.1)
        frames.append(SeenFrame(frame + generator.normal(0, 1, frame.shape) * noise + 3.0 * near[:, None], told))
    return frames


def fitted(frames: list[SeenFrame]) -> PullFit:
    return fit_pull(slab_of(), CELL, point_grid(), TIMES, frames)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [SAME, OTHER])
def test_force_over_young_is_found_again(cells: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """By another law, and where the mesh is another one."""
    monkeypatch.setattr(pull_fit, "RADII", (6.0, 10.0))
    found, (_, force) = fitted(seen(cells, noise=0.1)), truth(cells)
    size = float(np.linalg.norm(force[-1]))
    off = abs(found.log_force - math.log(size))
    assert off < (0.1 if cells == SAME else 0.3)
    assert off < 1.645 * found.log_force_sd
    assert MODEL_ERRORS.pull_force < found.log_force_sd < np.hypot(MODEL_ERRORS.pull_force, 0.22)
    np.testing.assert_allclose(found.force, force @ force[-1] / size**2, atol=0.1 if cells == SAME else 0.2)
    assert (found.force[-1], found.force_sd[-1]) == (pytest.approx(1.0), 0.0)
    assert found.error < 0.1
    assert abs(found.logs[1] - found.logs[0] - math.log(DAMPING * DENSITY / YOUNG)) < 3 * found.logs_sd.sum()


def solved(frames: list[SeenFrame]) -> tuple[_Problem, np.ndarray]:
    """The problem once points are weighted, and the force at the true φ."""
    problem = _Problem(slab_of(), CELL, point_grid(), frames)
    motion, logs = PullMotion(slab_of(), CELL, problem.places, 10.0, TIMES), np.log([YOUNG, DAMPING * DENSITY])
    problem.look(motion, logs)
    return problem, problem.solve(motion, logs).force


def test_an_affine_background_changes_nothing_and_dragged_points_little() -> None:
    frames, (_, true) = seen(SAME), truth(SAME)
    problem, force = solved(frames)
    np.testing.assert_allclose(force[-1], true[-1], rtol=0.12)  # of another law
    places = grid()[0]
    tilted = [
        SeenFrame(frame.moved + number + places @ np.array([[0.01, 0.002], [-0.004, 0.02]]) * number, frame.noise)
        for number, frame in enumerate(frames)
    ]
    other, again = solved(tilted)
    np.testing.assert_allclose(again, force, atol=1e-3 * np.abs(force).max())
    assert other.scale == pytest.approx(problem.scale, rel=0.02)


def test_unseen_points_count_for_nothing() -> None:
    frames = seen(SAME)
    lost = np.random.default_rng(1).random(len(grid()[0])) < 0.2
    wild = [SeenFrame(np.where(lost[:, None], np.nan, frame.moved), frame.noise) for frame in frames]
    _, force = solved(wild)
    kept = [SeenFrame(frame.moved[~lost], frame.noise[~lost]) for frame in frames]
    points, distance = grid()
    other = _Problem(slab_of(), CELL, PointGrid(points[~lost], distance[~lost], points[:0], SPACING), kept)
    motion = PullMotion(slab_of(), CELL, other.places, 10.0, TIMES)
    logs = np.log([YOUNG, DAMPING * DENSITY])
    other.look(motion, logs)
    np.testing.assert_allclose(other.solve(motion, logs).force, force, atol=1e-6 * np.abs(force).max())
    nothing = [SeenFrame(np.full_like(frame.moved, np.nan), frame.noise) for frame in frames]
    with pytest.raises(NoEstimate, match="No followed point lies on the slab"):
        _Problem(slab_of(), CELL, point_grid(), nothing)
