"""Synthetic clips as files: layout, reading back, keeping, refusing; and as arrays: determinism."""

import dataclasses
import itertools
import json
import tempfile
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.common import output
from palpate.common.files import file_sha256
from palpate.common.output import LIST
from palpate.data.masks.class_table import CLASSES
from palpate.data.source.discovery import discover
from palpate.data.source.layout import ClipLayout
from palpate.data.synthetic import clip as clips
from palpate.data.synthetic.__main__ import main
from palpate.data.synthetic.clip import SyntheticClip, clip_seed, write_clip
from palpate.data.synthetic.files import open_video
from palpate.data.synthetic.settings import SceneSettings
from tests.data.clips import make_clip

SIZE = {"width": 108, "height": 60, "grid_width": 108, "grid_height": 60}
SMALL = SceneSettings(**SIZE, frames=20, onset_fraction=(0.15, 0.2), press_seconds=(0.2, 0.3))
BRIEF = ["--size", "small", "--frames", "20", "--press-seconds", "0.2", "0.3"]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("set"), 7, SMALL, 11)


@pytest.fixture(scope="module")
def clip() -> SyntheticClip:
    """What was written."""
    return make_clip(SMALL, 11)


def test_the_same_seed_gives_the_same_clip_and_errors_of_observation_leave_the_truth_alone(clip: SyntheticClip) -> None:
    errors = {"depth_noise": 0.004, "depth_bits": 8, "mask_error": 0.5, "scale_flicker": 0.01, "focal_error": 1.2}
    settings = dataclasses.replace(SMALL, **errors)
    first, second, other = make_clip(settings, 11), make_clip(settings, 11), make_clip(settings, 4)
    for name in ("images", "labels", "depth"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    np.testing.assert_array_equal(first.motion.theta, second.motion.theta)
    assert not np.array_equal(first.depth, other.depth)
    np.testing.assert_array_equal(clip.motion.response, first.motion.response)
    np.testing.assert_array_equal(clip.images, first.images)
    assert first.camera.fx == pytest.approx(1.2 * first.scene.camera.fx)


def test_files_have_cholecseg8ks_names_and_colors(written: Path, clip: SyntheticClip) -> None:
    assert written.parts[-2:] == ("video07", "video07_00000")
    for number in (0, 9, 19):
        image, color, grey, depth = (
            cv2.imread(str(written / f"frame_{number}_endo{suffix}.png"), cv2.IMREAD_UNCHANGED)
            for suffix in ("", "_color_mask", "_watershed_mask", "_depth")
        )
        np.testing.assert_array_equal(image[..., ::-1], clip.images[number])
        np.testing.assert_array_equal(grey, np.repeat(clip.labels[number][..., None], 3, axis=2))
        for entry in CLASSES.values():
            where = clip.labels[number] == entry.grey
            assert (color[where][:, ::-1] == entry.color).all()
        assert depth.dtype == np.uint16
        np.testing.assert_allclose(depth / 65535, clip.depth[number], atol=1e-6)
    assert len(list(written.glob("frame_*_endo.png"))) == 20


def test_the_truth_lies_beside_the_clip(written: Path, clip: SyntheticClip) -> None:
    truth = json.loads((written / "truth.json").read_text(encoding="utf-8"))
    assert list(truth["theta"].values()) == clip.motion.theta.tolist()
    assert truth["zeta"] == pytest.approx(truth["theta"]["damping"] / (2 * (truth["theta"]["stiffness"] * 1e-3) ** 0.5))
    assert truth["release_s"] - truth["onset_s"] == pytest.approx(clip.motion.load_seconds)
    assert truth["settings"]["frames"] == 20
    assert truth["force_delay_s"] == clip.motion.delay == 0
    assert "DOP853" in truth["integrator"]
    with np.load(written / "truth.npz") as arrays:
        np.testing.assert_array_equal(arrays["trajectory"], clip.motion.contact)
        np.testing.assert_array_equal(arrays["response"], clip.motion.response)
        np.testing.assert_array_equal(arrays["mesh_vertices"], clip.scene.mesh.vertices)
        np.testing.assert_allclose(arrays["field"], clip.motion.field, atol=5e-5)
    description = json.loads((written / "clip.json").read_text(encoding="utf-8"))
    assert description["camera"]["fx"] == pytest.approx(clip.camera.fx)
    assert "theta" not in description


def test_the_truth_tells_when_the_force_started(tmp_path: Path) -> None:
    folder = write_clip(tmp_path, 1, dataclasses.replace(SMALL, onset_delay=(0.25, 0.25), release_delay=(0.5, 0.5)), 11)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert (truth["force_delay_s"], truth["release_delay_s"]) == (pytest.approx(0.01), pytest.approx(0.02))
    assert truth["onset_s"] == pytest.approx(truth["onset_frame"] / 25)  # the frame's, which is all that is seen


def test_the_video_shows_the_same_frames(written: Path, clip: SyntheticClip) -> None:
    reader = cv2.VideoCapture(str(written.with_suffix(".mp4")))
    frames = []
    while (read := reader.read())[0]:
        frames.append(read[1][..., ::-1].astype(float))
    reader.release()
    assert len(frames) == 20
    assert np.abs(np.stack(frames) - clip.images).mean() < 6


def test_videos_of_odd_size_lose_their_last_row_and_column(tmp_path) -> None:
    settings = dataclasses.replace(SMALL, width=109, height=63)
    with open_video(tmp_path / "odd.mp4", settings) as add:
        for _ in range(3):
            add(np.full((63, 109, 3), (200, 50, 50), np.uint8))
    done, frame = cv2.VideoCapture(str(tmp_path / "odd.mp4")).read()
    assert done
    assert frame.shape == (62, 108, 3)
    np.testing.assert_allclose(frame.mean(axis=(0, 1)), (50, 50, 200), atol=8)


def quick_frames(scene: SceneSettings, motion: int, seed: int) -> Iterator[tuple[np.ndarray, ...]]:
    """Two frames that show their seed."""
    picture = np.full((32, 32), seed, np.uint8)
    yield from [(np.dstack([picture] * 3), picture, picture)] * 2


def quick_truth(folder: Path, scene: SceneSettings, motion: int, seed: int) -> None:
    (folder / "truth.json").write_text(json.dumps({"seed": seed, "settings": dataclasses.asdict(scene)}))


def write_quickly(patch: pytest.MonkeyPatch) -> None:
    """Let clips be written as ever, but with two blank frames and nothing simulated."""
    patch.setattr(clips, "draw_truth", lambda settings, seed: (settings, 0))
    patch.setattr(clips, "observe", quick_frames)
    patch.setattr(clips, "write_truth", quick_truth)
    patch.setattr(clips, "open_video", lambda path, settings: nullcontext(lambda image: path.write_bytes(b"v")))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    write_quickly(monkeypatch)


@pytest.mark.usefixtures("quick")
def test_a_clip_is_kept_or_refused_but_never_mixed(tmp_path: Path) -> None:
    folder = write_clip(tmp_path, 1, SMALL, 1)
    stamp = (folder / "truth.json").stat().st_mtime_ns
    done = []
    assert write_clip(tmp_path, 1, SMALL, 1, advance=done.append) == folder
    assert sum(done) == 20
    assert (folder / "truth.json").stat().st_mtime_ns == stamp
    with pytest.raises(FileExistsError, match="video01 was made with other settings"):
        write_clip(tmp_path, 1, SMALL, 2)
    write_clip(tmp_path, 1, SMALL, 2, overwrite=True)
    assert json.loads((folder / "truth.json").read_text(encoding="utf-8"))["seed"] == 2
    assert [path.name for path in tmp_path.iterdir()] == ["video01"]


def test_a_real_data_set_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    real = tmp_path / "video01" / "video01_00000"
    real.mkdir(parents=True)
    (real / "frame_80_endo.png").write_bytes(b"precious")
    assert main(["--output", str(tmp_path), *BRIEF, "--overwrite"]) == 1
    said = "".join(capsys.readouterr().err.split())
    assert f"{tmp_path / 'video01'}isnotasthisprogramwroteit;moveitaway" in said
    assert main(["--output", str(tmp_path), *BRIEF]) == 1
    assert [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()] == [b"precious"]


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("foreign", ["notes.txt", "video01_00000/frame_1_endo.png", "video01_00000/mine/1.png"])
def test_a_file_that_is_not_as_written_is_named_and_stays(tmp_path: Path, foreign: str) -> None:
    write_clip(tmp_path, 1, SMALL, 1)
    path = tmp_path / "video01" / foreign
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError, match=rf"{foreign} is not as this program wrote it; move it away"):
        write_clip(tmp_path, 1, SMALL, 2, overwrite=True)
    assert path.read_bytes() == b"precious"
    assert json.loads((tmp_path / "video01" / "video01_00000" / "truth.json").read_text(encoding="utf-8"))["seed"] == 1


@pytest.mark.usefixtures("quick")
def test_a_huge_file_in_a_frame_s_place_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = write_clip(tmp_path, 1, SMALL, 1) / "frame_1_endo.png"
    with frame.open("wb") as file:
        file.truncate(12 * 2**30)
    read = []
    monkeypatch.setattr(output, "file_sha256", lambda path: read.append(path.name) or file_sha256(path))
    with pytest.raises(FileExistsError, match=r"frame_1_endo\.png is not as this program wrote it"):
        write_clip(tmp_path, 1, SMALL, 2, overwrite=True)
    assert read
    assert frame.name not in read
    assert frame.stat().st_size == 12 * 2**30


@pytest.mark.usefixtures("quick")
def test_folders_behind_links_and_odd_markers_are_not_ours(tmp_path: Path) -> None:
    write_clip(tmp_path, 2, SMALL, 1)
    (tmp_path / "video01").symlink_to(tmp_path / "video02")
    (tmp_path / "video03").mkdir()
    (tmp_path / "video03" / LIST).write_text('{"files": ["frame_1_endo.png"]}')
    for number in (1, 3):
        with pytest.raises(FileExistsError, match=rf"video0{number}[^ ]* is not as this program wrote it"):
            write_clip(tmp_path, number, SMALL, 2, overwrite=True)
    assert (tmp_path / "video02" / "video02_00000" / "truth.json").is_file()


RUNS = st.tuples(st.just("run"), st.integers(1, 2), st.integers(1, 2), st.booleans(), st.sampled_from((None, 0, 1)))
"""Number of the clip, seed, --overwrite, frame after which it is interrupted."""
PUTS = st.tuples(
    st.just("put"),
    st.sampled_from(("video01", "video01/video01_00000", "video02/sub", ".video01.1.partial", ".")),
    st.sampled_from((LIST, "truth.json", "frame_0_endo.png", "notes.txt")),
)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.one_of(RUNS, PUTS), min_size=2, max_size=6))
def test_no_order_of_runs_interruptions_and_foreign_files_changes_a_user_s_file(events: list[tuple]) -> None:
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        write_quickly(patch)
        output, theirs, finished = Path(name), {}, set()
        for kind, *event in events:
            if kind == "put":
                path = output / event[0] / event[1]
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text("mine")
                theirs[path] = "mine"
            else:
                number, seed, overwrite, interrupted = event
                frames = itertools.count()

                def advance(_: int, frames: Iterator[int] = frames, interrupted: int | None = interrupted) -> None:
                    if next(frames) == interrupted:
                        raise KeyboardInterrupt

                with suppress(FileExistsError, KeyboardInterrupt):
                    folder = write_clip(output, number, SMALL, seed, overwrite=overwrite, advance=advance)
                    finished.add(number)
                    assert json.loads((folder / "truth.json").read_text())["seed"] == seed
            assert {path: path.read_text() for path in theirs if path.exists()} == theirs
            known = {path.relative_to(output).parts[0] for path in theirs} | {f"video{seen:02d}" for seen in finished}
            assert {path.name for path in output.iterdir()} == known  # nothing is left half written


def test_the_door_writes_clips_that_are_found(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["--output", str(tmp_path / "ü set"), "--depth-bits", "8", "--clips", "2", *BRIEF]) == 0
    folders = [clip for clip in discover([tmp_path / "ü set"], ClipLayout()) if clip.is_dir()]
    assert [folder.name for folder in folders] == ["video01_00000", "video02_00000"]
    truths = [json.loads((folder / "truth.json").read_text(encoding="utf-8")) for folder in folders]
    assert truths[0]["theta"] != truths[1]["theta"]
    assert (truths[0]["seed"], truths[0]["settings"]["press_seconds"]) == (clip_seed(0, 0), [0.2, 0.3])
    assert cv2.imread(str(folders[0] / "frame_0_endo_depth.png"), cv2.IMREAD_UNCHANGED).dtype == np.uint8
    assert "2 clips with truth" in " ".join(capsys.readouterr().err.split())
    assert main(["--output", str(tmp_path / "last"), "--depth-bits", "8", "--first", "2", *BRIEF]) == 0
    last = tmp_path / "last" / "video02" / "video02_00000" / "truth.json"
    assert last.read_bytes() == (folders[1] / "truth.json").read_bytes()


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        ("--size huge", 2, "--size"),
        ("--force -1 -2", 2, "scene.force"),
        ("--size 100000x100000", 2, "give 64 to 4096"),
        ("--size 4097x480", 2, "give 64 to 4096"),
        (f"--size {'9' * 400}x480", 2, "give 64 to 4096"),
        ("--size small --frames 9", 1, "end before the tool is released"),
        ("--size small --frames 1000000 --action press", 1, "GB, more than 1; give fewer --frames"),
        ("--size small --frames 1000000 --action grip", 1, "GB, more than 1; give fewer --frames"),
        ("--output file", 1, "can't be written"),
    ],
)
def test_bad_usage_gets_a_sentence(tmp_path, monkeypatch, capsys, options, status, said) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    assert main(["--output", "set", *options.split()]) == status
    message = " ".join(capsys.readouterr().err.split())
    assert said in message
    assert "Traceback" not in message
    assert list(Path("set").rglob("*")) == []
