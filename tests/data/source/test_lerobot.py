"""Videos of LeRobot data sets, laid out and coded (AV1) as their library does it."""

import json
import shutil
import sys
from itertools import chain
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from palpate.common.files import file_sha256
from palpate.data.cache import cache_key
from palpate.data.settings import PrepareSettings
from palpate.data.source.discovery import discover
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout, InputError
from palpate.estimators.direct.estimator import DirectEstimator, DirectSettings
from palpate.estimators.onset import STAMP
from palpate.results.record import depends_on
from tests.data.clips import picture

LAYOUT = ClipLayout()
CAMERA = "observation.images.top"


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
    assert (source.fps, source.length, source.size) == (30.0, 8, (128, 96))
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


def write_version_3(home, episodes):
    """What lerobot 0.4.4 writes of pictures that it gets episode by episode: one file of each kind; lengths,
    statistics and `data` are left out."""
    describe(home, "v3.0", len(episodes))
    rows, end = [], 0.0
    for number, pictures in enumerate(episodes):
        place = {"chunk_index": 0, "file_index": 0, "from_timestamp": end, "to_timestamp": end + len(pictures) / 30}
        rows.append({"episode_index": number} | {f"videos/{CAMERA}/{name}": value for name, value in place.items()})
        end = place["to_timestamp"]
    table = home / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    table.parent.mkdir(parents=True)
    parquet.write_table(pa.Table.from_pylist(rows), table)
    return write_video(home / "videos" / CAMERA / "chunk-000" / "file-000.mp4", [*chain(*episodes)])


def write_by_their_library(home, episodes):
    library = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    video = {"dtype": "video", "shape": episodes[0][0].shape, "names": ["height", "width", "channels"]}
    state = {"dtype": "float32", "shape": (2,), "names": None}
    data_set = library.LeRobotDataset.create("a/b", 30, {CAMERA: video, "action": state}, root=home)
    for pictures in episodes:
        for each in pictures:
            data_set.add_frame({CAMERA: each, "action": np.zeros(2, np.float32), "task": "press"})
        data_set.save_episode()
    data_set.finalize()
    return home / "videos" / CAMERA / "chunk-000" / "file-000.mp4"


@pytest.mark.parametrize("write", [write_version_3, write_by_their_library])
def test_each_episode_of_a_file_of_version_3_is_a_clip(tmp_path, write):
    """Their lengths are odd and even, so that one of them doesn't begin at a frame that can be decoded alone."""
    episodes = [[picture(index, 9.0 + number) for index in range(count)] for number, count in enumerate((5, 4, 6))]
    video = write(tmp_path / "set", episodes)
    found = discover([tmp_path], LAYOUT)
    assert found == [video / f"episode_00000{number}" for number in range(3)]
    assert discover([found[1], video], LAYOUT) == [found[1], found[0], found[2]]
    for clip, pictures in zip(found, episodes, strict=True):
        source = open_source(clip, LAYOUT)
        assert (source.name, source.path, source.fps) == (f"{CAMERA}/{clip.name}", clip, 30.0)
        frames = list(source)
        assert (len(frames), source.length, source.warnings) == (len(pictures), len(pictures), [])
        assert [frame.time_s for frame in frames] == pytest.approx([index / 30 for index in range(len(pictures))])
        for frame, expected in zip(frames, pictures, strict=True):
            assert np.abs(frame.picture - expected.astype(float)).mean() < 4
    with pytest.raises(InputError, match=r"episode_000003 is no clip in its file; give one, as .*/episode_000000\.$"):
        open_source(video / "episode_000003", LAYOUT)
    plain = shutil.copy(video, tmp_path / "a.mp4")
    with pytest.raises(InputError, match=r"a\.mp4/episode_000000 is no clip in its file; give one, as .*/a\.mp4\.$"):
        open_source(Path(plain) / "episode_000000", LAYOUT)


def test_what_depends_on_an_episode_does_not_depend_on_another(tmp_path):
    video = write_version_3(tmp_path, [[picture(index, 0.0) for index in range(3)]] * 2)
    clips = [video / f"episode_00000{number}" for number in (0, 1)]
    assert len({cache_key(clip, PrepareSettings()) for clip in clips}) == 2
    found = [depends_on(clip, PrepareSettings(), DirectEstimator(DirectSettings(onset=STAMP))) for clip in clips]
    assert [each["span"] for each in found] == [(0.0, 0.1), (0.1, 0.2)]
    assert found[0] | {"span": ()} == found[1] | {"span": ()}
    assert {each["clip"] for each in found} == {file_sha256(video)}


def test_a_file_of_which_nobody_knows_the_episodes_is_refused(tmp_path, monkeypatch):
    video = write_version_3(tmp_path, [[picture(0, 0.0)] * 3] * 2)
    other = shutil.copy(video, video.with_name("file-001.mp4"))
    table = next((tmp_path / "meta" / "episodes").rglob("*.parquet"))
    with pytest.raises(InputError, match=r"file-001\.mp4 can't be cut .*\(it names none of this file\); copy that"):
        discover([Path(other)], LAYOUT)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "pyarrow.parquet", None)
        with pytest.raises(InputError, match=r"file-000\.mp4 can't be cut .* or install 'palpate\[robot\]'"):
            discover([video], LAYOUT)
    table.write_bytes(b"no table")
    with pytest.raises(InputError, match=r"file-000\.mp4 can't be cut into episodes by meta/episodes"):
        open_source(video / "episode_000000", LAYOUT)
