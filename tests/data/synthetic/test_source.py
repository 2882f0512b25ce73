"""A synthetic clip prepared in memory equals the same clip prepared from its files."""

import dataclasses
from pathlib import Path

import numpy as np

from palpate.data.clip import prepare
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import DepthSettings
from palpate.data.settings import PrepareSettings
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import open_synthetic
from tests.data.clips import make_clip, stored

SIZE = {"width": 107, "height": 60, "grid_width": 107, "grid_height": 60}
SCENE = SceneSettings(**SIZE, frames=14, onset_fraction=(0.15, 0.2), press_seconds=(0.2, 0.2), depth_noise=0.001)
SETTINGS = PrepareSettings(
    depth=DepthSettings(source="stored"),
    geometry=GeometrySettings(height=60, width=107, smoothing=3, rigid_motion="subtract"),
    masks="annotation",
)
SEED = 4


def test_memory_and_files_give_the_same_clip(tmp_path: Path) -> None:
    clip = make_clip(SCENE, SEED)
    memory = stored(open_synthetic(clip, SETTINGS), tmp_path / "memory")
    files = prepare(write_clip(tmp_path / "set", 1, SCENE, SEED), SETTINGS, tmp_path / "cache")
    assert (memory.name, memory.status.tolist()) == (f"synthetic-{SEED}", files.status.tolist())
    onset = clip.motion.onset_frame
    assert (memory.contact & (memory.track_start == onset)).sum() >= 4
    for name in ("usable", "consecutive", "vertex", "track_start"):
        np.testing.assert_array_equal(getattr(memory, name), getattr(files, name), err_msg=name)
    for name in ("times", "normal", "noise", "displacement", "rigid", "track_position"):
        np.testing.assert_allclose(getattr(memory, name), getattr(files, name), rtol=1e-4, atol=1e-5, err_msg=name)
    for index in range(len(files)):
        np.testing.assert_allclose(memory.depth(index), files.depth(index), atol=1.1 / 65535)
    for index in np.flatnonzero(files.contact):
        first, second = memory.mesh(index), files.mesh(index)
        np.testing.assert_array_equal(first.springs, second.springs)
        np.testing.assert_array_equal(first.pixels, second.pixels)
        np.testing.assert_allclose(first.vertices, second.vertices, atol=1e-5)


def test_the_claimed_camera_is_used(tmp_path: Path) -> None:
    """A focal length said to be larger makes the sheet smaller across, not along the view."""
    shorter, longer = (
        stored(open_synthetic(make_clip(scene, SEED), SETTINGS), tmp_path / str(scene.focal_error))
        for scene in (SCENE, dataclasses.replace(SCENE, focal_error=1.25))
    )
    index = int(np.flatnonzero(shorter.contact & longer.contact)[0])
    first, second = np.ptp(shorter.mesh(index).vertices, axis=0), np.ptp(longer.mesh(index).vertices, axis=0)
    np.testing.assert_allclose(first[:2] / second[:2], 1.25, rtol=0.02)
    np.testing.assert_allclose(first[2], second[2], rtol=0.02)
