"""True motion of gripped tissue."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from palpate.data.synthetic.clip import draw_truth, write_clip
from palpate.data.synthetic.grip import GRIP_RADIUS, MARGIN_PX, GrippedMotion, edge_anchor, lattice_matrix
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.tool import tip_offset
from palpate.physics.sheet import equilibrium
from tests.data.clips import make_clip

GRIP = SceneSettings(
    width=107, height=60, grid_width=107, grid_height=60, frames=12, action="grip", onset_fraction=(0.0, 0.0),
    spread=(8.0, 8.0), relaxation=(1e-3, 1e-3),
)  # fmt: skip
SEED = 7401


@pytest.fixture(scope="module")
def truth() -> tuple[Scene, GrippedMotion]:
    return draw_truth(GRIP, SEED)


def in_picture(scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """Displacement of the vertices in the picture, shape [F, N, 2] [grid px]."""
    rest = scene.mesh.vertices.astype(np.float64)
    focal = np.array([scene.grid_camera.fx, scene.grid_camera.fy])
    moved = rest + motion.field
    return focal * (moved[..., :2] / moved[..., 2:] - rest[..., :2] / rest[..., 2:])


def test_the_lattice_is_that_of_a_sheet_at_rest() -> None:
    generator = np.random.default_rng(0)
    rows, columns, anchor = 5, 7, 0.3
    number = np.arange(rows * columns).reshape(rows, columns)
    springs = [
        (number[row, column], number[row + down, column + right])
        for row in range(rows)
        for column in range(columns)
        for down, right in ((1, 0), (0, 1), (1, 1), (1, -1))
        if row + down < rows and 0 <= column + right < columns
    ]
    held = generator.random(rows * columns) < 0.2
    motion = generator.standard_normal((held.sum(), 2))
    log = generator.standard_normal(rows * columns)
    stiffness = np.exp(log[np.array(springs)].mean(axis=1))
    expected = equilibrium(np.array(springs), stiffness, np.full(rows * columns, anchor), held, motion).matrix
    found = lattice_matrix(log.reshape(rows, columns), anchor)
    np.testing.assert_allclose(found.toarray(), expected.toarray(), atol=1e-12)


def test_tissue_goes_on_beyond_what_is_integrated() -> None:
    """A pull whose motion dies away over 20 nodes, integrated to 14 beyond a picture of 44, against three times as far.

    Root mean square error in the picture; with a free edge it is 20 times as large.
    """
    anchor = 3 / 20**2

    def pulled(side: int, held: bool) -> np.ndarray:
        still, force = np.zeros((side, side)), np.zeros((side, side))
        force[side // 2, side // 2] = 1.0
        edge = edge_anchor(still, anchor, np.array([side // 2] * 2)) if held else 0.0
        moved = spsolve(lattice_matrix(still, anchor + edge).tocsc(), force.ravel()).reshape(side, side)
        return moved[side // 2 - 22 : side // 2 + 23, side // 2 - 22 : side // 2 + 23]

    far = pulled(219, True)
    held, free = (np.linalg.norm(pulled(73, edge) - far) / np.linalg.norm(far) for edge in (True, False))
    assert held < 0.002
    assert free > 0.1


def test_a_slow_grip_is_an_equilibrium(truth: tuple[Scene, GrippedMotion]) -> None:
    scene, motion = truth
    rows, columns = (side + 2 * MARGIN_PX for side in scene.mesh.grid_shape)
    still = np.zeros((rows, columns))
    place = scene.mesh.pixels[scene.vertex] + MARGIN_PX
    matrix = lattice_matrix(still, motion.anchor + edge_anchor(still, motion.anchor, place))
    row, column = np.mgrid[:rows, :columns]
    held = (np.hypot(row - place[0], column - place[1]) <= GRIP_RADIUS).ravel()
    inner = np.zeros((rows, columns), bool)
    inner[tuple(scene.mesh.pixels.T + MARGIN_PX)] = True
    free = ~held
    moved = in_picture(scene, motion)
    for frame in (6, 11):
        at_rest = np.zeros((rows * columns, 2))
        at_rest[held] = moved[frame, scene.vertex]
        at_rest[free] = spsolve(matrix[free][:, free].tocsc(), -matrix[free][:, held] @ at_rest[held])
        # Damping over foundation is a 40th of a frame.
        np.testing.assert_allclose(moved[frame], at_rest[inner.ravel()], atol=0.02 * np.abs(at_rest).max())
        # In equilibrium the foundation holds what the grip pulls.
        pull = motion.anchor * at_rest.sum(axis=0) * scene.spacing
        np.testing.assert_allclose(motion.reaction[frame], pull, atol=0.03 * np.linalg.norm(pull))


def test_damping_lets_the_tissue_lag_behind(truth: tuple[Scene, GrippedMotion]) -> None:
    scene, slow = truth
    _, lagging = draw_truth(dataclasses.replace(GRIP, relaxation=(0.05, 0.05)), SEED)
    assert lagging.damping == pytest.approx(50 * slow.damping)
    np.testing.assert_allclose(lagging.contact, slow.contact, atol=1e-9)
    far = np.abs(scene.mesh.pixels - scene.mesh.pixels[scene.vertex]).max(axis=1) > 8
    for frame in (3, 5):
        assert np.abs(lagging.field[frame, far]).sum() < 0.8 * np.abs(slow.field[frame, far]).sum()


def test_the_tool_is_where_the_gripped_tissue_is(truth: tuple[Scene, GrippedMotion]) -> None:
    scene, motion = truth
    assert motion.in_contact.all()
    assert not motion.contact[0].any()
    length = np.linalg.norm(motion.contact[-1])
    assert GRIP.peak_displacement[0] * 0.99 < length < GRIP.peak_displacement[1] * 1.01
    assert not motion.course.any()
    near = np.hypot(*(scene.mesh.pixels - scene.mesh.pixels[scene.vertex]).T) <= GRIP_RADIUS
    moved = in_picture(scene, motion)
    np.testing.assert_allclose(moved[:, near], moved[:, [scene.vertex]].repeat(near.sum(), axis=1), atol=1e-4)


def test_a_tool_that_never_touches_moves_nothing() -> None:
    clip = make_clip(dataclasses.replace(GRIP, onset_fraction=(1.0, 1.0)), SEED)
    motion = clip.motion
    assert not motion.in_contact.any()
    assert not motion.field.any()
    tips = np.array([tip_offset(clip.scene, motion, frame) for frame in range(12)])
    assert np.linalg.norm(tips[-1] - tips[0]) > 15
    # It passes over the place, and never lies on the tissue.
    assert np.linalg.norm(tips, axis=1).min() < 5
    tool = clip.labels == 31
    assert tool.any(axis=(1, 2)).all()
    camera = clip.scene.camera
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rest = clip.scene.sheet.depth((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy)
    assert (rest[None].repeat(12, axis=0)[tool] - clip.depth[tool]).min() > 0.02


def test_a_stiffer_region_lets_the_motion_reach_farther(truth: tuple[Scene, GrippedMotion]) -> None:
    scene, even = truth
    _, motion = draw_truth(dataclasses.replace(GRIP, regions=3.0), SEED)
    log = motion.log_stiffness
    assert (log.mean(), np.ptp(log)) == (pytest.approx(0), pytest.approx(np.log(3), abs=1e-3))
    assert not even.log_stiffness.any()
    # Along the line between the regions as far away on either side.
    row, column = scene.mesh.pixels.T
    apart = np.hypot(*(scene.mesh.pixels - scene.mesh.pixels[scene.vertex]).T)
    change = np.linalg.norm(motion.field[-1], axis=1) / np.linalg.norm(even.field[-1], axis=1)
    ring = (apart > 12) & (apart < 20)
    stiff = log[row, column] > log.max() - 0.1
    assert change[ring & stiff].mean() > 1.2 * change[ring & (log[row, column] < log.min() + 0.1)].mean()


def test_a_tool_that_comes_and_grips_is_continuous(tmp_path: Path) -> None:
    settings = dataclasses.replace(GRIP, frames=24, onset_fraction=(0.5, 0.5))
    folder = write_clip(tmp_path, 1, settings, SEED)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert truth["contact"] == [False] * 12 + [True] * 12
    field, course = (np.load(folder / "truth.npz")[name] for name in ("field", "course"))
    assert (field[:13].any(), field[13].any()) == (False, True)
    assert (course[12:].any(), course[0].any()) == (False, True)
    assert np.linalg.norm(np.diff(course, axis=0), axis=1).max() < 8
