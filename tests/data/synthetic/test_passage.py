"""Filled views: a tool in front of tissue in every frame, contact in pressed frames alone, lamps beside the lens."""

import dataclasses

import numpy as np
import pytest

from palpate.data.source.camera import back_project
from palpate.data.synthetic.clip import SyntheticClip, draw_truth
from palpate.data.synthetic.passage import Passage
from palpate.data.synthetic.render import ALBEDO, GREY, Renderer
from palpate.data.synthetic.scene import Scene, project
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.surface import deformed_view, rest_view
from palpate.data.synthetic.truth import PressedMotion, TrueMotion
from tests.data.clips import make_clip

FILLED = SceneSettings(
    width=214, height=120, frames=14, view="filled", onset_fraction=(0.3, 0.4), press_seconds=(0.2, 0.2),
    max_tilt_deg=15.0, patch_radius=(2.0, 4.0), lamp_offset=0.03, image_noise=0.0,
)  # fmt: skip
ACTIONS = ("press", "slide", "hover", "pass", "grip")


@pytest.fixture(scope="module", params=ACTIONS)
def clip(request: pytest.FixtureRequest) -> SyntheticClip:
    return make_clip(dataclasses.replace(FILLED, action=request.param), 3)


def test_outlines_overlap_in_every_frame_and_only_pressed_frames_touch(clip: SyntheticClip) -> None:
    motion, passage, rest = clip.motion, clip.motion.passage, rest_view(clip.scene)
    frames = {"press": 5, "slide": 5, "hover": 0, "pass": 0, "grip": 14 - motion.onset_frame}
    assert motion.in_contact.sum() == frames[clip.scene.settings.action]
    assert motion.field.any() == motion.in_contact.any()
    rays = back_project(np.ones((120, 214)), clip.scene.camera)
    length = np.linalg.norm(rays, axis=-1)
    for frame in range(14):
        assert (clip.labels[frame] == GREY["grasper"]).sum() > 100
        reach, apart, radius, _, sine = passage.crossed(frame, np.zeros(3), rays / length[..., None])
        far_side = (reach + np.sqrt(np.maximum(radius**2 - apart**2, 0)) / sine) / length
        gap = (deformed_view(clip.scene, motion, frame, rest).depth - far_side)[apart < radius].min()
        assert gap < passage.ball if motion.in_contact[frame] else gap > 0.002


def test_depth_is_the_tissues_beside_the_tool_and_less_at_it(clip: SyntheticClip) -> None:
    rest = rest_view(clip.scene)
    for frame in (0, 6, 13):
        tissue = deformed_view(clip.scene, clip.motion, frame, rest).depth
        tool = clip.labels[frame] == GREY["grasper"]
        np.testing.assert_allclose(clip.depth[frame][~tool], tissue[~tool], atol=1e-5)
        assert (clip.depth[frame][tool] < tissue[tool]).all()


def test_the_tip_is_on_the_tissue_in_contact_and_comes_along_the_line_of_sight(clip: SyntheticClip) -> None:
    motion, mesh = clip.motion, clip.scene.mesh
    tip, touched = motion.passage.tip, mesh.vertices[motion.touched] + motion.contact
    np.testing.assert_allclose(tip[motion.in_contact], touched[motion.in_contact], atol=1e-7)
    x, y = (tip[:, :2] / tip[:, 2:]).T
    height = clip.scene.sheet.depth(x, y) - tip[:, 2]
    assert (height[~motion.in_contact] > 0.002).all()
    if clip.scene.settings.action in ("hover", "pass"):
        assert 0.8 * clip.scene.settings.hover_height[0] < height.min() < clip.scene.settings.hover_height[1] * 1.001
    pixels = project(tip, clip.scene.grid_camera)
    assert ((pixels > 0) & (pixels < [213, 119])).all()


@pytest.mark.parametrize("masked", ["organ", "all"])
def test_the_label_map_is_of_the_organ_or_of_all_tissue(masked: str) -> None:
    clip = make_clip(dataclasses.replace(FILLED, action="hover", masked=masked), 3)
    columns, rows = np.meshgrid(np.arange(214), np.arange(120))
    organ = (clip.scene.outline.level(columns, rows) > 0) | (masked == "all")
    for labels in clip.labels:
        free = labels != GREY["grasper"]
        np.testing.assert_array_equal((labels == GREY["gallbladder"])[free], organ[free])
        assert set(np.unique(labels)) <= {GREY["grasper"], *(GREY[name] for name in ALBEDO)}


def plane(lamp_offset: float = 0.03) -> tuple[Scene, TrueMotion]:
    flat = {"curvature": (0.0, 0.0), "relief": 0.0, "highlights": 0.0, "lamp_offset": lamp_offset, "max_tilt_deg": 20.0}
    return draw_truth(dataclasses.replace(FILLED, action="hover", **flat), 1)


def test_matte_tissue_is_as_bright_as_lambert_s_law_has_it() -> None:
    scene, motion = plane()
    scene = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, tool_in_view=False))
    renderer = Renderer(scene, motion, np.random.default_rng(0))
    normal = scene.sheet.normal
    points = renderer.rays * renderer.rest.depth[..., None]
    expected = np.zeros(points.shape[:2])
    for lamp in renderer.lamps:
        assert np.linalg.norm(lamp) == pytest.approx(0.03)
        towards = lamp - points
        distance = np.linalg.norm(towards, axis=-1)
        expected += towards @ normal / distance * 0.5**2 / distance**2 / 2
    light = renderer._lit_tissue(0, renderer.rest) / renderer.albedo
    np.testing.assert_allclose(light[2:-2, 2:-2], np.repeat(expected[2:-2, 2:-2, None], 3, axis=2), rtol=2e-3)


def test_light_is_lost_towards_the_corners() -> None:
    scene, motion = plane()
    scene = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, vignetting=0.4))
    gain = Renderer(scene, motion, np.random.default_rng(0)).gain
    assert (gain[0, 0, 0], gain[60, 107, 0]) == (pytest.approx(0.6), pytest.approx(1.0, abs=1e-3))


@pytest.mark.parametrize("height", [0.01, 0.05])
def test_a_shadow_lies_where_the_line_from_lamp_through_tip_ends(height: float) -> None:
    """A thin tool over a plane across the view, pointing away from the camera: its shadow leads away from the lamp."""
    lamp, place, ball = np.array([0.03, 0.0, 0.0]), np.array([0.0, 0.0, 0.5]), 0.004
    tip = place - [0, 0, height]
    passage = Passage(tip[None], np.array([0.0, 0.0, -1.0]), ball, 1e3)
    center = tip - [0, 0, ball]
    shadow = lamp + (center - lamp) * (0.5 / center[2])
    assert shadow[0] == pytest.approx(-0.03 * (height + ball) / (0.5 - height - ball))
    blur = 0.006 * (height + ball) / (0.5 - height - ball) + ball
    points = shadow + (1.1 * blur + ball) * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(passage.lit(0, lamp, points), [0.0, 1.0, 1.0])


def test_a_slide_takes_the_whole_force_along() -> None:
    """Springs push and pull alike, so that displacements add up to those of one mass in a fluid."""
    scene, motion = draw_truth(dataclasses.replace(FILLED, action="slide", travel=(8.0, 8.0)), 3)
    assert isinstance(motion, PressedMotion)
    path = scene.mesh.pixels[motion.touched] - scene.mesh.pixels[scene.vertex]
    onset, release = motion.onset_frame, motion.release_frame
    assert not path[: onset + 1].any()
    np.testing.assert_allclose(np.linalg.norm(path[onset : release + 1], axis=1), 8 * np.arange(6) / 5, atol=0.8)
    total = motion.field[onset : release + 1].astype(float).sum(axis=1)
    (_, damping, force), time = motion.theta, np.arange(6) / 25
    lag = scene.settings.mass / damping
    expected = force / damping * (time - lag * (1 - np.exp(-time / lag)))
    np.testing.assert_allclose(total, expected[:, None] * scene.direction, atol=2e-3 * np.abs(expected).max())
    deepest = scene.mesh.pixels[motion.moving[(motion.field[release] @ -scene.direction).argmax()]]
    along = (deepest - scene.mesh.pixels[scene.vertex]) @ path[release] / np.linalg.norm(path[release])
    assert 1.5 < along < 8


@pytest.mark.parametrize("change", [{"action": "slide"}, {"action": "hover"}, {"masked": "all"}])
def test_an_island_has_no_such_view(change: dict) -> None:
    with pytest.raises(ValueError, match=r"give scene\.view filled"):
        SceneSettings(**change)
