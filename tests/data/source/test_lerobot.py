"""Videos of LeRobot data sets, laid out and coded (AV1) as their library does it."""

import json

import av
import numpy as np
import pytest

from palpate.data.source.frames import discover, open_source
from palpate.data.source.layout import ClipLayout, InputError
from tests.data.clips import picture

LAYOUT = ClipLayout()


def write_video(path, pictures, codec="libsvtav1", **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options={"g": "2", "crf": "30"} | options)
        stream.height, stream.width, stream.pix_fmt = *pictures[0].shape[:2], "yuv420p"
        for each in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(each, format="rgb24")))
        container.mux(stream.encode())
    return path


def describe(home, version, episodes):
    (home / "meta").mkdir(parents=True, exist_ok=True)
    about = {"codebase_version": version, "total_episodes": episodes, "fps": 30}
    (home / "meta" / "info.json").write_text(json.dumps(about))


def test_each_episode_and_camera_is_a_clip_with_a_name_of_its_own(tmp_path):
    describe(tmp_path, "v2.1", 2)
    names = [f"chunk-000/observation.images.{camera}/episode_00000{n}" for camera in ("left", "right") for n in (0, 1)]
    pictures = [picture(index, 1.5) for index in range(8)]
    for name in names:
        write_video(tmp_path / "videos" / f"{name}.mp4", pictures)
    found = discover([tmp_path], LAYOUT)
    assert [open_source(path, LAYOUT).name for path in found] == names
    source = open_source(found[0], LAYOUT)
    frames = list(source)
    assert (source.fps, source.length, source.size, source.coding) == (30.0, 8, (128, 96), None)
    assert [frame.time_s for frame in frames] == pytest.approx([index / 30 for index in range(8)])
    assert [frame.number for frame in frames] == list(range(8))
    for frame, expected in zip(frames, pictures, strict=True):
        assert np.abs(frame.picture - expected.astype(float)).mean() < 4
    other = open_source(write_video(tmp_path / "videos.mp4", pictures), LAYOUT)
    assert other.name == "videos"
    content = found[1].read_bytes()
    found[1].write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"episode_000001\.mp4"):
        open_source(found[1], LAYOUT)


def test_a_file_of_several_episodes_is_refused(tmp_path):
    """Version 3 writes episodes one after the other up to a size; a data set may have one episode a file as well."""
    describe(tmp_path, "v3.0", 2)
    files = [tmp_path / "videos" / "observation.images.top" / "chunk-000" / f"file-00{index}.mp4" for index in (0, 1)]
    pictures = [picture(0, 0.0)] * 3
    write_video(files[0], pictures)
    with pytest.raises(InputError, match=r"file-000\.mp4 may hold several episodes; cut it at the times in meta/epi"):
        open_source(files[0], LAYOUT)
    write_video(files[1], pictures)
    assert open_source(files[1], LAYOUT).name == "observation.images.top/chunk-000/file-001"
