"""Frames of folders and videos: order, numbers, time stamps, and a sentence for every kind of bad input."""

import json
import os
import re
import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from palpate.data.source import discovery
from palpate.data.source.discovery import discover
from palpate.data.source.frames import VideoFile, open_source
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from tests.conftest import CHECKOUT
from tests.data.source.test_images import png

LAYOUT = ClipLayout()


def picture(seed: int = 0, size: tuple[int, int] = (48, 64)) -> np.ndarray:
    """Smooth random RGB picture, so that codecs keep it."""
    noise = np.random.default_rng(seed).integers(0, 256, (*size, 3)).astype(np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 4)


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image)[1].tobytes())


def make_folder(folder: Path, numbers=(80, 81, 82)) -> Path:
    for number in numbers:
        write_png(folder / f"frame_{number}_endo.png", picture(int(number)))
    return folder


def make_video(path: Path, frames: int = 20, codec: str = "MJPG") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 25, (64, 48))
    for index in range(frames):
        writer.write(picture(index)[..., ::-1])
    writer.release()
    return path


def write_varying(path: Path, milliseconds: np.ndarray, rate: int = 30) -> Path:
    """A video whose frames have these time stamps; an MP4's index lies before its media, so that a cut one is read."""
    with av.open(str(path), "w", options={"movflags": "faststart"} if path.suffix == ".mp4" else {}) as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for stamp in milliseconds:
            frame = av.VideoFrame.from_ndarray(picture(stamp // 20), format="rgb24")
            frame.pts, frame.time_base = int(stamp), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_folder_frames_are_rgb_in_order_with_gaps_in_numbers_and_time(tmp_path):
    source = open_source(make_folder(tmp_path / "clip", (99, 100, 103)), LAYOUT)
    frames = list(source)
    assert [(frame.index, frame.number) for frame in frames] == [(0, 99), (1, 100), (2, 103)]
    assert [frame.time_s for frame in frames] == pytest.approx([0, 0.04, 0.16])
    assert np.array_equal(frames[1].image, picture(100))
    assert (source.size, source.fps, source.length, source.name) == ((64, 48), 25.0, 3, "clip")
    assert source.warnings == ["2 frame numbers are missing between 99 and 103"]
    assert len(list(source)) == 3


def test_clip_file_gives_times(tmp_path):
    folder = make_folder(tmp_path / "clip")
    (folder / "clip.json").write_text(json.dumps({"fps": 30, "times": [0.0, 0.05, 0.2]}))
    source = open_source(folder, LAYOUT)
    assert (source.fps, [frame.time_s for frame in source]) == (30, [0.0, 0.05, 0.2])
    (folder / "clip.json").write_text(json.dumps({"fps": None, "times": None, "depth_scale": None}))
    assert open_source(folder, LAYOUT).fps == 25
    (folder / "clip.json").write_text(json.dumps({"times": [0.0]}))
    with pytest.raises(InputError, match=r"3 frames and its clip\.json 1 times"):
        open_source(folder, LAYOUT)


def test_bad_frames_of_a_folder_keep_their_rows(tmp_path):
    folder = make_folder(tmp_path / "clip", range(6))
    (folder / "frame_0_endo.png").write_bytes(b"")
    whole = (folder / "frame_2_endo.png").read_bytes()
    (folder / "frame_2_endo.png").write_bytes(whole[: len(whole) // 2])
    (folder / "frame_3_endo.png").write_bytes(b"not a picture")
    write_png(folder / "frame_4_endo.png", picture(4, (24, 32)))
    source = open_source(folder, LAYOUT)
    frames = list(source)
    assert [frame.image is None for frame in frames] == [True, False, True, True, True, False]
    assert "frame_0_endo.png is an empty file (0 bytes)" in frames[0].error
    assert ["can't be decoded" in frames[index].error for index in (2, 3)] == [True, True]
    path = folder / "frame_4_endo.png"
    assert frames[4].error == f"{path} is 32x24 while the clip is 64x48; export all at one size."
    assert (frames[5].error, source.warnings) == ("", ["unreadable: 4 of 6 frames"])


@pytest.mark.parametrize(
    ("number", "said"),
    [
        ("01", r"frame_01_endo\.png and .*frame_1_endo\.png are both frame 1; remove one"),
        (10**30, r"0_endo\.png has a frame number above 9007199254740992; rename the file"),
    ],
)
def test_a_number_that_is_there_twice_or_too_large_to_count_with_is_named(tmp_path, number, said):
    folder = make_folder(tmp_path / "clip", (0, 1, 2, number))
    with pytest.raises(InputError, match=said):
        open_source(folder, LAYOUT)


@pytest.mark.parametrize(
    ("size", "allowed"), [((31, 64), False), ((32, 129), False), ((128, 32), True), ((1, 1), False)]
)
def test_pictures_too_small_or_too_long_for_optical_flow_are_refused(tmp_path, size, allowed):
    write_png(tmp_path / "clip" / "frame_0_endo.png", picture(0, size))
    if allowed:
        assert open_source(tmp_path / "clip", LAYOUT).size == size[::-1]
    else:
        with pytest.raises(InputError, match=rf"clip has pictures of {size[1]}x{size[0]}; give at least 32x32 and"):
            open_source(tmp_path / "clip", LAYOUT)


@pytest.mark.parametrize("image", [picture()[..., 0], np.dstack([picture(), np.full((48, 64), 9, np.uint8)])])
def test_grey_and_rgba_frames_become_rgb(tmp_path, image):
    stored = image if image.ndim == 2 else image[..., [2, 1, 0, 3]]
    (tmp_path / "frame_1_endo.png").write_bytes(cv2.imencode(".png", stored)[1].tobytes())
    frame = next(iter(open_source(tmp_path, LAYOUT)))
    assert frame.image.shape == (48, 64, 3)
    assert np.array_equal(frame.image[..., 0], image if image.ndim == 2 else image[..., 0])


def test_non_ascii_and_long_names(tmp_path):
    folder = make_folder(tmp_path / "Größe 測試 🫀" / ("n" * 200))
    assert [frame.number for frame in open_source(folder, LAYOUT)] == [80, 81, 82]
    video = make_video(tmp_path / "äöü 測試.avi", 4)
    assert len(list(open_source(video, LAYOUT))) == 4
    for path in (Path("x" * 5000), Path("x" * 300 + ".mp4")):
        for read in (open_source, lambda path, layout: discover([path], layout)):
            with pytest.raises(InputError, match="name too long"):
                read(path, LAYOUT)


def test_video_frames_have_the_files_time_stamps(tmp_path):
    source = VideoFile(make_video(tmp_path / "v.avi", 10))
    frames = list(source)
    assert [frame.time_s for frame in frames] == pytest.approx(np.arange(10) / 25, abs=1e-3)
    assert [frame.number for frame in frames] == list(range(10))
    assert (source.size, source.fps, source.length, source.warnings) == ((64, 48), 25.0, 10, [])
    assert np.abs(frames[3].image.astype(int) - picture(3)).mean() < 6
    assert len(list(source)) == 10


@pytest.mark.parametrize("name", ["cut.mp4", "cut.mkv"])
def test_a_truncated_video_ends_where_it_is_cut_and_says_so(tmp_path, name):
    path = write_varying(tmp_path / name, 40 * np.arange(40), 25)
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    source = VideoFile(path)
    frames = list(source)
    whole = [frame for frame in frames if not frame.error]
    assert 5 < len(whole) <= len(frames) < 38
    assert len(frames) - len(whole) < 2
    assert [frame.number for frame in frames] == list(range(len(frames)))
    assert re.fullmatch(r"truncated: the file ends after [01]\.\d\d s of 1\.6\d s; copy it again", source.warnings[0])


@pytest.mark.parametrize("content", [b"", b"no video at all", None])
def test_unreadable_videos_get_a_sentence(tmp_path, content):
    path = tmp_path / "v.mp4"
    if content is None:
        whole = make_video(tmp_path / "whole.mp4", 10, "mp4v").read_bytes()
        content = whole[: len(whole) // 2]
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"v\.mp4 (is an empty file|can't be opened)") as caught:
        open_source(path, LAYOUT)
    assert "\n" not in str(caught.value)


def test_discover_finds_clips_at_any_depth_in_natural_order(tmp_path):
    for name in ("video10/video10_00000", "video9/video9_00080", "video9/video9_00000"):
        make_folder(tmp_path / name, (1, 2))
    make_video(tmp_path / "raw" / "a.avi", 2)
    make_video(tmp_path / "results" / "overlay.mp4", 2)
    (tmp_path / "results" / "run.json").write_text("{}")
    (tmp_path / "circle").symlink_to(tmp_path)
    found = [path.relative_to(tmp_path).as_posix() for path in discover([tmp_path], LAYOUT)]
    assert found == ["raw/a.avi", "video9/video9_00000", "video9/video9_00080", "video10/video10_00000"]


@pytest.mark.parametrize("pictures", ["images", ""], ids=["EndoNeRF", "directly"])
def test_masks_and_depth_beside_pictures_are_no_clips(tmp_path, pictures):
    clip = tmp_path / "pulling"
    for folder in (pictures, "masks", "depth"):
        for number in range(3):
            write_png(clip / folder / f"{number:06}.png", picture(number))
    assert discover([tmp_path], LAYOUT) == [clip]
    source = open_source(clip, LAYOUT)
    frames = list(source)
    assert [frame.path for frame in frames] == [clip / pictures / f"{number:06}.png" for number in range(3)]
    assert source.warnings == ["files in depth and masks are not read; name them in a layout (--layout)"]
    layout = ClipLayout(
        image=f"{pictures or '.'}/{{number}}.png",
        label_mask="masks/{number}.png",
        tool_values=(0,),
        tissue_values=(1,),
        depth="depth/{number}.png",
    )
    source = open_source(clip, layout)
    assert ([frame.number for frame in source], source.warnings) == ([0, 1, 2], [])
    assert discover([clip / "masks"], LAYOUT) == [clip / "masks"]


def test_folders_beside_a_video_that_hold_its_masks_are_no_clips(tmp_path):
    write_png(tmp_path / "masks" / "0.png", picture())
    for ending in ("mts", "VOB", "y4m", "3gp"):
        (tmp_path / f"a.{ending}").touch()
    assert [path.name for path in discover([tmp_path], LAYOUT)] == ["a.3gp", "a.VOB", "a.mts", "a.y4m"]


@pytest.mark.parametrize("pattern", ["left_{}.png", "{}_l.png", "im-L{}.png"])
def test_left_and_right_pictures_in_one_folder_are_named(tmp_path, pattern):
    other = pattern.replace("left", "right").replace("_l", "_r").replace("L", "R")
    for number in range(3):
        for each in (pattern, other):
            write_png(tmp_path / each.format(f"{number:04}"), picture(number))
    assert discover([tmp_path], LAYOUT) == [tmp_path]
    left, right = (each.format("{number}") for each in (pattern, other))
    said = f"{tmp_path} holds left and right pictures ({pattern.format('0000')}, {other.format('0000')}); give a layout"
    with pytest.raises(InputError, match=re.escape(f"{said} (--layout) with image: '{left}' and right: '{right}'.")):
        open_source(tmp_path, LAYOUT)
    source = open_source(tmp_path, ClipLayout(image=left, right=right))
    assert [frame.number for frame in source] == [0, 1, 2]


def test_a_search_that_has_no_end_is_a_sentence(tmp_path, monkeypatch):
    """A link to `/`; the clips before it are no answer."""
    monkeypatch.setattr(discovery, "MOST_FOLDERS", 20)
    for index in range(19):
        (tmp_path / "many" / f"{index}").mkdir(parents=True)
    make_folder(tmp_path / "many" / "0", (1, 2))
    assert discover([tmp_path / "many"], LAYOUT) == [tmp_path / "many" / "0"]
    (tmp_path / "many" / "elsewhere").symlink_to(tmp_path)
    with pytest.raises(InputError, match=r"many holds more than 20 folders, links followed; give those of the clips\."):
        discover([tmp_path / "many"], LAYOUT)


@pytest.mark.parametrize(
    ("path", "said"),
    [("absent", "No such file"), ("empty", "holds no video, bag or"), ("one.png", "is a single image")],
)
def test_discover_names_what_is_wrong(tmp_path, monkeypatch, path, said):
    monkeypatch.chdir(tmp_path)
    write_png(Path("one.png"), picture())
    Path("empty").mkdir()
    with pytest.raises(InputError, match=said):
        discover([Path(path)], LAYOUT)
    if path == "absent":
        with pytest.raises(InputError, match=said):
            open_source(Path("absent.mp4"), LAYOUT)


NO_FILES = {
    "pipe": (os.mkfifo, "no file"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "no file"),
    "loop": (lambda path: path.symlink_to(path.name), "Too many levels of symbolic links"),
}
"""A pipe would be waited for, a device has no end, and a link to itself leads nowhere."""


def spoiled(tmp_path: Path, make: Callable[[Path], object]) -> tuple[Path, str]:
    """Something else in a frame's place, which costs that frame only, and what is said of it."""
    folder = make_folder(tmp_path / "clip", range(3))
    place = folder / "frame_1_endo.png"
    place.unlink()
    make(place)
    frames = list(open_source(folder, LAYOUT))
    assert [frame.image is None for frame in frames] == [False, True, False]
    return place, frames[1].error


@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_costs_its_own_frame_only(tmp_path, kind):
    make, said = NO_FILES[kind]
    place, error = spoiled(tmp_path, make)
    if said == "no file":
        assert error == f"{place} is no file; put the picture itself there."
    else:
        assert re.match(rf"{place} .*{said}", error)


@pytest.mark.parametrize("size", [(100_000, 100_000), (30_000, 30_000), (8192, 4097), (100_000, 400)])
def test_a_picture_that_declares_more_than_anybody_takes_is_not_unpacked(tmp_path, size):
    """A file of a few kB, and only its first rows are really there."""
    content = png(*size, 2, b"\0" * (3 * size[0] + 1) * min(size[1], 64))
    place, error = spoiled(tmp_path, lambda place: place.write_bytes(content))
    assert error == f"{place} is {size[0]}x{size[1]}, more than 34 million pixels; store it smaller."
    with pytest.raises(InputError, match="more than 34 million pixels"):
        read_image(place, cv2.IMREAD_UNCHANGED)


def test_a_video_s_header_is_not_believed(tmp_path):
    """One that declares 100,000 pixels a side: the pictures' own size counts, and without one there is none."""
    true, declared = struct.pack("<II", 64, 48), struct.pack("<II", 100_000, 100_000)
    for name in ("MJPG", "I420"):
        content = make_video(tmp_path / f"{name}.avi", 3, name).read_bytes()
        assert content.count(true) == 2
        (tmp_path / f"{name}.avi").write_bytes(content.replace(true, declared))
    source = open_source(tmp_path / "MJPG.avi", LAYOUT)
    assert (source.size, [frame.error for frame in source]) == ((64, 48), [""] * 3)
    with pytest.raises(InputError, match=r"I420\.avi holds no frame that can be decoded; copy it again"):
        open_source(tmp_path / "I420.avi", LAYOUT)


def test_a_video_whose_pictures_declare_more_than_anybody_takes_holds_none(tmp_path):
    path = make_video(tmp_path / "v.avi", 3, "MJPG")
    content, place = bytearray(path.read_bytes()), 0
    while (place := content.find(b"\xff\xc0", place + 1)) > 0:
        content[place + 5 : place + 9] = struct.pack(">HH", 65_500, 65_500)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"v\.avi (holds no frame that can be decoded|can't be opened)"):
        open_source(path, LAYOUT)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000 + "]" * 100_000, "nests too deeply"),
        ('{"fps":' * 50_000 + "1" + "}" * 50_000, "nests too deeply"),
        ('{"fps": ' + "9" * 400 + "}", "give a positive number"),
        ('{"fps": 1e5}', "gives fps 100000.0; give a positive number up to 10000"),
        ('{"fps": ' + "9" * 5000 + "}", "is not a clip description"),
        ('{"times": [0, ' + "9" * 400 + ", 1]}", "not rising numbers"),
        *((f'{{"times": {value}}}', "not rising numbers") for value in ("[0, 1, 1e308]", "[0, 0]", '["a"]', "3")),
        *((f'{{"fps": {each}}}', "gives fps .*; give a positive number") for each in ("1e-320", "1e308", "-1", "NaN")),
        *((f'{{"fps": {value}}}', "gives fps .{,40}; give") for value in ("9" * 400, "[" * 900 + "]" * 900)),
        ('{"fps": 30, "time": [0.0]}', "has the unknown key 'time'; known are fps, times, camera, depth_scale"),
        (f'"{"x" * 2**24}"', r"larger than 16384 kB"),
    ],
)
def test_a_hostile_clip_file_gets_a_sentence(tmp_path, text, said):
    folder = make_folder(tmp_path / "clip")
    (folder / "clip.json").write_text(text)
    with pytest.raises(InputError, match=said):
        open_source(folder, LAYOUT)


def test_a_folder_that_can_t_be_listed_fails_by_itself(tmp_path, nested):
    """Its path gets too long to be opened."""
    make_folder(tmp_path / "b")
    (tmp_path / "a").mkdir()
    nested(tmp_path / "a", "nested")
    unlisted, good = discover([tmp_path], LAYOUT)
    assert good == tmp_path / "b"
    assert tmp_path / "a" / "nested" in unlisted.parents
    with pytest.raises(InputError, match=r"nested holds no frame images .*; give one that does") as caught:
        open_source(unlisted, LAYOUT)
    assert len(str(caught.value)) < 1000


def test_a_varying_frame_rate_has_no_frames_but_its_own(tmp_path):
    """59 frames in three seconds, whose container says 30 a second."""
    stamps = np.cumsum(np.r_[0, np.tile([33, 34, 86], 20)])[:59]
    source = open_source(write_varying(tmp_path / "clip.mkv", stamps), LAYOUT)
    frames = list(source)
    assert [frame.error for frame in frames] == [""] * 59
    assert [frame.time_s for frame in frames] == pytest.approx(stamps / 1000, abs=2e-3)
    assert source.warnings == []


def test_real_clips(real_data):
    clips = discover([real_data / "cholecseg8k"], LAYOUT)
    source = open_source(clips[0], LAYOUT)
    assert (source.name, source.size, source.length) == ("video01_00080", (854, 480), 80)
    recover = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    assert discover([real_data / "recover_tissue"], recover) == [real_data / "recover_tissue"]
    frames = list(open_source(real_data / "recover_tissue", recover))
    assert ([frame.number for frame in frames], frames[0].image.shape) == (list(range(5, 21)), (540, 740, 3))
