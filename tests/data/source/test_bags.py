"""Bags that their own library wrote: pictures, time stamps, camera, and a sentence for every kind of bad input."""

import sys
from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.camera import Rig, clip_camera
from palpate.data.source.discovery import discover
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout, InputError
from palpate.estimators.calibration_file import read_calibration
from tests.data.bags import RATE, write_bag

LAYOUT = ClipLayout()
PICTURES = np.random.default_rng(0).integers(0, 256, (5, 48, 64, 3), np.uint8)
FIRST = PICTURES[0]
FORMATS = ("clip.bag", "clip_mcap", "clip_db3")


@pytest.mark.parametrize("name", FORMATS)
def test_a_bag_gives_pictures_and_the_times_of_their_headers(tmp_path, name):
    """ROS 2: the folder and the file in it; two pictures are missing after the second."""
    stamps = (0, 1, 4, 5, 6)
    path = write_bag(
        tmp_path / name, lambda make: [("/a", make.compressed(*pair)) for pair in zip(stamps, PICTURES, strict=True)]
    )
    assert discover([tmp_path], LAYOUT) == [path]
    for given in (path, *path.glob("*.mcap"), *path.glob("*.db3")):
        source = open_source(given, LAYOUT)
        assert (source.name, source.fps, source.length, source.size) == (given.stem, 25.0, 5, (64, 48))
        frames = list(source)
        assert [frame.time_s for frame in frames] == [index * RATE / 1e9 for index in stamps]
        assert [frame.number for frame in frames] == list(stamps)
        assert np.array_equal([frame.picture for frame in frames], PICTURES)
        assert source.warnings == ["2 frame numbers are missing between 0 and 6"]
        assert clip_camera(given, LAYOUT) is None


@pytest.mark.parametrize("name", FORMATS)
def test_a_repeated_time_stamp_costs_its_picture_alone(tmp_path, name):
    stamps = (0, 1, 1, 3, 4)
    path = write_bag(
        tmp_path / name, lambda make: [("/a", make.compressed(*pair)) for pair in zip(stamps, PICTURES, strict=True)]
    )
    frames = list(source := open_source(path, LAYOUT))
    assert [frame.number for frame in frames] == [0, 1, 3, 4]
    assert np.array_equal([frame.picture for frame in frames], PICTURES[[0, 1, 3, 4]])
    assert source.warnings[-1] == "left out, as their time stamps repeat: 1 of 5 pictures"


def test_a_compressed_picture_that_is_none_is_named_with_its_format(tmp_path):
    def recorded(make):
        for content, label in ((b"\0\0\0\1g", "h264"), (b"P6 x", "jpeg\n")):
            data = np.frombuffer(content, np.uint8)
            yield "/a", make.message("sensor_msgs/msg/CompressedImage", len(label), format=label, data=data)
        yield "/a", make.compressed(9, FIRST)

    errors = [frame.error for frame in open_source(write_bag(tmp_path / "clip_mcap", recorded), LAYOUT)]
    assert "on /a of" in errors[0]
    assert "(format 'h264') holds H.264 or H.265 video; record JPEG or PNG, or convert the topic" in errors[0]
    assert "(format 'jpeg ') can't be decoded as JPEG or PNG; record" in errors[1]


def written(path, images):
    """A bag of one topic of pictures: what `Messages.image` takes of each, with FIRST by default; None is damaged."""
    given = {"pixels": FIRST}
    return write_bag(path, lambda make: [("/a", make.image(**given | item) if item else b"none") for item in images])


@pytest.mark.parametrize("name", FORMATS)
def test_raw_pictures_of_every_encoding_are_rgb(tmp_path, name):
    grey, opaque = FIRST[..., :1], np.full((48, 64, 1), 9, np.uint8)
    stored = {"rgb8": FIRST, "bgr8": FIRST[..., ::-1], "mono8": grey}
    stored |= {"rgba8": np.dstack((FIRST, opaque)), "bgra8": np.dstack((FIRST[..., ::-1], opaque))}
    images = [{"index": index, "pixels": stored[kind], "encoding": kind} for index, kind in enumerate(stored)]
    for padding in (0, 5):
        path = written(tmp_path / f"{padding}{name}", [item | {"padding": padding} for item in images])
        for kind, frame in zip(stored, open_source(path, LAYOUT), strict=True):
            assert np.array_equal(frame.picture, np.repeat(grey, 3, axis=2) if kind == "mono8" else FIRST), kind


@pytest.mark.parametrize("name", FORMATS)
def test_what_cannot_be_decoded_is_a_frame_with_a_sentence(tmp_path, name):
    """One that is damaged or has no time stamp is timed by when it was recorded."""
    cases = (
        ({"index": None}, ""),
        (None, "Picture 1 on /a of {} is damaged; record it again."),
        ({"index": 2}, ""),
        ({"encoding": "yuv422"}, "Picture 3 on /a of {} is no 64x48 of yuv422 in rows of 192 bytes that can be read; "),
        ({"step": 100}, "Picture 4 on /a of {} is no 64x48 of rgb8 in rows of 100 bytes that can be read; record rgb8"),
        ({"pixels": FIRST[:40]}, "Frame 5 of {} is 64x40 while the clip is 64x48"),
        ({"height": 60_000, "width": 60_000}, "Picture 6 on /a of {} is 60000x60000, more than"),
    )
    path = written(tmp_path / name, [item and {"index": index} | item for index, (item, _) in enumerate(cases)])
    found = list(source := open_source(path, LAYOUT))
    assert [frame.time_s for frame in found] == pytest.approx([0.04 * index for index in range(7)], abs=1e-9)
    for frame, (_, said) in zip(found, cases, strict=True):
        assert (frame.image is None) == bool(said)
        assert frame.error.startswith(said.format(path))
    assert source.warnings == ["unreadable: 5 of 7 frames"]


@pytest.mark.parametrize("name", FORMATS)
def test_the_camera_of_the_same_namespace_is_taken(tmp_path, name):
    matrix, bent = (90, 0, 60, 0, 91, 50, 0, 0, 1), (0.1, -0.2, 0.001, 0.002, 0.0)

    def recorded(make):
        for topic in ("/left/image_raw/compressed", "/left/image_rect", "/right/image", "/fish/image", "/raw/image"):
            yield topic, make.compressed(0, FIRST)
        yield "/left/camera_info", make.camera(matrix, bent, 70)
        yield "/fish/camera_info", make.camera(matrix, bent[:4], 70, "equidistant")
        yield "/raw/camera_info", make.camera(np.zeros(9), (), 0)

    path = write_bag(tmp_path / name, recorded)
    for topic, camera in {
        "/left/image_raw/compressed": Rig(90, 91, 60, 50, 128, 96, bent),
        "/left/image_rect": Rig(70, 70, 64, 48, 128, 96),
        "/right/image": None,
        "/raw/image": None,
    }.items():
        assert clip_camera(path, ClipLayout(topic=topic)) == camera
    with pytest.raises(InputError, match=r"has the lens model equidistant; record pictures without distortion"):
        clip_camera(path, ClipLayout(topic="/fish/image"))
    for topic in (None, "/wrong"):
        with pytest.raises(InputError, match=r"on /fish/image, .*, /right/image; name one of these as layout\.topic"):
            open_source(path, ClipLayout(topic=topic))


@pytest.mark.parametrize("name", FORMATS)
def test_a_topic_of_wrenches_is_a_known_force(tmp_path, name):
    """Its norm over the time since the first picture, whether or not it was measured already then."""

    def recorded(make):
        yield from (("/a", make.compressed(index, FIRST)) for index in (2, 3))
        yield from (("/tool/wrench", make.wrench(index, 3.0 * index, -4.0 * index, 0.0)) for index in range(4))
        yield "/tool/wrench", b"none"

    path = write_bag(tmp_path / name, recorded)
    known = read_calibration(Path("/tool/wrench")).of_clip(path, None).measured
    assert known.times[:4] == pytest.approx([-0.08, -0.04, 0.0, 0.04], abs=1e-12)
    assert known.force == pytest.approx([0.0, 5.0, 10.0, 15.0, np.nan], nan_ok=True)
    with pytest.raises(InputError, match=r"WrenchStamped on /tool/wrench; name one of these as --force-scale\."):
        read_calibration(Path("/tool")).of_clip(path, None)
    with pytest.raises(InputError, match=r"is no bag and has no topic /tool; give --force-scale a table\."):
        read_calibration(Path("/tool")).of_clip(tmp_path, None)


@pytest.mark.parametrize("name", FORMATS)
def test_a_bag_that_cannot_be_used_is_one_sentence(tmp_path, name, monkeypatch):
    for images, said in (
        ([], "on no topic; record one"),
        ([{"index": index} for index in (0, 2, 1)], r"\(/a\) has time stamps that don't rise"),
        ([{"index": 0, "encoding": "16UC1"}], "holds 1 images and none can be decoded; Picture 0 on /a"),
    ):
        path = written(tmp_path / f"{len(images)}{name}", images)
        with pytest.raises(InputError, match=said):
            open_source(path, LAYOUT)
    file = path if path.is_file() else next(file for file in path.iterdir() if file.name != "metadata.yaml")
    content = file.read_bytes()
    for length in (0, 9, len(content) // 2, len(content) - 9):
        file.write_bytes(content[:length])
        with pytest.raises(InputError, match=rf"{name} can't be read as a bag \(.*\); copy it again or mend it"):
            open_source(path, LAYOUT)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"is a bag, which needs rosbags; install 'palpate\[robot\]'"):
        open_source(path, LAYOUT)
