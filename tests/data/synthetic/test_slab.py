"""True motion of a slab of finite elements."""

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np
import pytest

from palpate.data.synthetic import slab
from palpate.data.synthetic.clip import draw_truth, write_clip
from palpate.data.synthetic.scene import Scene, SceneError
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.slab import GrippedSlab, PressedSlab, SlabMotion

PRESS = SceneSettings(
    width=107, height=60, grid_width=107, grid_height=60, frames=24, tissue="slab", patch_radius=(3.5, 3.5),
    peak_displacement=(1e-4, 1e-4), press_seconds=(0.6, 0.6), slab_young=(600.0, 600.0), slab_damping=(60.0, 60.0),
)  # fmt: skip
"""So small a dent that the law is linear, and so much damping that it comes to rest."""
BRIEF = dataclasses.replace(PRESS, frames=10, press_seconds=(0.12, 0.12))
PULL = dataclasses.replace(
    PRESS, action="grip", frames=12, onset_fraction=(0.0, 0.0), peak_displacement=(0.02, 0.02), max_tilt_deg=20.0
)
SEED = 7401


@pytest.fixture(autouse=True)
def _few_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slab, "CELLS", (4, 4, 2))


def drawn(settings: SceneSettings) -> tuple[Scene, SlabMotion]:
    return drawn_with(settings, slab.CELLS)


@functools.cache
def drawn_with(settings: SceneSettings, cells: tuple[int, int, int]) -> tuple[Scene, SlabMotion]:
    """A truth with as many `cells` as there are now."""
    return draw_truth(settings, SEED)


def depth_of(scene: Scene, motion: SlabMotion) -> np.ndarray:
    """How far the contact has sunk in every frame, shape [F]."""
    return -motion.contact @ scene.direction


def test_a_press_comes_to_rest_where_its_force_was_chosen_for() -> None:
    scene, motion = drawn(PRESS)
    assert isinstance(motion, PressedSlab)
    sunk = depth_of(scene, motion)
    onset, release = motion.onset_frame, motion.release_frame
    assert sunk[: onset + 1].max() == 0
    assert sunk[release] == pytest.approx(1e-4, rel=0.02)
    assert sunk[-1] < 0.3e-4
    assert (motion.force[onset:release] == motion.force[onset]).all()
    assert motion.force[onset] < 0
    assert motion.force[:onset].max() == motion.force[release:].max() == 0


@pytest.mark.slow
@pytest.mark.parametrize("damping", [30.0, 200.0])
def test_a_blunt_tips_motion_hardly_depends_on_the_mesh(damping: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """As wide a tip as the suite's, whose pictures have twice as many pixels a side."""
    wide = {"patch_radius": (4.0, 4.0), "slab_young": (200.0, 200.0), "slab_damping": (damping, damping)}
    settings, found = dataclasses.replace(PRESS, frames=14, press_seconds=(0.28, 0.28), **wide), []
    for cells in ((8, 8, 3), (12, 12, 4)):
        monkeypatch.setattr(slab, "CELLS", cells)
        scene, motion = drawn(settings)
        near = np.linalg.norm(scene.mesh.pixels[motion.moving] - scene.mesh.pixels[scene.vertex], axis=1) < 6
        found.append((motion.field[motion.onset_frame :, near] @ scene.direction, np.abs(motion.force).max()))
    (coarse, force), (fine, other) = found
    assert force == pytest.approx(other, rel=0.03)
    assert np.sqrt(np.square(coarse - fine).mean()) < 0.12 * np.sqrt(np.square(fine).mean())


def test_twice_the_modulus_and_the_density_take_twice_the_force_for_the_same_motion() -> None:
    settings = dataclasses.replace(BRIEF, peak_displacement=(0.02, 0.02))
    _, one = drawn(settings)
    _, two = drawn(dataclasses.replace(settings, slab_young=(1200.0, 1200.0), slab_density=2 * settings.slab_density))
    np.testing.assert_allclose(two.contact, one.contact, atol=1e-9)
    np.testing.assert_allclose(two.force, 2 * one.force)


def test_a_relaxing_branch_stiffens_until_it_relaxes() -> None:
    """Under a constant force a standard linear solid creeps from 1/(1 + γ) of its dent to the whole."""
    for time, share in ((100.0, 1 / 2.5), (0.005, 1.0)):
        settings = dataclasses.replace(PRESS, frames=20, slab_branch=(1.5, 1.5), slab_branch_time=(time, time))
        scene, motion = drawn(settings)
        assert depth_of(scene, motion)[motion.release_frame] == pytest.approx(share * 1e-4, rel=0.03)


def test_a_stiff_ball_takes_more_force() -> None:
    _, plain = drawn(BRIEF)
    _, stiff = drawn(dataclasses.replace(BRIEF, slab_inclusion=4.0))
    assert 1.05 < np.abs(stiff.force).max() / np.abs(plain.force).max() < 4


def test_a_slab_that_stiffens_sinks_less_under_the_same_force() -> None:
    deep = dataclasses.replace(BRIEF, peak_displacement=(0.02, 0.02))
    scene, plain = drawn(deep)
    _, stiff = drawn(dataclasses.replace(deep, slab_stiffening=100.0))
    np.testing.assert_array_equal(stiff.force, plain.force)  # what would sink a linear slab so far
    assert depth_of(scene, stiff).max() < 0.9 * depth_of(scene, plain).max()
    _, slight = drawn(dataclasses.replace(BRIEF, slab_stiffening=100.0))
    np.testing.assert_allclose(slight.contact, drawn(BRIEF)[1].contact, rtol=0, atol=1e-7)  # of 1e-4


def test_a_pull_carries_the_contact_and_takes_a_force_its_way() -> None:
    scene, motion = drawn(PULL)
    assert isinstance(motion, GrippedSlab)
    assert np.linalg.norm(motion.contact[-1]) == pytest.approx(0.02, rel=1e-3)
    assert np.abs(motion.contact[:, 2]).max() < 1e-6
    assert motion.onset_frame == 0
    way, pull = motion.contact[-1, :2], motion.reaction[-1]
    assert pull @ way / np.linalg.norm(pull) / np.linalg.norm(way) > 0.9
    far = np.linalg.norm(scene.mesh.pixels[motion.moving] - scene.mesh.pixels[scene.vertex], axis=1) > 40
    assert np.abs(motion.field[-1, far]).max() < 0.1 * 0.02


def test_a_held_pull_relaxes_as_its_branch() -> None:
    """Once the tool holds still, the force goes on falling; without a branch it stays."""
    settings, gone = dataclasses.replace(PULL, frames=20, slab_young=(4800.0, 4800.0), slab_branch_time=(0.2, 0.2)), []
    for branch, damping in ((0.0, 60.0), (1.0, 5.0)):
        law = {"slab_branch": (branch, branch), "slab_damping": (damping, damping)}
        _, motion = drawn(dataclasses.replace(settings, **law))
        size = np.linalg.norm(motion.reaction, axis=1)
        still = np.flatnonzero(np.linalg.norm(motion.contact - motion.contact[-1], axis=1) < 1e-6)[0]
        gone.append(size.max() / size[-1])
        assert still < 19
    assert gone[0] < 1.1
    assert gone[1] > 1.15


@pytest.mark.parametrize("settings", [BRIEF, dataclasses.replace(PULL, frames=8, onset_fraction=(0.2, 0.2))])
def test_a_clips_files_tell_the_slab(settings: SceneSettings, tmp_path: Path) -> None:
    folder = write_clip(tmp_path, 1, settings, SEED)
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["slab"]["young"] == pytest.approx(600)
    assert "theta" not in truth
    _, motion = drawn(settings)
    with np.load(folder / "truth.npz") as stored:
        name = "force" if isinstance(motion, PressedSlab) else "reaction"
        np.testing.assert_array_equal(stored[name], getattr(motion, name))
        assert name in truth["arrays"]


def test_slabs_that_cant_be_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneError, match="never holds"):
        draw_truth(dataclasses.replace(PULL, onset_fraction=(1.0, 1.0)), SEED)
    monkeypatch.setattr(slab, "HALF_WIDTH", 0.7)
    monkeypatch.setattr(slab, "CELLS", (6, 6, 3))
    with pytest.raises(SceneError, match="a slab folds"):
        draw_truth(PRESS, SEED)
