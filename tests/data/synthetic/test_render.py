"""Pictures, masks and depth of synthetic scenes against the geometry that they show."""

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.geometry import GeometrySettings, GeometryStatus, frame_geometry
from palpate.data.synthetic.clip import SyntheticClip, synthetic_clip
from palpate.data.synthetic.render import GREY, Renderer, encode_srgb
from palpate.data.synthetic.scene import Scene, draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.surface import SheetView, deformed_view, rest_view
from palpate.data.synthetic.tool import tip_offset
from palpate.data.synthetic.truth import TrueMotion, simulate_motion
from tests.data.clips import make_clip

COURSE = {"frames": 24, "onset_fraction": (0.15, 0.2), "press_seconds": (0.2, 0.3)}
SMALL = SceneSettings(width=214, height=120, **COURSE, image_noise=0.0)
DOUBLE = dataclasses.replace(SMALL, width=428, height=240)
FLAT = dataclasses.replace(SMALL, curvature=(0.0, 0.0), relief=0.0)
THETA = np.array([0.5, 0.03, -0.06])
ONSET, RELEASE = 4, 12


@pytest.fixture(scope="module", params=[SMALL, DOUBLE], ids=["grid size", "double size"])
def case(request: pytest.FixtureRequest) -> tuple[Scene, TrueMotion, SheetView]:
    scene = draw_scene(request.param, np.random.default_rng(2))
    return scene, simulate_motion(scene, THETA, ONSET, RELEASE), rest_view(scene)


@pytest.fixture(scope="module")
def clip() -> SyntheticClip:
    return make_clip(SMALL, 5)


def tissue_tool(labels: np.ndarray) -> np.ndarray:
    return np.select([labels == GREY["gallbladder"], labels == GREY["grasper"]], [1, 2], 0).astype(np.uint8)


def projected(scene: Scene, motion: TrueMotion, frame: int) -> np.ndarray:
    """Columns, rows [px of the picture] and z of the moving vertices, shape [3, M]."""
    points = scene.mesh.vertices[motion.moving].astype(float) + motion.field[frame]
    x, y, z = points.T
    return np.stack((x / z * scene.camera.fx + scene.camera.cx, y / z * scene.camera.fy + scene.camera.cy, z))


def test_the_rest_depth_of_a_plane_is_the_planes() -> None:
    scene = draw_scene(dataclasses.replace(FLAT, max_tilt_deg=20.0), np.random.default_rng(0))
    camera, normal = scene.camera, scene.sheet.normal
    contact = scene.sheet.distance * np.append(scene.sheet.contact_ray, 1)
    columns, rows = np.meshgrid(np.arange(214), np.arange(120))
    rays = np.stack(((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones((120, 214))), -1)
    np.testing.assert_allclose(rest_view(scene).depth, (normal @ contact) / (rays @ normal), atol=1e-6)


def test_deformed_depth_is_that_of_the_vertices(case: tuple[Scene, TrueMotion, SheetView]) -> None:
    scene, motion, rest = case
    frame = RELEASE
    view = deformed_view(scene, motion, frame, rest)
    columns, rows, depth = projected(scene, motion, frame)
    contact = np.flatnonzero(motion.moving == scene.vertex)[0]
    seen = view.depth[round(rows[contact]), round(columns[contact])]
    assert depth[contact] - scene.mesh.vertices[scene.vertex, 2] > 0.01
    assert seen == pytest.approx(depth[contact], abs=1e-4)
    still = np.abs(motion.field[frame]).max(axis=1) < 1e-6
    errors = np.abs(view.depth[np.rint(rows).astype(int), np.rint(columns).astype(int)] - depth)
    assert np.quantile(errors[~still], 0.9) < 1e-3
    if scene.settings.width == 214:
        assert errors[still].max() < 1e-4


def test_visible_points_are_where_their_rest_points_went(case: tuple[Scene, TrueMotion, SheetView]) -> None:
    scene, motion, rest = case
    view = deformed_view(scene, motion, RELEASE, rest)
    outside = np.ones_like(view.depth, bool)
    outside[view.region] = False
    for name in ("depth", "rest_u", "rest_v"):
        np.testing.assert_array_equal(getattr(view, name)[outside], getattr(rest, name)[outside])
    columns, rows, _ = projected(scene, motion, RELEASE)
    pixels = scene.mesh.pixels[motion.moving] + 0.5
    moved = columns - (pixels[:, 1] * scene.settings.cell[0] - 0.5)
    at = np.rint(rows).astype(int), np.rint(columns).astype(int)
    flow = (rest.rest_u - view.rest_u)[at]
    smooth = np.abs(moved) < 0.2
    assert np.abs(flow - moved)[smooth].max() < 0.5


def test_a_frame_at_rest_is_the_rest_view(case: tuple[Scene, TrueMotion, SheetView]) -> None:
    scene, motion, rest = case
    assert deformed_view(scene, motion, ONSET, rest) is rest


def test_masks_partition_the_picture(clip: SyntheticClip) -> None:
    assert set(np.unique(clip.labels)) <= {GREY[n] for n in ("gallbladder", "liver", "abdominal wall", "grasper")}
    assert (clip.labels == GREY["gallbladder"]).sum(axis=(1, 2)).min() > 5000
    assert 0.1 < clip.depth.min() < clip.depth.max() < 1


@pytest.mark.parametrize("seed", range(2))
def test_contact_is_found_in_exactly_the_frames_of_contact(seed: int) -> None:
    clip = make_clip(SMALL, seed)
    scene, motion = clip.scene, clip.motion
    settings = GeometrySettings()
    for frame in range(SMALL.frames):
        labels = tissue_tool(clip.labels[frame])
        if motion.onset_frame <= frame < motion.release_frame:
            geometry = frame_geometry(clip.depth[frame], labels, clip.camera, settings)
            assert (geometry.touching, tip_offset(scene, motion, frame).any()) == (True, False)
            assert geometry.distance < 0.01
        else:
            with pytest.raises(GeometryStatus, match=r"more than|fewer than"):
                frame_geometry(clip.depth[frame], labels, clip.camera, settings)
        if frame == motion.onset_frame:
            row, column = scene.mesh.pixels[scene.vertex]
            assert geometry.pixel == (column, row)
            assert geometry.normal @ scene.direction > np.cos(np.radians(2))


def test_light_falls_with_the_square_of_the_distance(clip: SyntheticClip) -> None:
    means = []
    for distance in (0.4, 0.6):
        flat = dataclasses.replace(FLAT, distance=(distance, distance), highlights=0.0)
        scene = draw_scene(flat, np.random.default_rng(0))
        renderer = Renderer(scene, clip.motion, np.random.default_rng(0))  # at rest, whatever the motion
        means.append(renderer._tissue_light(renderer.rest, np.s_[0:120, 0:214], np.zeros(3, np.float32)).mean())
    assert means[0] / means[1] == pytest.approx((0.6 / 0.4) ** 2, rel=1e-3)


def test_srgb_curve() -> None:
    linear = np.array([0.0, 0.001, 0.0031308, 0.18, 0.5, 1.0])
    expected = np.array([0.0, 0.01292, 0.04045, 0.46136, 0.73536, 1.0])
    np.testing.assert_allclose(encode_srgb(linear), expected, atol=5e-4)


def test_image_noise_has_the_wanted_size(clip: SyntheticClip) -> None:
    noisy = dataclasses.replace(clip.scene, settings=dataclasses.replace(SMALL, image_noise=0.02))
    images = synthetic_clip(noisy, clip.motion, 5).images.astype(float)
    # Two frames before contact differ by noise and the tool, which stays in its part of the picture.
    assert np.median(np.abs(images[0] - images[1])) / 255 == pytest.approx(0.6745 * np.sqrt(2) * 0.02, rel=0.1)


def test_occlusion_hides_its_share_of_the_tissue(clip: SyntheticClip) -> None:
    hidden, bare = make_clip(dataclasses.replace(SMALL, occlusion=0.2), 5), clip
    tissue = (bare.labels == GREY["gallbladder"]).sum()
    fat = hidden.labels == GREY["fat"]
    assert (fat & (bare.labels == GREY["gallbladder"])).sum() / tissue == pytest.approx(0.2, abs=0.03)
    assert (hidden.depth[fat] < bare.depth[fat]).all()
    np.testing.assert_array_equal(hidden.motion.contact, bare.motion.contact)


def test_shading_has_no_seam_around_the_moving_region(case: tuple[Scene, TrueMotion, SheetView]) -> None:
    scene, motion, rest = case
    renderer = Renderer(scene, motion, np.random.default_rng(0))
    rows, columns = deformed_view(scene, motion, RELEASE, rest).region
    light = renderer._tissue_light(rest, (rows, columns), np.zeros(3, np.float32))
    np.testing.assert_allclose(light, renderer.rest_lights[0][rows, columns], atol=2e-3)
