"""Force over E of a drawn pull: found again from points, whatever the background does and near points say."""

import functools
import math

import numpy as np
import pytest
from scipy.interpolate import BSpline

from palpate.estimators.direct.slab_motion import DENSITY, POISSON
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip import pull_fit
from palpate.estimators.grip.pull_fit import KNOTS, STEPS, PullFit, PullMotion, _Problem, fit_pull
from palpate.estimators.grip.sheet import PointGrid, SeenFrame
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.fem import Inertia, Material, simulate
from palpate.physics.fem.slab import Slab, slab_beneath
from palpate.physics.load import Grip
from palpate.physics.mesh import grid_mesh
from tests.physics.fem.test_slab import NORMAL, THICKNESS

SIDE, FOCAL = 121, 150.0
"""Of a grid of square pixels, whose middle is the contact."""
CELL = np.array([4.0, 4.0])
INSTANTS = 0.04 * np.arange(2, 11)
PLACES = np.array([[230.0, 220.0], [270.0, 250.0], [180.0, 290.0]])
LOGS = np.log([150.0, 4e4])


@functools.lru_cache
def slab_of(cells: tuple[int, int, int] = (6, 6, 2)) -> Slab:
    row, column = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    depth = 0.5 + 1e-5 * (row**2 + column * row)
    points = np.stack([column / FOCAL * depth, row / FOCAL * depth, depth], axis=-1)
    mesh = grid_mesh(points, np.ones((SIDE, SIDE), bool))
    contact = int(np.flatnonzero((mesh.pixels == SIDE // 2).all(axis=1))[0])
    return slab_beneath(mesh, contact, NORMAL, THICKNESS, cells, attached=False)


def way_of(numbers: np.ndarray, times: np.ndarray, end: float) -> np.ndarray:
    """Where a natural spline of numbers [KNOTS - 1, 2] is at some times, written out with SciPy's, shape [T, 2]."""
    tied = np.vstack([np.zeros((3, 2)), numbers, 2 * numbers[-1] - numbers[-2]])
    return BSpline(np.arange(-3.0, KNOTS + 4), tied, 3)(np.minimum(times / end * KNOTS, KNOTS - 1e-9))


def test_points_and_force_are_the_bodys_under_the_same_way() -> None:
    motion = PullMotion(slab_of(), CELL, PLACES, 10.0, INSTANTS)
    numbers = 0.01 * np.random.default_rng(4).normal(size=(KNOTS - 1, 2)).cumsum(axis=0)
    moved, held = (part @ numbers.ravel() for part in motion.at(LOGS))
    steps = motion.step * np.arange(1, KNOTS * STEPS + 1)
    assert steps[-1] == pytest.approx(INSTANTS[-1])
    way = np.pad(way_of(numbers, steps, INSTANTS[-1]), ((0, 0), (0, 1)))
    grip = Grip(motion.gripped, np.repeat(way[:, None], len(motion.gripped), axis=1))
    slab, inertia = motion.slab, Inertia(DENSITY, np.exp(LOGS[1]) / DENSITY)
    law = Material("linear", float(np.exp(LOGS[0])), POISSON)
    body = simulate(slab.solid, law, slab.held, grip, motion.step, inertia=inertia)
    shown = slab.between(((PLACES + 0.5) / CELL - 0.5)[:, ::-1])
    path = np.stack([shown @ nodes for nodes in body.displacement])
    rest = shown @ slab.solid.rest
    # First order of f x/z in pixels of four to a grid pixel.
    seen = 4 * FOCAL * (path[..., :2] / rest[:, 2:] - rest[:, :2] * path[..., 2:] / rest[:, 2:] ** 2)
    times = np.append(0.0, steps)
    expected = np.stack([[np.interp(INSTANTS, times, seen[:, i, axis]) for axis in (0, 1)] for i in range(3)])
    np.testing.assert_allclose(moved, expected.transpose(2, 0, 1), atol=1e-6 * np.abs(expected).max())
    force = body.reaction[:, motion.gripped, :2].sum(axis=1) / np.exp(LOGS[0])
    between = np.concatenate([force[:1] / 2, (force[:-1] + force[1:]) / 2, force[-1:]])
    inner = INSTANTS[-1] > INSTANTS  # at the end the last step's own counts
    expected = np.stack([np.interp(INSTANTS, times, between[:, axis]) for axis in (0, 1)], axis=-1)
    np.testing.assert_allclose(held[inner], expected[inner], atol=1e-6 * np.abs(expected).max())


def test_the_contact_moves_with_the_instrument_however_small_the_grip() -> None:
    motion = PullMotion(slab_of(), CELL, PLACES, 0.0, INSTANTS)
    np.testing.assert_array_equal(motion.gripped, slab_of().top[3:4, 3])


SPACING, FRAME, FRAMES, SUBSTEPS = 8, 0.04, 15, 2
YOUNG, DAMPING = 200.0, 20.0
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


def point_grid(lost: np.ndarray | slice = np.s_[:0]) -> PointGrid:
    """The grid without the places that are lost; none is hidden."""
    points, distance = (np.delete(part, lost, axis=0) for part in grid())
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
    """Points of every frame; some next to the tool are dragged along by 3 px, as their noise says."""
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
    assert abs(found.logs[1] - found.logs[0] - math.log(DAMPING * DENSITY / YOUNG)) < 1


def solved(frames: list[SeenFrame], points: PointGrid) -> tuple[_Problem, np.ndarray]:
    """The problem once points are weighted, and the force at the true φ."""
    problem = _Problem(slab_of(), CELL, points, frames)
    motion, logs = PullMotion(slab_of(), CELL, problem.places, 10.0, TIMES), np.log([YOUNG, DAMPING * DENSITY])
    problem.look(motion, logs)
    return problem, problem.solve(motion, logs).force


def test_an_affine_background_changes_nothing_and_dragged_points_little() -> None:
    frames, (_, true) = seen(SAME), truth(SAME)
    problem, force = solved(frames, point_grid())
    np.testing.assert_allclose(force[-1], true[-1], rtol=0.12)  # of another law
    places = grid()[0]
    tilt = 1 + places @ np.array([[0.01, 0.002], [-0.004, 0.02]])
    tilted = [SeenFrame(frame.moved + number * tilt, frame.noise) for number, frame in enumerate(frames)]
    other, again = solved(tilted, point_grid())
    np.testing.assert_allclose(again, force, atol=1e-3 * np.abs(force).max())
    assert other.scale == pytest.approx(problem.scale, rel=0.02)


def test_unseen_points_count_for_nothing() -> None:
    frames = seen(SAME)
    lost = np.random.default_rng(1).random(len(grid()[0])) < 0.2
    wild = [SeenFrame(np.where(lost[:, None], np.nan, frame.moved), frame.noise) for frame in frames]
    _, force = solved(wild, point_grid())
    kept = [SeenFrame(frame.moved[~lost], frame.noise[~lost]) for frame in frames]
    np.testing.assert_allclose(solved(kept, point_grid(lost))[1], force, atol=1e-6 * np.abs(force).max())
    nothing = [SeenFrame(np.full_like(frame.moved, np.nan), frame.noise) for frame in frames]
    with pytest.raises(NoEstimate, match="No followed point lies on the slab"):
        _Problem(slab_of(), CELL, point_grid(), nothing)
