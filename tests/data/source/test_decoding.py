"""Video files as people record them: which track, when its frames were taken, and their pixels."""

import itertools
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from av.video.reformatter import ColorRange, ColorTrc

from palpate.data.source.decoding import numbered
from palpate.data.source.frames import Frame, VideoFile
from palpate.data.source.layout import InputError

NOISE = np.random.default_rng(0).normal(0, 800, (192, 416)).astype(np.float32)
SCENE = np.clip(128 + cv2.GaussianBlur(NOISE, (0, 0), 4), 16, 235).astype(np.uint8)
"""What a camera looks at."""


def scene(time: float) -> np.ndarray:
    """Grey picture of the scene, across which the camera has moved by 3 px a frame, [96, 128]."""
    moved = np.float32([[1, 0, -3 * time - 20], [0, 1, -40]])
    shown = cv2.warpAffine(SCENE, moved, (416, 192))[40:136, 150:278]
    return np.repeat(shown[..., None], 3, 2)


PICTURES = [scene(time) for time in range(12)]


def write(path: Path, pictures: Sequence[np.ndarray] = PICTURES, stamps: Sequence[int] | None = None, **about) -> Path:
    """A video of 25 frames a second, lossless (FFV1) by default.

    Args:
        stamps: time stamps [ms].
        about: codec, pix_fmt, options, name and value of what else the encoder is told, and rotation [degrees],
            container (its options), before (called with the container to add other tracks before).
    """
    options = {"codec": "ffv1", "pix_fmt": "yuv444p", "options": {}, "container": {}} | about
    with av.open(str(path), "w", options=options["container"]) as container:
        others = options["before"](container) if "before" in options else ()
        stream = container.add_stream(options["codec"], rate=25, options=options["options"])
        stream.height, stream.width, stream.pix_fmt = *pictures[0].shape[:2], options["pix_fmt"]
        if "rotation" in options:
            stream.set_display_rotation(options["rotation"])
        for name in ("sample_aspect_ratio", "color_range", "color_trc", "gop_size", "max_b_frames"):
            if name in options:
                setattr(stream.codec_context, name, options[name])
        if "disposition" in options:
            stream.disposition = options["disposition"]
        unit = options.get("unit", 1)
        stream.codec_context.time_base = Fraction(unit, 1000)
        for packet in others:
            container.mux(packet)
        for picture, stamp in zip(pictures, stamps or itertools.count(0, 40), strict=False):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame = frame.reformat(format=options["pix_fmt"], dst_color_range=options.get("color_range"))
            frame.pts, frame.time_base = stamp // unit, Fraction(unit, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


SHARP = {"codec": "libx264", "options": {"crf": "5"}}


def read(path: Path) -> tuple[VideoFile, list[Frame]]:
    source = VideoFile(path)
    return source, list(source)


def difference(frames: Sequence[Frame], pictures: Sequence[np.ndarray]) -> float:
    """Mean difference of grey values."""
    assert len(frames) == len(pictures)
    pairs = zip(frames, pictures, strict=True)
    return max(float(np.abs(frame.picture.astype(float) - picture).mean()) for frame, picture in pairs)


@pytest.mark.parametrize(
    ("stamps", "numbers", "times"),
    [
        ([0, 40, 80, 120], [0, 1, 2, 3], [0, 40, 80, 120]),
        ([7, 47, 47, None, 200], [0, 1, 2, 3, 5], [0, 40, 80, 120, 193]),
        ([0, 48, 72, 128, 152, 208, 232, 288], range(8), None),  # ± 8 ms
        ([0, 40, 120, 160, 200, 280, 320, 360], [0, 1, 3, 4, 5, 7, 8, 9], None),
        ([0, 40, 115, 125, 160, 200, 240], range(7), None),  # one late by 35 ms is no hole
        ([*range(0, 400, 33), *range(400, 1000, 66)], range(23), None),  # in the dark a telephone takes half as many
        ([0, 33, 83, 116, 166, 199, 249, 282], range(8), None),  # 24 pictures in 60 fields
    ],
)
def test_numbers_and_times(stamps, numbers, times):
    found = list(numbered(((None if stamp is None else stamp / 1000, 0) for stamp in stamps), 0.04))
    assert [each.number for each in found] == list(numbers)
    expected = times or [stamp - stamps[0] for stamp in stamps]
    assert [1000 * each.time_s for each in found] == pytest.approx(expected)


JITTER = [0, 40, 84, 128, 152, 194, 245, 288, 316, 357, 406, 439]


@pytest.mark.parametrize(
    ("name", "stamps", "about"),
    [
        ("plain.mkv", None, {}),
        ("jitter.webm", JITTER, {"codec": "libvpx", "pix_fmt": "yuv420p", "options": {"crf": "4", "b": "8M"}}),
        ("late.mkv", range(36_000_000, 36_000_480, 40), {}),
        ("late.ts", range(36_000_000, 36_000_480, 40), {"codec": "mpeg2video", "pix_fmt": "yuv420p", "unit": 40}),
        ("old.avi", None, {"codec": "mjpeg", "pix_fmt": "yuvj444p", "options": {"b": "20M"}}),
        ("b.mp4", None, {"codec": "libx264", "pix_fmt": "yuv420p", "max_b_frames": 3}),
        ("deep.mkv", None, {"pix_fmt": "yuv444p10le"}),
        ("full.mkv", None, {"color_range": ColorRange.JPEG}),
        ("two.wmv", None, {"codec": "wmv2", "pix_fmt": "yuv420p", "options": {"b": "4M"}}),
        ("two.mts", None, {"codec": "libx264", "pix_fmt": "yuv420p", "container": {"mpegts_m2ts_mode": "1"}}),
    ],
)
def test_containers_and_codings_give_the_same_frames(tmp_path, name, stamps, about):
    source, frames = read(write(tmp_path / name, stamps=stamps, **about))
    stamps = np.array(stamps or range(0, 480, 40))
    assert source.warnings == []
    assert [frame.number for frame in frames] == list(range(12))
    assert [1000 * frame.time_s for frame in frames] == pytest.approx(stamps - stamps[0], abs=1)
    assert (source.size, source.fps) == ((128, 96), pytest.approx(25, rel=0.01))
    assert source.length in (0, 12)
    assert difference(frames, PICTURES) < 4


def second_track(name: str, **about):
    """Adds another video track before: white pictures, or a cover."""

    def add(container):
        stream = container.add_stream(name, rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 96, about.get("pix_fmt", "yuv444p")
        stream.disposition = about.get("disposition", av.stream.Disposition(0))
        white = av.VideoFrame.from_ndarray(np.full((96, 128, 3), 250, np.uint8), format="rgb24")
        packets = []
        for index in range(about.get("frames", 12)):
            frame = white.reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = index, Fraction(1, 25)
            packets += stream.encode(frame)
        return packets + stream.encode()

    return add


@pytest.mark.parametrize(
    "before", [second_track("ffv1"), second_track("mjpeg", pix_fmt="yuvj444p", frames=1)], ids=["another view", "cover"]
)
def test_the_default_track_is_read(tmp_path, before):
    path = write(tmp_path / "v.mkv", before=before, disposition=av.stream.Disposition.default)
    assert difference(read(path)[1], PICTURES) < 2


def sound(seconds: float):
    def add(container):
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, round(8000 * seconds)), np.int16), "s16", "mono")
        frame.sample_rate, frame.pts = 8000, 0
        return [*stream.encode(frame), *stream.encode()]

    return add


def test_sound_that_lasts_longer_is_no_damage_and_sound_alone_no_video(tmp_path):
    source, frames = read(write(tmp_path / "v.mkv", before=sound(3)))
    assert (len(frames), source.length, source.warnings) == (12, 12, [])
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        for packet in sound(1)(container):
            container.mux(packet)
    with pytest.raises(InputError, match=r"sound\.mkv holds no video track that can be decoded; give"):
        VideoFile(tmp_path / "sound.mkv")


def test_frames_that_an_edit_list_hides_are_none(tmp_path):
    coded = {"codec": "libx264", "pix_fmt": "yuv420p", "gop_size": 12, "max_b_frames": 0}
    whole = write(tmp_path / "whole.mp4", **coded)
    options = {"avoid_negative_ts": "disabled"}
    with av.open(str(whole)) as container, av.open(str(tmp_path / "cut.mp4"), "w", options=options) as cut:
        stream = cut.add_stream_from_template(container.streams.video[0])
        for packet in container.demux(video=0):
            if packet.dts is not None:
                packet.pts, packet.dts = (stamp - 5 * packet.duration for stamp in (packet.pts, packet.dts))
                packet.stream = stream
                cut.mux(packet)
    source, frames = read(tmp_path / "cut.mp4")
    assert ([frame.number for frame in frames], source.warnings) == (list(range(7)), [])
    assert difference(frames, PICTURES[5:]) < 4


def test_frames_that_a_recorder_left_out_are_a_jump(tmp_path):
    kept = [0, 1, 2, 5, 6, 7, 8, 11]
    stamps = [40 * index for index in kept]
    source, frames = read(
        write(tmp_path / "v.avi", [PICTURES[each] for each in kept], stamps, codec="mpeg4", pix_fmt="yuv420p")
    )
    assert ([frame.number for frame in frames], source.warnings) == (kept, [])


@pytest.mark.parametrize(("angle", "quarters"), [(90, 1), (180, 2), (-90, 3)])
def test_pictures_are_upright(tmp_path, angle, quarters):
    source, frames = read(write(tmp_path / "v.mp4", codec="libx264", pix_fmt="yuv444p", rotation=angle))
    assert source.size == ((96, 128) if quarters % 2 else (128, 96))
    assert difference(frames, [np.rot90(picture, quarters) for picture in PICTURES]) < 4


@pytest.mark.parametrize(("aspect", "size"), [((2, 1), (256, 96)), ((2, 3), (128, 144))])
def test_pixels_become_square(tmp_path, aspect, size):
    source, frames = read(write(tmp_path / "v.mp4", sample_aspect_ratio=Fraction(*aspect), **SHARP))
    assert source.size == size
    assert source.warnings == [f"pixels are not square: pictures of 128x96 are read as {size[0]}x{size[1]}"]
    assert difference(frames, [cv2.resize(each, size, interpolation=cv2.INTER_CUBIC) for each in PICTURES]) < 3


def test_high_dynamic_range_is_said(tmp_path):
    source = VideoFile(write(tmp_path / "v.mkv", pix_fmt="yuv444p10le", color_trc=ColorTrc.SMPTE2084))
    assert source.warnings == ["colours are coded for high dynamic range (PQ) and read as standard ones"]


def woven(first_rows: int) -> list[np.ndarray]:
    """Frames whose even (0) or odd (1) rows were taken half a frame before the others."""
    frames = [scene(time + 0.5) for time in range(12)]
    for frame, earlier in zip(frames, PICTURES, strict=True):
        frame[first_rows::2] = earlier[first_rows::2]
    return frames


@pytest.mark.parametrize("first_rows", [0, 1])
@pytest.mark.parametrize("coded", [{}, {"codec": "libx264", "options": {"crf": "18"}}], ids=["lossless", "h264"])
def test_woven_fields_are_deinterlaced_whatever_is_flagged(tmp_path, first_rows, coded):
    source, frames = read(write(tmp_path / "v.mkv", woven(first_rows), **coded))
    assert source.warnings == ["interlaced: odd and even rows show different instants; the video is deinterlaced"]
    assert (
        difference(frames, PICTURES) < 4 < difference([Frame(0, 0, 0.0, each) for each in woven(first_rows)], PICTURES)
    )


INTERLACED = {"codec": "libx264", "pix_fmt": "yuv420p", "options": {"x264-params": "interlaced=1", "crf": "10"}}


def test_progressive_frames_flagged_interlaced_stay_as_they_are(tmp_path):
    source, frames = read(write(tmp_path / "v.mp4", **INTERLACED))
    assert source.warnings == []
    assert difference(frames, PICTURES) < 3


def test_what_does_not_move_does_not_tell_whether_it_is_interlaced(tmp_path):
    source = VideoFile(write(tmp_path / "v.mp4", PICTURES[:1] * 12, **INTERLACED))
    assert source.warnings == ["too little moves in the frames examined to tell whether the video is interlaced"]
    assert VideoFile(write(tmp_path / "w.mkv", PICTURES[:1] * 12)).warnings == []
    later = VideoFile(write(tmp_path / "later.mkv", PICTURES[:1] * 40 + woven(0) * 3))
    assert later.warnings == ["interlaced: odd and even rows show different instants; the video is deinterlaced"]


def test_damage_inside_costs_its_own_frames_and_is_said(tmp_path):
    path = write(tmp_path / "v.mkv", codec="libx264", pix_fmt="yuv420p", gop_size=1, options={"crf": "10"})
    content = bytearray(path.read_bytes())
    place = len(content) // 2
    content[place : place + 3000] = bytes(3000)
    path.write_bytes(content)
    source, frames = read(path)
    good = [frame for frame in frames if not frame.error]
    assert 5 < len(good) < 12
    assert difference(good, [PICTURES[frame.number] for frame in good]) < 4
    assert source.warnings == ["damaged: some of its frames can't be decoded; copy it again"]
