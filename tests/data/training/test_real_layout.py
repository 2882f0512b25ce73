"""What paper.yaml asks of a data set in CholecSeg8k's layout: named videos, joined folders, all pairs, what deforms."""

import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.clip import ClipStream, prepare
from palpate.data.contact.geometry import GeometrySettings, GeometryStatus, frame_geometry
from palpate.data.contact.tips import JAWS
from palpate.data.depth.normalise import DepthSettings, normalise, resize_depth
from palpate.data.labels import TISSUE, TOOL
from palpate.data.source.camera import Camera, back_project
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout, InputError
from palpate.data.training.datamodule import ClipDataModule
from palpate.data.training.preparation import join_folders, list_clips
from palpate.data.training.samples import SampleSettings, list_frames, make_interaction
from palpate.data.training.splits import NamedVideos
from tests.data.clips import EDGE, GRID, HEIGHT, SETTINGS, WIDTH, describe, real_frames, write_clip
from tests.data.training.test_datamodule import made

NEAREST = replace(GRID, contact="nearest", min_tool_pixels=1, displacement="redetected")
LAYOUT = ClipLayout()


def write_video(root: Path, number: int, starts: tuple[int, ...], frames: int = 4, **options) -> list[Path]:
    """Folders of one video in contact throughout, each named by its first frame."""
    name, everywhere = f"video{number:02d}", tuple(range(frames))
    folders = {start: root / name / f"{name}_{start:05d}" for start in starts}
    return [write_clip(folder, everywhere, frames, first=start, **options) for start, folder in folders.items()]


def module(root: Path, *videos: tuple[str, ...], **options) -> ClipDataModule:
    """Over clips of which all pairs count, with these videos to train on, validate and test with."""
    return made(root, {"videos": NamedVideos(*videos)} if videos else {}, NEAREST, **options)


# --- folders that follow on ------------------------------------------------------------------------------------------


def test_folders_of_one_video_whose_numbers_follow_on_are_one_clip(tmp_path):
    first, second, apart = write_video(tmp_path, 1, (80, 84, 100))
    other = write_video(tmp_path, 2, (104,))[0]
    assert join_folders(list_clips(tmp_path, LAYOUT), LAYOUT) == {first: (second,), apart: (), other: ()}


def test_contact_goes_on_across_joined_folders(tmp_path):
    first, second = write_video(tmp_path, 1, (80, 84))
    source = open_source(first, LAYOUT, (second,))
    assert [frame.number for frame in source] == list(range(80, 88))
    assert [frame.time_s for frame in source] == pytest.approx([0.04 * index for index in range(8)])
    assert source.warnings == []
    for following, count in (((second,), 8), ((), 4)):
        clip = prepare(first, SETTINGS, tmp_path / "cache", following=following)
        assert clip.consecutive.tolist() == [True] * (count - 1) + [False]
        assert list_frames(clip, SampleSettings(geometry=GRID))[0] == list(range(count - 1))


def test_joined_folders_keep_their_time_stamps_and_are_known_by_all_their_files(tmp_path):
    first, second = write_video(tmp_path, 1, (0, 4))
    describe(first, times=[0, 0.03, 0.08, 0.12])
    describe(second, times=[7.0, 7.05, 7.08, 7.12])
    assert join_folders([first, second], LAYOUT) == {first: (second,)}
    joined = prepare(first, SETTINGS, tmp_path / "cache", following=(second,))
    assert joined.times.tolist() == pytest.approx([0, 0.03, 0.08, 0.12, 0.16, 0.21, 0.24, 0.28])
    cv2.imwrite(str(second / "frame_5_endo.png"), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    again = prepare(first, SETTINGS, tmp_path / "cache", following=(second,))
    assert again.folder != joined.folder


def test_joined_folders_have_one_depth_scale(tmp_path):
    """The second folder lies farther away: by itself it would be scaled down to the same depth."""
    near, far = write_video(tmp_path, 1, (0, 4), recede=0.0)
    for folder in (near, far):
        describe(folder, depth_scale=None)
    for file in far.glob("*_depth.png"):
        stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), (stored * 1.5).astype(np.uint16))
    joined = prepare(near, SETTINGS, tmp_path / "cache", following=(far,))
    apart = prepare(far, SETTINGS, tmp_path / "cache")
    assert joined.depth(7).mean() / joined.depth(0).mean() == pytest.approx(1.5, rel=1e-3)
    assert apart.depth(3).mean() / joined.depth(7).mean() == pytest.approx(1.0, abs=0.01)


# --- named videos ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ten_videos(tmp_path_factory):
    """Ten videos of two folders each that follow on, as CholecSeg8k's."""
    root = tmp_path_factory.mktemp("ten")
    for number in range(1, 11):
        write_video(root / "data", number, (80, 83), frames=3)
    return root


def set_up(data: ClipDataModule) -> dict[str, set[str]]:
    """Names of the clips of each split's samples."""
    data.prepare_data()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data.setup("fit")
    return {split: {data.clips[clip].name for clip, _ in places} for split, places in data.places.items()}


def test_videos_of_each_split_are_named(ten_videos):
    names = tuple(f"video{number:02d}" for number in range(1, 11))
    named = {"train": names[:7], "val": names[7:9], "test": names[9:]}
    data = module(ten_videos, *named.values())
    assert set_up(data) == {split: {f"{name}_00080" for name in videos} for split, videos in named.items()}
    assert {split: len(places) for split, places in data.places.items()} == {"train": 35, "val": 10, "test": 5}


def test_folders_can_be_named_and_what_is_not_named_is_left_out(ten_videos):
    data = module(ten_videos, ("video01_00083", "video02"), ("video03",), ("video04_00080", "video04_00083"))
    expected = {"train": {"video01_00083", "video02_00080"}, "val": {"video03_00080"}, "test": {"video04_00080"}}
    assert set_up(data) == expected
    lengths = {clip.name: len(clip) for clip in data.clips}
    assert (lengths["video01_00083"], lengths["video04_00080"]) == (3, 6)
    with pytest.raises(InputError, match=r"no clip is of video77; name"):
        module(ten_videos, ("video01", "video77")).prepare_data()


def test_no_video_is_in_two_splits():
    with pytest.raises(ValueError, match=r"videos\.train and videos\.test both name video01"):
        NamedVideos(("video01_00080",), ("video02",), ("video01_00160",))
    with pytest.raises(ValueError, match=r"videos\.train is empty"):
        NamedVideos((), ("video02",))
    assert not NamedVideos()


# --- contact pair and release ----------------------------------------------------------------------------------------

CAMERA = Camera(100.0, 100.0, 63.5, 47.5, 128, 96)


def hovering(gap: int, lift: float) -> tuple[np.ndarray, np.ndarray]:
    """A tool beside tissue, `gap` columns away and `lift` nearer to the camera, above one bump of the tissue."""
    depth, labels = np.full((HEIGHT, WIDTH), 0.6), np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[:, :EDGE] = TISSUE
    labels[40:56, EDGE + gap :] = TOOL
    depth[labels == TOOL] -= lift
    depth[20:24, EDGE - 8 : EDGE] = 0.6 - lift
    return depth.astype(np.float32), labels


def test_the_nearest_pair_is_the_closest_of_all_points_at_any_distance():
    depth, labels = hovering(gap=6, lift=0.2)
    with pytest.raises(GeometryStatus, match=r"The tool is .* from the tissue"):
        frame_geometry(depth, labels, CAMERA, GRID)
    found = frame_geometry(depth, labels, CAMERA, NEAREST)
    points = back_project(depth, CAMERA).astype(np.float64)
    tool, tissue = points[labels == TOOL], points[labels == TISSUE]
    apart = np.linalg.norm(tool[:, None] - tissue[None], axis=2).min(axis=0)
    assert found.distance == pytest.approx(apart.min(), rel=1e-5)
    np.testing.assert_allclose(found.tissue_point, tissue[apart.argmin()], atol=1e-6)
    assert found.touching is False


def test_where_the_outlines_touch_the_nearest_pair_may_lie_elsewhere():
    """The tool touches flat tissue beside it in the picture, and in space it is nearer to a bump farther up."""
    depth, labels = hovering(gap=0, lift=0.2)
    beside, nearest = (frame_geometry(depth, labels, CAMERA, settings) for settings in (GRID, NEAREST))
    assert (beside.touching, nearest.touching) == (True, True)
    assert 40 <= beside.pixel[1] < 56
    assert nearest.pixel[1] == 23
    assert nearest.distance < beside.distance


def test_a_tool_that_has_let_go_gives_pairs_as_long_as_it_is_seen(tmp_path):
    """It touches in frames 2 and 3, hovers in 4 to 6 and is gone from 7 on."""
    folder = write_clip(tmp_path / "video01" / "video01_00000", contact=(2, 3, 4, 5, 6), frames=9)
    for index in (4, 5, 6):
        file = str(folder / f"frame_{index}_endo_color_mask.png")
        mask = cv2.imread(file)
        mask[:, EDGE : EDGE + 8 * (index - 3)] = 0  # the tool draws back
        cv2.imwrite(file, mask)
    near, far = (prepare(folder, replace(SETTINGS, geometry=g), tmp_path / "cache") for g in (GRID, NEAREST))
    assert list_frames(near, SampleSettings(geometry=GRID))[0] == [2]
    frames, left_out = list_frames(far, SampleSettings(geometry=NEAREST))
    assert (frames, left_out) == ([2, 3, 4, 5], {"no_tool": 4, "next frame not in contact": 1})
    released = make_interaction(far, 4, SampleSettings(geometry=NEAREST))
    stream = ClipStream(open_source(folder, LAYOUT), replace(SETTINGS, geometry=NEAREST))
    points = [frame.contact.tissue_point for frame in stream if frame.in_contact]
    np.testing.assert_allclose(released.moved[0], points[3] - points[2], atol=1e-6)


@pytest.mark.slow
def test_on_the_real_clip_all_ten_pairs_that_show_the_tool_count(real_data, tmp_path):
    """The grasper holds on in frames 149 to 159, and touches by its jaws; of all of it, the closest points by
    photometric depth are on the outlines, too."""
    folder = real_frames(real_data, tmp_path / "video01" / "video01_00149", range(149, 160))
    touching, nearest = (GeometrySettings(contact=each, displacement="redetected") for each in ("touching", "nearest"))
    for geometry in (touching, nearest):
        clip = prepare(folder, replace(SETTINGS, geometry=geometry), tmp_path / "cache")
        assert list_frames(clip, SampleSettings(geometry=geometry))[0] == list(range(10))
    stream = ClipStream(open_source(folder, SETTINGS.layout), replace(SETTINGS, geometry=touching))
    for frame in stream:
        places = np.argwhere(frame.ends_within(JAWS))
        assert np.linalg.norm(places - frame.contact.pixel[::-1], axis=1).min() <= touching.contact_pixels
        view = frame.depth, frame.labels, stream.camera
        whole, closest = (frame_geometry(*view, geometry) for geometry in (touching, nearest))
        np.testing.assert_allclose(whole.tissue_point, closest.tissue_point, atol=1e-6)


# --- curation, rounding, depth that was forgotten --------------------------------------------------------------------


def test_clips_that_hardly_deform_are_left_out(tmp_path):
    """One video recedes by 0.002 a frame under the tool, the other does not move at all."""
    write_video(tmp_path / "data", 1, (0,))
    write_video(tmp_path / "data", 2, (0,), recede=0.0)
    data = module(tmp_path, min_clip_deformation=0.001)
    data.prepare_data()
    with pytest.warns(UserWarning, match="samples of 1 video"):
        data.setup("fit")
    assert {data.clips[clip].name for places in data.places.values() for clip, _ in places} == {"video01_00000"}
    assert data.left_out["clip hardly deforms"] == 3
    with pytest.raises(ValueError, match="min_clip_deformation is -1"):
        SampleSettings(min_clip_deformation=-1)


@pytest.mark.parametrize("rounded", ["grid", "picture"])
def test_depth_is_rounded_before_or_after_it_is_resized(tmp_path, rounded: str):
    folder = write_clip(tmp_path / "clip", frames=2)
    settings = replace(SETTINGS, depth=DepthSettings(source="stored", bits=8, rounded=rounded))
    prepared = next(iter(ClipStream(open_source(folder, LAYOUT), settings)))
    stored = cv2.imread(str(folder / "frame_0_endo_depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / 65535
    labels = np.where(np.arange(WIDTH) < EDGE, TISSUE, 0).astype(np.uint8)[None].repeat(HEIGHT, 0)
    if rounded == "picture":
        expected = resize_depth(normalise(stored, 1.0, 8), labels, (48, 64))[0]
    else:
        expected = normalise(resize_depth(stored, labels, (48, 64))[0], 1.0, 8)
    np.testing.assert_allclose(prepared.depth, expected, atol=1e-6)
    on_a_level = np.abs(prepared.depth * 255 - np.rint(prepared.depth * 255)).max() < 1e-3
    assert on_a_level == (rounded == "grid")  # a mean of two levels lies between them


def test_depth_beyond_the_scale_is_refused_before_it_is_rounded(tmp_path):
    folder = write_clip(tmp_path / "clip", contact=(0, 1), frames=2)
    settings = replace(SETTINGS, depth=DepthSettings(source="stored", bits=8, rounded="picture", scale=0.1))
    prepared = next(iter(ClipStream(open_source(folder, LAYOUT), settings)))
    assert prepared.status == "bad_depth"
    assert "Half of the depth lies beyond" in prepared.detail
    assert not prepared.depth.any()


def test_without_stored_depth_training_says_whose_depth_it_takes(tmp_path):
    (folder,) = write_video(tmp_path / "data", 1, (0,))
    for file in folder.glob("*_depth.png"):
        file.unlink()
    with pytest.warns(UserWarning, match=r"no stored depth in 1 of 1 clips.*shading; give --data\.depth\.source"):
        module(tmp_path).prepare_data()
    with pytest.raises(InputError, match=r"depthpro needs a model file.*depth\.model"):
        module(tmp_path, depth=DepthSettings(source="depthpro")).prepare_data()
