"""The per-frame path, its statuses, the observed motion, and the cache."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.data.clip import ClipStream, prepare
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.tips import JAWS
from palpate.data.contact.tissue_points import grid_to_picture, lift, rigid_motion
from palpate.data.labels import TISSUE, TOOL, UNSURE
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from palpate.data.windows import FrameWindow, future_indices, window_indices
from tests.conftest import CHECKOUT
from tests.data import clips
from tests.data.clips import FOCAL, GRID, SETTINGS, describe, remove_depth, remove_frame, write_clip


def run(folder: Path, settings: PrepareSettings = SETTINGS) -> list:
    return list(ClipStream(open_source(folder, settings.layout), settings))


def statuses(frames: list) -> str:
    return " ".join(frame.status for frame in frames)


def starts(frames: list) -> list[int]:
    return [frame.track_start for frame in frames]


def test_statuses_runs_and_positions_of_a_clean_clip(tmp_path):
    frames = run(write_clip(tmp_path / "video01_00000"))
    assert statuses(frames) == " ".join(["no_tool"] * 3 + ["ok"] * 5 + ["no_tool"] * 4)
    assert (starts(frames), [frame.consecutive for frame in frames]) == ([-1] * 3 + [3] * 9, [True] * 11 + [False])
    first = frames[3]
    assert first.geometry.pixel[0] == 43  # last tissue column on the grid
    assert first.track_position == pytest.approx(first.geometry.tissue_point, abs=1e-6)
    assert first.depth.dtype == np.float32
    assert first.depth[0, 0] == pytest.approx(0.5 + 3 * clips.DEPTH_STEP + 0.5 * clips.SLOPE, abs=1e-5)


def test_the_grid_takes_for_tissue_what_the_mask_is_unsure_of(tmp_path, monkeypatch):
    folder = write_clip(tmp_path / "video01_00000")
    expected, stream = run(folder)[4], ClipStream(open_source(folder, SETTINGS.layout), SETTINGS)
    read = type(stream._masks).__call__

    def unsure(masks, frame):
        labels = read(masks, frame)
        return np.where(labels == TISSUE, UNSURE, labels)

    monkeypatch.setattr(type(stream._masks), "__call__", unsure)
    found = list(stream)[4]
    np.testing.assert_array_equal(found.labels, expected.labels)
    np.testing.assert_array_equal(found.picture_labels == UNSURE, expected.picture_labels == TISSUE)


def test_observed_motion_follows_the_tissue(tmp_path):
    folder = write_clip(tmp_path / "video01_00000", shift=1.0)
    frames = run(folder)
    for t in (4, 5):
        z, next_z = frames[t].geometry.tissue_point[2], frames[t + 1].geometry.tissue_point[2]
        u = grid_to_picture(np.array(frames[t].geometry.pixel), (48, 64), (128, 96))[0]
        expected_x = ((u - 1 - 63.5) * next_z - (u - 63.5) * z) / FOCAL
        # A fifth of a pixel of flow is 0.001 here.
        assert frames[t].displacement == pytest.approx([expected_x, 0, clips.DEPTH_STEP], abs=1e-3)
        assert frames[t + 1].backward[2] == pytest.approx(-clips.DEPTH_STEP, abs=1e-4)
    assert frames[9].track_position[2] - frames[3].track_position[2] == pytest.approx(6 * clips.DEPTH_STEP, abs=2e-4)
    # Re-detection sticks to the outline, which does not move.
    again = run(folder, replace(SETTINGS, geometry=replace(GRID, displacement="redetected")))
    expected = again[5].geometry.tissue_point - again[4].geometry.tissue_point
    assert again[4].displacement == pytest.approx(expected, abs=1e-7)
    assert again[5].backward == pytest.approx(-expected, abs=1e-7)


def test_rigid_motion_is_measured_and_can_be_subtracted(tmp_path):
    folder = write_clip(tmp_path / "video01_00000", shift=1.0, recede=0.0)
    frames = run(folder)
    step = -0.504 / FOCAL  # one pixel at the contact's depth
    for t in (4, 5):
        assert frames[t].displacement == pytest.approx([step, 0, 0], abs=1e-3)
        assert frames[t].rigid == pytest.approx([step, 0, 0], abs=1e-3)
    assert (frames[9].track_position - frames[3].track_position)[0] == pytest.approx(6 * step, abs=3e-3)
    still = run(folder, replace(SETTINGS, geometry=replace(GRID, rigid_motion="subtract")))
    assert still[4].displacement == pytest.approx(np.zeros(3), abs=1e-3)
    assert np.linalg.norm(still[9].track_position - still[3].track_position) < 3e-3


@pytest.mark.parametrize(
    ("contact", "settings", "expected"),
    [
        ((3, 4, 5, 6, 7), {"track_seconds": 0.2}, [-1] * 3 + [3] * 7 + [-1] * 2),
        ((2, 3, 5, 9, 10), {}, [-1] * 2 + [2] * 7 + [9] * 3),
        ((2, 3, 5, 9, 10), {"bridge_frames": 0}, [-1] * 2 + [2] * 3 + [5] * 4 + [9] * 3),
        ((0, 1, 2, 8, 9), {}, [-1] * 8 + [8] * 4),
    ],
    ids=["it ends after 0.2 s and the bridge", "flicker is bridged", "or not", "from the first frame without onset"],
)
def test_runs_of_contact_are_followed_from_their_onset(tmp_path, contact, settings, expected):
    frames = run(write_clip(tmp_path / "clip", contact=contact), replace(SETTINGS, **settings))
    assert (starts(frames), np.isfinite(frames[0].displacement).all()) == (expected, (0 in contact))


def test_stages_that_overlap_give_the_same_frames(tmp_path):
    folder = write_clip(tmp_path / "clip")
    spoil(folder)
    overlapped = list(ClipStream(open_source(folder, SETTINGS.layout), SETTINGS).overlapped())
    for one, other in zip(overlapped, run(folder), strict=True):
        assert (one.status, one.detail, one.track_start) == (other.status, other.detail, other.track_start)
        for name in ("depth", "labels", "displacement", "backward", "rigid", "track_position"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_guessed_depth_is_found_in_one_of_so_many_frames_and_kept_in_between(tmp_path):
    folder = write_clip(tmp_path / "video01_00000", shift=1.0)
    guessed = replace(SETTINGS, depth=replace(SETTINGS.depth, source="photometric"))
    each, some = run(folder, guessed), run(folder, replace(guessed, every=3))
    for index, (one, kept) in enumerate(zip(each, some, strict=True)):
        assert np.array_equal(kept.depth, each[index // 3 * 3].depth)
        assert np.array_equal(kept.labels, one.labels)
    assert not np.array_equal(each[4].depth, each[3].depth)
    measured = run(folder, replace(SETTINGS, every=3))
    assert all(np.array_equal(one.depth, two.depth) for one, two in zip(measured, run(folder), strict=True))


def test_by_guessed_depth_a_contact_lies_at_the_jaws_wherever_a_shaft_seems_to_touch(tmp_path):
    labels = np.full((320, 428), TISSUE, np.uint8)
    labels[150:166, :300] = TOOL
    settings = replace(SETTINGS, geometry=replace(GRID, width=214, height=160))
    settings = replace(settings, depth=replace(settings.depth, source="photometric"))
    stream = ClipStream(open_source(write_clip(tmp_path / "video01_00000"), settings.layout), settings)
    for seed in range(5):
        noise = np.random.default_rng(seed).integers(40, 220, (8, 11), np.uint8)
        image = np.repeat(cv2.resize(noise, (428, 320), interpolation=cv2.INTER_CUBIC)[..., None], 3, axis=2)
        column, row = stream.prepared(Frame(0, 0, 0.0, image), labels).contact.pixel
        assert 150 - JAWS - 3 <= column <= 150 + 3
        assert 75 - 3 <= row <= 83 + 3


def spoil(folder: Path) -> None:
    """One defect a frame."""
    (folder / "frame_1_endo.png").write_bytes(b"")
    cv2.imwrite(str(folder / "frame_2_endo.png"), np.zeros((50, 60, 3), np.uint8))
    (folder / "frame_4_endo_color_mask.png").unlink()
    remove_depth(folder, 5)
    cv2.imwrite(str(folder / "frame_6_endo_color_mask.png"), np.zeros((20, 20, 3), np.uint8))
    three = np.zeros((96, 128, 3), np.uint8)
    three[40:56, 88:] = (0, 255, 170)
    three[40, 85:88] = (165, 160, 255)
    cv2.imwrite(str(folder / "frame_7_endo_color_mask.png"), three)


def test_every_bad_frame_gets_a_status_and_a_sentence_and_none_is_lost(tmp_path):
    folder = write_clip(tmp_path / "clip")
    spoil(folder)
    frames = run(folder)
    expected = "no_tool unreadable unreadable ok no_mask bad_depth no_mask no_tissue no_tool no_tool no_tool no_tool"
    assert statuses(frames) == expected
    for frame in frames:
        assert bool(frame.detail) == (frame.status != "ok")
    assert "60x50 while the clip is 128x96" in frames[2].detail
    assert "zero everywhere" in frames[5].detail
    assert [frame.has_depth for frame in frames[4:6]] == [True, False]


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 0.5])
def test_a_clip_without_any_usable_depth_gives_rows_not_an_error(tmp_path, value):
    folder = write_clip(tmp_path / "clip", frames=5, contact=(2, 3))
    for index in range(5):
        np.save(folder / f"frame_{index}_endo_depth.npy", np.full((96, 128), value, np.float32))
    (folder / "clip.json").unlink()
    settings = replace(SETTINGS, layout=ClipLayout(depth="frame_{number}_endo_depth.npy"))
    frames = run(folder, settings)
    assert statuses(frames) == "no_tool no_tool bad_depth bad_depth no_tool"
    assert frames[2].detail


def test_depth_in_another_unit_than_its_scale_is_bad_depth_not_a_flat_wall(tmp_path):
    folder = write_clip(tmp_path / "clip", frames=4, contact=(1, 2))
    describe(folder, depth_scale=0.001)
    frames = run(folder)
    assert statuses(frames) == "no_tool bad_depth bad_depth no_tool"
    assert "beyond the clip's scale of 0.001 (median 0.50" in frames[1].detail
    assert "depth_scale in clip.json" in frames[1].detail
    assert not any(frame.has_depth for frame in frames)


def test_a_camera_of_another_resolution_is_scaled_and_one_of_another_shape_refused(tmp_path):
    folder = write_clip(tmp_path / "clip", frames=5)
    camera = {"fx": 2 * FOCAL, "fy": 2 * FOCAL, "cx": 127.5, "cy": 95.5, "width": 256, "height": 192}
    squeezed = camera | {"fx": FOCAL, "cx": 63.5, "width": 128}  # whose pictures were stretched since
    for of_all in (camera, squeezed):
        describe(folder, camera=of_all)
        clip = ClipStream(open_source(folder, ClipLayout()), SETTINGS)
        assert (clip.picture_camera.fx, clip.picture_camera.fy) == pytest.approx((FOCAL, FOCAL))
    describe(folder, camera=camera | {"width": 192, "height": 256})  # of a telephone that was turned
    said = "has pictures of 128x96, and its camera is of 192x256, another shape; give the camera of these pictures"
    with pytest.raises(InputError, match=said):
        ClipStream(open_source(folder, ClipLayout()), SETTINGS)


def test_distortion_is_removed_from_picture_labels_and_depth(tmp_path):
    folder = write_clip(tmp_path / "clip", frames=5)
    camera = {"fx": FOCAL, "fy": FOCAL, "cx": 63.5, "cy": 47.5, "width": 128, "height": 96}
    describe(folder, camera=camera | {"distortion": [2.0, 0, 0, 0, 0]})
    clip = ClipStream(open_source(folder, ClipLayout()), SETTINGS)
    frames = list(clip)
    assert (clip.camera.distortion, frames[3].status) == ((), "ok")
    # Column 87.5 is 0.24 from the axis, which is the distorted place of x with x·(1 + 2x²) = 0.24: x = 0.218.
    row = frames[3].picture_labels[48]
    assert np.flatnonzero(row == 1).max() == pytest.approx(63.5 + 21.8, abs=1)


def test_windows_repeat_the_first_frame_hold_bad_ones_and_stop_at_gaps():
    consecutive = np.array([True, True, False, True, True, False])
    usable = np.array([True, False, True, True, True, True])
    for index, count, expected in ((2, 4, [0, 0, 0, 2]), (4, 4, [3, 3, 3, 4]), (5, 2, [4, 5])):
        assert window_indices(index, count, consecutive, usable).tolist() == expected
    for index, count, expected in ((3, 4, [5, 5, 4, 3]), (0, 2, [0, 0])):
        assert future_indices(index, count, consecutive, usable).tolist() == expected
    assert window_indices(1, 1, consecutive, usable) is None


def test_streamed_windows_equal_those_of_training(tmp_path):
    folder = write_clip(tmp_path / "clip", first=5)
    remove_depth(folder, 9)
    remove_frame(folder, 12)
    clip, window = prepare(folder, SETTINGS, tmp_path / "cache"), FrameWindow(3)
    for index, frame in enumerate(run(folder)):
        indices = window_indices(index, 3, clip.consecutive, clip.usable)
        assert np.array_equal(window.push(frame), np.stack([clip.depth(i) for i in indices]))


def test_lift_reads_tissue_only():
    from tests.data.contact.test_geometry import CAMERA, scene

    depth, labels = scene(tool_depth=0.9)
    depth[:, :40] += np.arange(40) * 0.001
    points = lift(np.array([[30.0, 24.0], [44.0, 24.0], [60.0, 5.0]]), depth, labels, CAMERA)
    assert points[0, 2] == pytest.approx(0.53)
    assert points[1, 2] == pytest.approx(0.539)  # the tool is there; nearest tissue
    assert np.isnan(points[2]).all()
    between = lift(np.array([[30.4, 24.0]]), depth, labels, CAMERA)
    assert between[0] == pytest.approx([0.53 * (30.4 - 31.5) / 100, 0.53 * 0.5 / 110, 0.53], abs=1e-6)


def test_rigid_motion_is_recovered_despite_a_deforming_part():
    before, at = np.random.default_rng(0).uniform(-0.5, 0.5, (60, 3)), np.array([0.2, 0.1, 0.5])
    rotation, shift = Rotation.from_rotvec([0, 0, 0.05]), np.array([0.01, -0.02, 0.03])
    after = rotation.apply(before) + shift
    after[:8] += 0.1
    assert rigid_motion(before, after, at) == pytest.approx(rotation.apply(at) + shift - at, abs=1e-9)
    assert np.isnan(rigid_motion(before[:5], after[:5], at)).all()


def test_real_stereo_sequence_runs_by_configuration(real_data, tmp_path):
    layout = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    settings = PrepareSettings(layout=layout, geometry=GeometrySettings())
    clip = prepare(real_data / "recover_tissue", settings, tmp_path)
    assert clip.counts["ok"] == 16
    camera = ClipStream(open_source(real_data / "recover_tissue", layout), settings).camera
    assert camera.fx == pytest.approx(732.25 * 214 / 740)
