"""Camera, clouds, contact pair, mesh and direction of the force."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from palpate.data.contact import geometry as module
from palpate.data.contact.geometry import GeometrySettings, GeometryStatus, find_contact, frame_geometry
from palpate.data.source.camera import Camera, Rig, Undistortion, back_project, load_camera
from palpate.data.source.layout import InputError

CAMERA = Camera(100.0, 110.0, 31.5, 23.5, 64, 48)
SETTINGS = GeometrySettings(height=48, width=64)


def scene(gap_columns: int = 0, tool_depth: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Flat tissue at z = 0.5 on the left of column 40, a tool from column 40 + gap on in rows 20 to 28."""
    depth = np.full((48, 64), 0.5, np.float32)
    labels = np.zeros((48, 64), np.uint8)
    labels[:, :40] = 1
    labels[20:29, 40 + gap_columns :] = 2
    depth[labels == 2] = tool_depth
    return depth, labels


def refused(depth: np.ndarray, labels: np.ndarray, settings: GeometrySettings = SETTINGS) -> GeometryStatus:
    """Why a frame has no geometry."""
    with pytest.raises(GeometryStatus) as caught:
        frame_geometry(depth, labels, CAMERA, settings)
    assert caught.value.detail
    return caught.value


clouds = st.integers(1, 40).flatmap(
    lambda count: arrays(np.float32, (count, 3), elements=st.floats(-2, 2, width=32, allow_subnormal=False))
)


@given(tool=clouds, tissue=clouds)
@settings(deadline=None)
def test_find_contact_equals_brute_force(tool, tissue):
    first, second, distance = find_contact(tool, tissue)
    apart = np.linalg.norm(tool[:, None].astype(float) - tissue[None], axis=-1)
    assert distance == pytest.approx(apart.min(), abs=1e-12)
    assert apart[first, second] == pytest.approx(distance, abs=1e-12)


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=20)
def test_two_passes_never_beat_the_exact_search_and_find_it_on_a_line(seed):
    random = np.random.default_rng(seed)
    tool, tissue = random.normal(size=(1500, 3)), random.normal((4, 0, 0), 1, size=(200, 3))
    assert find_contact(tool, tissue, two_pass=True)[2] >= find_contact(tool, tissue)[2]
    line = np.stack((np.linspace(0, 1, 3000), np.zeros(3000), np.zeros(3000)), 1)
    point = np.array([[random.uniform(0, 1), 0.3, 0.0]])
    assert find_contact(line, point, two_pass=True)[2] == find_contact(line, point)[2]


@given(u=st.integers(0, 63), v=st.integers(0, 47), z=st.floats(0.01, 1), f=st.floats(20, 500), shift=st.floats(-5, 5))
def test_back_projection_inverts_projection(u, v, z, f, shift):
    camera = Camera(f, 1.1 * f, 31.5 + shift, 23.5, 64, 48)
    depth = np.zeros((48, 64), np.float32)
    depth[v, u] = z
    x, y, height = back_project(depth, camera)[v, u].astype(float)
    assert (camera.fx * x / height + camera.cx, camera.fy * y / height + camera.cy) == pytest.approx((u, v), abs=1e-3)
    assert height == pytest.approx(z, rel=1e-6)


def test_camera_files_and_their_errors(tmp_path):
    entries = {"fx": 100, "fy": 110, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"camera": {**entries, "distortion": [0.1, 0, 0, 0, 0]}}))
    assert load_camera(path) == Rig(100, 110, 31.5, 23.5, 64, 48, (0.1, 0.0, 0.0, 0.0, 0.0))
    # As calibration tools write it, in YAML, to which a power of ten without a point is text.
    told = tmp_path / "camera.yaml"
    told.write_text("fx: 1e2\nfy: 110.0\ncx: 31.5\ncy: '23.5'\nwidth: 64.0\nheight: 48\ndistortion: null\n")
    assert load_camera(told) == Rig(100, 110, 31.5, 23.5, 64, 48)
    for wrong, told in (
        ({"fx": 1}, r"camera\.json lacks 'fy'; give a number"),
        (entries | {"fx": -1}, r"camera\.json can't be used: The camera's focal length"),
        (entries | {"distorsion": [0.1, 0, 0, 0]}, "unknown key 'distorsion'"),
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(InputError, match=told):
            load_camera(path)
    with pytest.raises(InputError, match=r"nowhere\.yaml"):
        load_camera(tmp_path / "nowhere.yaml")


def test_undistortion_moves_a_point_to_its_pinhole_place():
    camera = Camera(100, 100, 49.5, 49.5, 100, 100, (0.2, 0.0, 0.0, 0.0, 0.0))
    x = y = 0.3  # normalised; distorted radius factor 1 + k1 r²
    factor = 1 + 0.2 * (x * x + y * y)
    labels = np.zeros((100, 100), np.uint8)
    column = round(100 * x * factor + 49.5)
    labels[column - 1 : column + 2, column - 1 : column + 2] = 2
    straight = Undistortion(camera).labels(labels)
    rows, columns = np.nonzero(straight == 2)
    assert (columns.mean(), rows.mean()) == pytest.approx((79.5, 79.5), abs=0.8)
    depth = Undistortion(camera).depth(np.full((100, 100), 0.25, np.float32))
    assert set(np.unique(depth)) <= {0.0, 0.25}


@pytest.mark.parametrize("tool_depth", [0.5, 0.9, 0.05, 0.0])
def test_touching_masks_are_in_contact_whatever_the_tools_depth(tool_depth):
    """Also without any."""
    geometry = frame_geometry(*scene(tool_depth=tool_depth), CAMERA, SETTINGS)
    u, v = geometry.pixel
    assert (geometry.touching, u in (38, 39), 18 <= v <= 30) == (True, True, True)
    assert geometry.mesh.vertices[geometry.vertex] == pytest.approx(geometry.tissue_point)
    assert geometry.normal == pytest.approx([0, 0, -1], abs=1e-6)
    apart = np.linalg.norm(geometry.tool_point - geometry.tissue_point) if tool_depth else np.nan
    assert geometry.distance == pytest.approx(apart, nan_ok=True)


def test_depth_holes_along_the_outline_fall_back_to_the_nearest_depth():
    depth, labels = scene()
    depth[:, 35:40] = 0
    assert frame_geometry(depth, labels, CAMERA, SETTINGS).pixel[0] == 34
    depth[:, 20:40] = 0
    assert refused(depth, labels).status == "bad_depth"


def test_clouds_within_the_distance_are_in_contact():
    depth, labels = scene(gap_columns=4)
    # Four columns are 5 pixels between centres, 5/100·0.5 = 0.025 scene units.
    near = frame_geometry(depth, labels, CAMERA, GeometrySettings(height=48, width=64, contact_distance=0.026))
    assert (near.touching, near.distance) == (False, pytest.approx(0.025, rel=1e-4))
    far = refused(depth, labels)
    assert (far.status, far.distance) == ("no_contact", pytest.approx(0.025, rel=1e-4))


def test_background_within_a_frayed_outline_makes_no_contact():
    depth, labels = scene(gap_columns=4, tool_depth=0.4)
    labels[18:20, 44:], labels[20:29, 42:44] = 2, 2  # two pixels of background, as deep as the tissue
    near = GeometrySettings(height=48, width=64, contact_distance=0.03)
    found = refused(depth, labels, near)
    assert found.status == "no_contact"
    assert found.distance > 0.1
    labels[20:29, 41] = 2  # where the masks touch, depth doesn't count
    assert frame_geometry(depth, labels, CAMERA, near).touching


def test_a_hovering_tool_needs_the_distance_when_the_masks_do_not_count():
    found = refused(*scene(tool_depth=0.3), GeometrySettings(height=48, width=64, contact_pixels=0))
    assert "more than" in found.detail


@pytest.mark.parametrize(
    ("change", "status"),
    [
        (lambda depth, labels: labels.__setitem__(labels == 2, 0), "no_tool"),
        (lambda depth, labels: labels.__setitem__(labels == 1, 0), "no_tissue"),
        (lambda depth, labels: labels[:, 3:40].fill(0) or labels[1:, :3].fill(0), "no_tissue"),  # three pixels
        (lambda depth, labels: depth.fill(0), "bad_depth"),
        (lambda depth, labels: depth.__setitem__((slice(None), slice(0, 40, 2)), 0.99), "bad_depth"),  # no triangle
    ],
)
def test_statuses(change, status):
    depth, labels = scene()
    change(depth, labels)
    assert refused(depth, labels).status == status


def test_force_direction_follows_the_motion_and_keeps_its_sign_convention():
    """F·direction points along the motion with F < 0 for pressing and F > 0 for pulling."""
    normal, along = np.array([0.0, 0.0, -1.0]), GeometrySettings(force_direction="displacement")
    for motion, sign in ((np.array([0.01, 0, 0.02]), -1), (np.array([0.01, 0, -0.02]), 1)):
        direction = module.force_direction(normal, motion, along)
        assert np.linalg.norm(direction) == pytest.approx(1)
        assert direction @ normal > 0
        assert direction @ motion == pytest.approx(sign * np.linalg.norm(motion))


def test_force_direction_falls_back_to_the_normal():
    normal = np.array([0.0, 0.6, -0.8])
    along = GeometrySettings(force_direction="displacement")
    for motion in (None, np.zeros(3), np.full(3, 1e-6), np.full(3, np.nan)):
        assert module.force_direction(normal, motion, along) == pytest.approx(normal)
    assert module.force_direction(normal, np.array([1.0, 0, 0]), GeometrySettings()) == pytest.approx(normal)


NO_CONTACT = {"contact_pixels": 0, "contact_distance": 0}


@pytest.mark.parametrize("wrong", [{"height": 0}, {"max_edge": 0}, {"keep": 1.5}, {"contact_pixels": -1}, NO_CONTACT])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError, match="geometry"):
        GeometrySettings(**wrong)
