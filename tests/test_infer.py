"""The door infer.py: what it writes with every estimator, when it works again, and how it ends."""

import contextlib
import json
import math
import shutil
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import cv2
import meshio
import numpy as np
import onnxruntime
import pytest
from distributed import LocalCluster

from palpate.cli import infer
from palpate.common.onnx_devices import PROVIDERS
from palpate.common.output import LIST
from palpate.common.workers import WorkerLost, run_tasks
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout
from palpate.data.synthetic.clip import write_clip as write_synthetic
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.tool import SHAFT_RADIUS
from palpate.estimators.direct.estimator import MODEL_COVARIANCE
from palpate.estimators.records import CONTACTS, FRAMES
from palpate.physics.identifiability import NINETY
from palpate.physics.mechanics import PARAMETERS
from palpate.results.store import BAGS
from palpate.results.writer import ClipResults
from tests.data.bags import BEGIN, RATE, write_bag
from tests.data.clips import real_frames
from tests.data.masks.test_onnx import BOTH, save_model
from tests.data.source.test_lerobot import describe as describe_data_set
from tests.data.source.test_lerobot import write_by_their_library, write_version_3
from tests.data.source.test_lerobot import write_video as write_coded
from tests.inference_inputs import metadata, write_clip, write_model, write_video
from tests.results.test_bag import read as read_messages
from tests.tables import read_rows

MODEL_ERROR = dict(zip(PARAMETERS, np.sqrt(np.diag(MODEL_COVARIANCE)), strict=True))
"""Standard deviations of log θ by what the model gets wrong."""

pytestmark = pytest.mark.usefixtures("blank_pictures")  # the fixture `done` has drawn ones
FILES = [
    LIST, "fit.png", "forces.json", "interactions.csv", "overlay.mp4", "page.html", "parameters.csv", "results.json",
    "run.json",
]  # fmt: skip
SCENE = SceneSettings(
    width=214, height=120, frames=17, onset_fraction=(0.2, 0.25), press_seconds=(0.2, 0.2), depth_noise=0.0005,
    stiffness=(0.4, 0.4), damping=(0.03, 0.03), force=(-0.05, -0.05),
)  # fmt: skip


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model and, under clips, a frame folder and a video."""
    folder = tmp_path_factory.mktemp("inputs")
    write_model(folder / "parameters.onnx")
    write_clip(folder / "clips" / "folder", 8, 4)
    write_video(folder / "clips" / "drawn.mp4", 8, 4)
    return folder


def call(inputs: Path, output: Path, *options: str, clips: str = "clips") -> int:
    arguments = [str(inputs / clips), "--output", str(output), "--model", str(inputs / "parameters.onnx"), *options]
    return infer.main(arguments)


def rows(folder: Path, table: str = "parameters.csv") -> list[dict[str, str]]:
    return read_rows(folder / table)


def runs(folder: Path) -> list[dict[str, str]]:
    return rows(folder, "interactions.csv")


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text(encoding="utf-8"))


def clips_in(output: Path) -> list[str]:
    return sorted(path.name for path in output.iterdir() if path.is_dir())


def flat(text: str) -> str:
    return " ".join(text.split())


def test_folder_and_video_give_complete_results_and_a_narrow_table(inputs, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert call(inputs, tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [LIST, "drawn", "folder", "index.html"]
    for name in ("drawn", "folder"):
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == FILES
        table = rows(tmp_path / name)
        assert len(table) == 8
        assert record(tmp_path / name)["input"]["frames"] == 8
        video = cv2.VideoCapture(str(tmp_path / name / "overlay.mp4"))
        assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 8
        assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(25.0)
    found = rows(tmp_path / "folder")
    assert [row["status"] for row in found] == ["no_tool"] + ["no_contact"] * 3 + ["ok"] * 4
    assert [row["frame"] for row in found] == [str(number) for number in range(10, 18)]
    assert [float(row["time_s"]) for row in found] == pytest.approx([0.04 * index for index in range(8)])
    assert all((row["stiffness"] != "") == (row["status"] == "ok") for row in found)
    assert {row["force"] for row in found[4:]} == {"0.4"}
    assert {row["stiffness_sd"] + row["damping_sd"] + row["force_sd"] for row in found} == {""}
    (run,) = runs(tmp_path / "folder")
    assert (run["onset_frame"], run["status"], run["verdict"], run["force"]) == ("14", "ok", "undetermined", "0.4")
    said = capsys.readouterr().out
    for text in ("folder", "done", "1 frame no_tool", "3 frames no_contact", "4 frames undetermined"):
        assert text in said
    assert "…" not in said


def test_finished_clips_are_not_computed_again(inputs, tmp_path, capsys):
    assert call(inputs, tmp_path, clips="clips/folder") == 0
    before = (tmp_path / "folder" / "run.json").stat().st_mtime_ns
    capsys.readouterr()
    assert call(inputs, tmp_path, clips="clips/folder") == 0
    assert (tmp_path / "folder" / "run.json").stat().st_mtime_ns == before
    said = capsys.readouterr()
    assert "up to date" in said.err
    assert "1 contact undetermined" in said.out
    # Without the overlay nothing is missing either.
    assert call(inputs, tmp_path, "--no-overlay", clips="clips/folder") == 0
    assert (tmp_path / "folder" / "run.json").stat().st_mtime_ns == before


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_other_settings_replace_only_our_results_and_only_when_asked(inputs, tmp_path, capsys):
    assert call(inputs, tmp_path, clips="clips/folder") == 0
    (tmp_path / "folder" / "notes.txt").write_text("mine")
    (tmp_path / "folder" / "figures").mkdir()
    (tmp_path / "folder" / "figures" / "fit.png").write_bytes(b"mine too")
    before = contents(tmp_path / "folder")
    assert direct(inputs / "clips" / "folder", tmp_path) == 1
    assert "holds results of other settings, of another model" in capsys.readouterr().err
    # The other clip of the batch is done all the same.
    assert call(inputs, tmp_path, "--depth", "photometric") == 1
    said = capsys.readouterr()
    assert f"{tmp_path / 'folder'}: holds results of other settings" in said.err
    assert "--overwrite replaces them" in said.err
    assert contents(tmp_path / "folder") == before
    assert len(rows(tmp_path / "drawn")) == 8
    options = ("--depth", "photometric", "--no-overlay", "--threads", "1", "--overwrite")
    assert call(inputs, tmp_path, *options, clips="clips/folder") == 0
    after = contents(tmp_path / "folder")
    assert before.keys() - after.keys() == {"overlay.mp4"}
    assert after["run.json"] != before["run.json"]
    theirs = ("notes.txt", "figures/fit.png")
    assert [after[name] for name in theirs] == [before[name] for name in theirs] == [b"mine", b"mine too"]


def repaint_last(clip: Path) -> None:
    (clip / "frame_17_endo.png").write_bytes((clip / "frame_10_endo.png").read_bytes())


def remove_last(clip: Path) -> None:
    (clip / "frame_17_endo.png").unlink()


@pytest.mark.parametrize(("output", "change"), [("clip", repaint_last), (".", repaint_last), ("out", remove_last)])
def test_changed_frames_are_seen_wherever_the_output_is(inputs, tmp_path, capsys, output, change):
    """Also in the input, and above it."""
    clip = shutil.copytree(inputs / "clips" / "folder", tmp_path / "clip")

    def run(*options: str) -> int:
        return call(inputs, tmp_path / output, "--no-overlay", *options, clips=str(clip))

    assert run() == run() == 0
    assert "up to date" in capsys.readouterr().err
    change(clip)
    assert run() == 1
    assert "of frames that have changed since" in capsys.readouterr().err
    assert run("--overwrite") == run() == 0
    assert "up to date" in capsys.readouterr().err
    (table,) = (tmp_path / output).glob("clip*/parameters.csv")
    assert len(rows(table.parent)) == len(list((tmp_path / "clip").glob("*_endo.png")))


def test_output_among_the_inputs_is_no_input(inputs, tmp_path):
    shutil.copytree(inputs / "clips", tmp_path / "clips")
    for _ in range(2):
        assert call(inputs, tmp_path / "clips" / "folder", clips=str(tmp_path / "clips")) == 0
    assert clips_in(tmp_path / "clips" / "folder") == ["drawn", "folder"]


@pytest.mark.parametrize("within", ["python", "compiled code"])
def test_interruption_keeps_finished_clips_and_continues(within, inputs, tmp_path, monkeypatch, capsys):
    write = ClipResults.write

    def interrupt(self: ClipResults, *estimate: object) -> None:
        if self.folder.name == "folder" and len(self.estimates) == 3:
            try:
                raise KeyboardInterrupt
            finally:
                if within == "compiled code":
                    raise SystemError("a kernel returned a result with an exception set")
        write(self, *estimate)

    with monkeypatch.context() as patch:
        patch.setattr(ClipResults, "write", interrupt)
        assert call(inputs, tmp_path) == 130
    assert clips_in(tmp_path) == ["drawn"]
    assert 'href="drawn/page.html"' in (tmp_path / "index.html").read_text()
    assert "1 of 2 clips are complete; run the same command to continue" in capsys.readouterr().err
    before = (tmp_path / "drawn" / "run.json").stat().st_mtime_ns
    assert call(inputs, tmp_path) == 0
    assert clips_in(tmp_path) == ["drawn", "folder"]
    assert (tmp_path / "drawn" / "run.json").stat().st_mtime_ns == before


def test_unexpected_error_is_one_sentence_unless_debugging(inputs, tmp_path, monkeypatch, capsys):
    def fail(*_: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr("palpate.results.video.open_source", fail)
    assert call(inputs, tmp_path, clips="clips/drawn.mp4") == 1
    said = capsys.readouterr().err.strip()
    assert said.startswith("failed: ")
    assert "drawn.mp4: unexpected RuntimeError (two lines); run with --debug" in said.splitlines()[0]
    with pytest.raises(RuntimeError):
        call(inputs, tmp_path, "--debug", clips="clips/drawn.mp4")


def test_files_of_another_layout_and_a_camera_are_read(inputs, tmp_path):
    shutil.copytree(inputs / "clips" / "folder", tmp_path / "clip")
    for path in sorted((tmp_path / "clip").glob("*_endo.png")):
        path.rename(path.with_name(path.name.replace("_endo", "")))
    (tmp_path / "layout.yaml").write_text("image: frame_{number}.png\nfps: 50\n")
    camera = {"fx": 150.0, "fy": 150.0, "cx": 80.0, "cy": 48.0, "width": 160, "height": 96}
    (tmp_path / "camera.yaml").write_text(json.dumps(camera))
    options = ("--layout", str(tmp_path / "layout.yaml"), "--camera", str(tmp_path / "camera.yaml"))
    assert call(inputs, tmp_path / "out", *options, clips=str(tmp_path / "clip")) == 0
    found = rows(tmp_path / "out" / "clip")
    assert float(found[1]["time_s"]) == pytest.approx(0.02)
    assert [row["status"] for row in found[4:]] == ["ok"] * 4
    assert record(tmp_path / "out" / "clip")["camera"]["fx"] == 150.0


# --- the direct estimator, on a clip of known truth, and on drawn ones ---


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one synthetic clip of known truth as a folder of frames."""
    folder = write_synthetic(tmp_path_factory.mktemp("clips"), 1, SCENE, 3)
    folder.with_suffix(".mp4").unlink()
    return folder.parent


@pytest.fixture(scope="module")
def blunt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A frame folder with a press on a patch, whose dent shows in the light on the coarse grid of `inputs`' model."""
    scene = replace(SCENE, patch_radius=(5.0, 5.0), force=(-0.2, -0.2))
    return write_synthetic(tmp_path_factory.mktemp("blunt"), 1, scene, 3)


@pytest.fixture(scope="module")
def done(synthetic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Direct results of that clip."""
    output = tmp_path_factory.mktemp("results")
    assert direct(synthetic, output) == 0
    return output / "video01_00000"


def direct(clips: Path, output: Path, *options: str) -> int:
    """Synthetic presses begin at a frame's time stamp."""
    arguments = [str(clips), "--output", str(output), "--estimator", "direct", "--onset", "stamp", *options]
    return infer.main(arguments)


def test_a_contact_with_known_truth_is_recovered_within_its_uncertainty(done, synthetic):
    (row,) = runs(done)
    truth = json.loads((synthetic / "video01_00000" / "truth.json").read_text(encoding="utf-8"))
    assert list(row) == list(CONTACTS.columns)
    assert (row["status"], row["verdict"], row["detail"], row["at_bound"]) == ("ok", "determined", "", "")
    assert float(row["onset_time_s"]) == pytest.approx(truth["onset_s"])
    assert int(row["onset_frame"]) == round(truth["onset_s"] * 25)
    assert float(row["load_s"]) == pytest.approx(truth["release_s"] - truth["onset_s"])
    for name, value in truth["theta"].items():
        found, sd, bound = (float(row[f"{name}{suffix}"]) for suffix in ("", "_sd", "_bound"))
        assert found > 0
        assert abs(found - abs(value)) < 4 * sd
        assert abs(np.log(found / abs(value))) < 0.25
        # The bound is the largest within one sd; what the model gets wrong comes in addition.
        assert sd == pytest.approx(math.hypot(bound, MODEL_ERROR[name]) * found, rel=0.2)
        low, high = (float(row[f"{name}_{end}"]) for end in ("low", "high"))
        assert low < found < high
        assert np.log(high / low) / 2 == pytest.approx(NINETY * sd / found, rel=0.05)
    # The noise is what was put in, and the relief that a plane around every pixel leaves.
    assert 0.9 * SCENE.depth_noise < float(row["noise"]) < 1.3 * SCENE.depth_noise
    assert 0.3 < float(row["misfit"]) < 1.5


def test_every_frame_has_a_row_the_record_says_what_was_done_and_the_picture_shows_it(done):
    found, (run,) = rows(done), runs(done)
    assert len(found) == 17
    assert {row["stiffness"] + row["damping"] + row["force"] for row in found} == {""}
    touching = [row for row in found if row["status"] == "ok"]
    assert touching[0]["frame"] == run["onset_frame"]
    assert all("interactions.csv" in row["detail"] for row in touching)
    found = record(done)
    assert (found["program"], found["model"], found["warnings"]) == ("infer.py", None, [])
    assert found["estimator"]["bounds"]["stiffness"] == [0.05, 1.0]
    assert found["settings"]["geometry"]["smoothing"] == 4.0
    assert found["settings"]["geometry"]["rigid_motion"] == "subtract"
    assert found["contacts"] == {"determined": 1}
    assert found["units"]["stiffness"] == "scene units (normalised), not N/m"
    assert found["notice"] == "Research software, not a medical device."
    assert found["columns"] == {"parameters.csv": FRAMES.without("alarm").columns, "interactions.csv": CONTACTS.columns}
    assert {"decode", "geometry", "tracking", "fit", "overlay", "total"} <= set(found["timings_s"])
    picture = cv2.imread(str(done / "fit.png"))[..., ::-1]
    assert picture.shape[1] == 1500
    for color in ((75, 85, 99), (124, 58, 237), (234, 88, 12)):
        assert (picture == color).all(axis=2).sum() > 100


@pytest.mark.parametrize("estimator", ["network", "gan", "direct"])
def test_every_estimator_writes_the_same_files(estimator, inputs, synthetic, done, tmp_path):
    folder = done
    if estimator != "direct":
        model = ["--model", str(write_model(tmp_path / "gan.onnx"))] if estimator == "gan" else []
        arguments = [str(synthetic), "--output", str(tmp_path / "out"), "--estimator", estimator]
        assert infer.main([*arguments, *model]) == 0
        folder = tmp_path / "out" / "video01_00000"
    assert sorted(path.name for path in folder.iterdir()) == FILES
    assert list(rows(folder)[0]) == list(FRAMES.without("alarm").columns)
    assert [(row["onset_frame"], row["status"]) for row in runs(folder)] == [(runs(done)[0]["onset_frame"], "ok")]
    found = record(folder)
    assert found["estimator"]["name"] == estimator
    assert sum(found["contacts"].values()) == 1
    assert sum(found["statuses"].values()) == found["input"]["frames"] == 17


def test_real_presses_begin_between_frames(done, synthetic, tmp_path):
    """By default; an estimate is less certain then."""
    assert infer.main([str(synthetic), "--output", str(tmp_path), "--estimator", "direct", "--no-overlay"]) == 0
    ((exact,), (between,)) = runs(done), runs(tmp_path / "video01_00000")
    for name in ("stiffness", "damping", "force"):
        widths = [np.log(float(row[f"{name}_high"]) / float(row[f"{name}_low"])) / 2 for row in (exact, between)]
        known, unknown = (width**2 - (NINETY * MODEL_ERROR[name]) ** 2 for width in widths)
        assert unknown > 1.2 * known > 0
    assert exact["delay_s"] == ""
    assert abs(float(between["delay_s"])) < 0.01  # it began at the stamp, and the fit finds that
    assert between["verdict"] == "determined"
    onsets = [record(folder)["estimator"]["onset"] for folder in (done, tmp_path / "video01_00000")]
    assert onsets == ["stamp", "between"]


def test_a_determined_press_is_exported_and_others_are_counted(synthetic, inputs, tmp_path, capsys):
    folder, arguments = tmp_path / "video01_00000", [str(synthetic), "--output", str(tmp_path), "--onset", "stamp"]
    arguments.append("--no-overlay")
    for again in (False, True):
        assert infer.main([*arguments, "--export"]) == 0
        (run,), names = runs(folder), {path.name for path in folder.glob("scene*")}
        assert (
            {"scene_4.pvd", "scene_4.ply", "scene_4_0000.vtu", "scene_4_0010.vtu"}
            < names
            <= record(folder)["files"].keys()
        )
        read = meshio.read(folder / "scene_4_0010.vtu")
        told = [abs(np.ravel(read.field_data[name])[0]) for name in PARAMETERS]
        np.testing.assert_allclose(told, [float(run[name]) for name in PARAMETERS], rtol=1e-5)
        if not again:
            (folder / "scene_4.pvd").unlink()  # so that the clip is not up to date
    assert infer.main(arguments) == 1
    assert infer.main([*arguments, "--overwrite"]) == 0
    assert not list(folder.glob("scene*"))
    assert infer.main([str(inputs / "clips" / "folder"), *arguments[1:3], "--no-overlay", "--export"]) == 0
    assert "1 of 1 runs of contact were not exported, as not all" in flat(capsys.readouterr().err)


def test_without_a_noise_level_the_options_that_give_one_are_named(synthetic, tmp_path, capsys):
    assert direct(synthetic, tmp_path, "--no-overlay", "--smoothing", "0") == 0
    (row,) = runs(tmp_path / "video01_00000")
    assert row["status"] == "no_estimate"
    assert row["detail"] == "The depth's noise isn't known; set --smoothing above 0, or give --noise."
    assert f"video01_00000: no estimate of 1 of 1 contact: {row['detail']}" in flat(capsys.readouterr().err)
    assert {row[name] for name in CONTACTS.columns if name.startswith(("stiff", "damp", "force", "verd", "misf"))} == {
        ""
    }
    assert int(row["frames"]) > 10
    # A noise of one's own makes another result of it, which takes the first one's place only when asked.
    noise = ("--no-overlay", "--smoothing", "4", "--noise", "0.002")
    assert direct(synthetic, tmp_path, *noise) == 1
    assert [row["status"] for row in runs(tmp_path / "video01_00000")] == ["no_estimate"]
    assert direct(synthetic, tmp_path, *noise, "--overwrite") == 0
    (row,) = runs(tmp_path / "video01_00000")
    assert (row["status"], row["noise"]) == ("ok", "0.002")


def test_without_contact_the_table_of_contacts_is_empty_and_contact_from_the_first_frame_on_has_no_estimate(tmp_path):
    write_clip(tmp_path / "clips" / "none", 4, 9)
    write_clip(tmp_path / "clips" / "begun", 4, 0)
    assert direct(tmp_path / "clips", tmp_path / "out", "--no-overlay") == 0
    assert runs(tmp_path / "out" / "none") == []
    assert [row["status"] for row in rows(tmp_path / "out" / "none")] == ["no_tool"] * 4
    assert record(tmp_path / "out" / "none")["contacts"] == {}
    (row,) = runs(tmp_path / "out" / "begun")
    assert (row["onset_frame"], row["frames"], row["load_s"], row["stiffness"]) == ("10", "0", "", "")
    assert row["status"] == "no_estimate"
    assert row["detail"].startswith("The onset of the contact was not observed")
    assert record(tmp_path / "out" / "begun")["contacts"] == {"no_estimate": 1}


def test_a_limit_of_force_has_an_alarm(synthetic, tmp_path, capsys):
    """The press is of 0.05 units: above a limit of 0.03 as soon as it is determined, and never of 0.1."""
    arguments = [str(synthetic), "--output", str(tmp_path), "--onset", "stamp", "--no-overlay", "--force-limit"]
    folder = tmp_path / "video01_00000"
    for limit, state in (("0.03", "above"), ("0.1", "below")):
        assert infer.main([*arguments, limit, "--overwrite"]) == 0
        found, said = rows(folder), record(folder)["force_limit"]
        known = [row["force_high"] != "" and "force" in row["determined"].split(";") for row in found]
        touching = [row["contact"] == "1" for row in found]
        expected = [
            state if sure else "unknown" if touches else "" for touches, sure in zip(touching, known, strict=True)
        ]
        assert [row["alarm"] for row in found] == expected
        assert {state, "unknown", ""} == set(expected)
        assert said["frames"]["unknown"] == expected.count("unknown")
        assert (said["limit"], said["unit"], said["alarms"]) == (
            float(limit), "scene units (normalised), not N", int(state == "above"),
        )  # fmt: skip
        assert list(record(folder)["columns"]["parameters.csv"]) == list(FRAMES.columns)
        assert f"reached the limit {limit} in scene units" in flat(capsys.readouterr().err)
    assert infer.main([*arguments, "0.2"]) == 1  # other results, which replace these only when asked
    capsys.readouterr()
    told = json.loads((synthetic / "video01_00000" / "clip.json").read_text())
    told["camera"]["metres_per_depth"] = 0.1
    shutil.copytree(synthetic, tmp_path / "clips")
    (tmp_path / "clips" / "video01_00000" / "clip.json").write_text(json.dumps(told))
    metres = 0.1 * record(folder)["scale"]["depth_at_1"]
    (tmp_path / "known.yaml").write_text(f"stiffness: {8.0 / metres}\n")
    given = ["--force-scale", str(tmp_path / "known.yaml"), "--overwrite"]
    assert infer.main([str(tmp_path / "clips"), *arguments[1:], "0.5", *given]) == 0  # 20 N a unit: 1 N
    (folder,) = tmp_path.glob("video01_00000-*")
    assert record(folder)["force_limit"]["unit"] == "N"
    assert record(folder)["force_limit"]["alarms"] == 1


def write_pictures(folder, pictures, **about):
    folder.mkdir(parents=True)
    for index, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{index:03}.png"), picture[..., ::-1])
    (folder / "clip.json").write_text(json.dumps(about))


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_lerobot_data_set_is_read_to_the_same_estimates_as_a_folder(inputs, blunt, tmp_path, version):
    """With the pictures that its videos are decoded to, and their time stamps; of version 3 the second episode."""
    pictures = [frame.picture for frame in open_source(blunt, ClipLayout())]
    if version == "v3.0":
        write = write_by_their_library if find_spec("lerobot") else write_version_3
        clip = write(tmp_path / "set", [pictures[:5], pictures]) / "episode_000001"
    else:
        describe_data_set(tmp_path / "set", version, 1)
        video = tmp_path / "set" / "videos" / "chunk-000" / "observation.images.top" / "episode_000000.mp4"
        clip = write_coded(video, pictures)
    source = open_source(clip, ClipLayout())
    frames = list(source)
    assert len(frames) == len(pictures)
    about = {"times": [frame.time_s for frame in frames], "fps": source.fps}
    write_pictures(tmp_path / "folder", [frame.picture for frame in frames], **about)
    for given in (clip, tmp_path / "folder", clip):  # which is up to date then
        assert call(inputs, tmp_path / "out", "--no-overlay", clips=str(given)) == 0
    found = [contents(tmp_path / "out" / name) for name in (source.name.replace("/", "_"), "folder")]
    for table in ("parameters.csv", "interactions.csv"):
        assert found[0][table] == found[1][table]
    assert runs(tmp_path / "out" / "folder")


@pytest.mark.parametrize("name", ["same.bag", "same"])
def test_a_bag_is_read_to_the_same_estimates_as_a_folder(inputs, blunt, tmp_path, name, capsys):
    """With the same pictures, time stamps and camera; frames of both are numbered from 0."""
    pictures = [frame.picture for frame in open_source(blunt, ClipLayout())]
    camera = {"fx": 110.8, "fy": 148.2, "cx": 63.5, "cy": 47.5, "width": 128, "height": 96, "distortion": [1e-4] * 5}
    times = [index * RATE / 1e9 for index in range(len(pictures))]
    write_pictures(tmp_path / "folder" / "same", pictures, camera=camera, times=times)

    def recorded(make):
        yield from (("/lap/image_raw/compressed", make.compressed(*item)) for item in enumerate(pictures))
        yield "/lap/camera_info", make.camera((110.8, 0, 63.5, 0, 148.2, 47.5, 0, 0, 1), [1e-4] * 5, 110)
        yield from (("/depth/image", make.image(index, item)) for index, item in enumerate(pictures))

    folder, bag = tmp_path / "folder" / "same", write_bag(tmp_path / name, recorded)
    topic, kind = ("--topic", "/lap/image_raw/compressed"), "ros1" if name == "same.bag" else "ros2"
    for given, options in ((folder, ()), (bag, (*topic, "--bag", kind))):
        assert call(inputs, tmp_path / f"of {given.parent.name}", "--no-overlay", *options, clips=str(given)) == 0
    for table in ("parameters.csv", "interactions.csv"):
        one, other = (contents(tmp_path / f"of {given.parent.name}" / "same")[table] for given in (folder, bag))
        assert one == other
    results = tmp_path / f"of {bag.parent.name}" / "same"
    (run,), written = runs(results), contents(results)
    assert run["status"] == "ok"
    (press,) = json.loads(written["forces.json"])["contacts"]
    assert set(BAGS.values()) & written.keys() == {BAGS[kind]}
    said = read_messages(results / BAGS[kind])
    assert (press["verdict"], list(said)) == ("undetermined", ["/palpate/verdict"])  # no force is known
    assert said["/palpate/verdict"] == [(BEGIN + round(press["onset_time_s"] * 1e9), press["verdict"])]
    assert direct(bag, tmp_path / "out", "--topic", "/depth/image", "--force-scale", "/wrench") == 1
    assert "holds geometry_msgs/msg/WrenchStamped on no topic; record one." in flat(capsys.readouterr().err)
    assert direct(folder, tmp_path / "out", "--topic", "/lap") == 2
    assert "--topic is of the pictures in a bag, and there is none among the inputs" in flat(capsys.readouterr().err)


def test_wrong_usage(inputs, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    model = str(inputs / "parameters.onnx")
    for options, said in (
        (["--depth", "nonsense"], "infer.py: 'nonsense' is no depth preset; choose one of"),
        (["--depth", "depthpro"], "--depth-model"),
    ):
        assert direct(tmp_path / "empty", tmp_path / "out", *options) == 2
        assert said in flat(capsys.readouterr().err)
    for options, said in (
        (["--estimator", "gan"], "--estimator gan needs a trained generator; give the file of train.py export"),
        (["--force-scale", str(tmp_path / "no.csv")], "no.csv is no table of forces"),
        (
            ["--model", model, "--force-limit", "1"],
            "needs the force of every frame, which --estimator gan does not give",
        ),
        (["--estimator", "online", "--force-limit", "1"], "which --estimator online does not give; choose another"),
        (["--alarm-at", "0.8"], "--alarm-at has no effect without --force-limit"),
        (["--estimator", "online", "--bag", "ros2"], "--bag needs a force, which --estimator online does not give"),
        (["--model", model, "--export"], "--export needs intervals, which --estimator gan does not give"),
    ):
        assert infer.main([str(tmp_path / "empty"), "--output", str(tmp_path / "out"), *options]) == 2
        assert said in flat(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()
    for options, said in (
        (
            ["--model", model, "--onset", "between"],
            "--onset is an option of --estimator network or --estimator direct.",
        ),
        (["--smoothing", "2"], "--smoothing is an option of --estimator direct or --estimator online."),
        (["--noise", "0.01"], "--noise is an option of --estimator direct."),
    ):
        with pytest.raises(SystemExit, match=r"^2$"):
            infer.main([str(tmp_path), "--output", str(tmp_path / "out"), *options])
        assert said in capsys.readouterr().err
    for options in (
        ["--noise", "0"],
        ["--noise", "much"],
        ["--smoothing", "-1"],
        ["--force-limit", "0"],
        ["--shaft-diameter", "0.005"],
        ["--shaft-diameter", "5000"],
    ):
        with pytest.raises(SystemExit, match=r"^2$"):
            direct(tmp_path, tmp_path / "out", *options)
        assert f"'{options[1]}' is not a" in capsys.readouterr().err
    with pytest.raises(SystemExit, match=r"^2$"):
        infer.main([])


@pytest.mark.acceptance
def test_real_clip_directly(real_data, tmp_path):
    """Judged: the grasper holds the gallbladder from frame 149 on, and pulls aslant.

    The camera moves so that no light at rest can be compared with that after the onset; the motion around the grip
    tells how the force changes.
    """
    clip = real_frames(real_data, tmp_path / "video01" / "video01_00080", range(135, 160))
    assert direct(clip, tmp_path / "out", "--no-overlay") == 0
    (row,) = runs(tmp_path / "out" / "video01_00080")
    assert 149 <= int(row["onset_frame"]) <= 151
    assert (row["verdict"], row["determined"]) == ("relative_force", "relative_force")
    assert float(row["skill"]) > 0.4
    assert row["detail"] == "The tissue at the contact could not be followed after its onset."


@pytest.mark.slow
def test_real_clip(real_data, tmp_path):
    """Judged: 80 rows, no tool on frames 80–148, and at least 9 of 149–159 in contact."""
    geometry = {"height": 120, "width": 214}
    write_model(tmp_path / "parameters.onnx", metadata(geometry=geometry))
    assert call(tmp_path, tmp_path / "out", "--no-overlay", clips=str(real_data / "cholecseg8k")) == 0
    status = {int(row["frame"]): row["status"] for row in rows(tmp_path / "out" / "video01_00080")}
    assert sorted(status) == list(range(80, 160))
    assert {status[number] for number in range(80, 149)} == {"no_tool"}
    assert sum(status[number] == "ok" for number in range(149, 160)) >= 9


def test_a_known_force_tells_newtons(synthetic, tmp_path):
    truth = json.loads((synthetic / "video01_00000" / "truth.json").read_text(encoding="utf-8"))
    known = f"force_N: 2.0\nforce_sd_N: 0.02\nforce_time_s: {truth['onset_s'] + 0.1}\n"
    (tmp_path / "known.yaml").write_text(known)
    given = ["--no-overlay", "--force-scale", str(tmp_path / "known.yaml")]
    arguments = [str(synthetic), "--output", str(tmp_path / "out"), "--onset", "stamp", *given, "--bag", "ros2"]
    assert infer.main(arguments) == 0
    folder = tmp_path / "out" / "video01_00000"
    (one,), (found,) = rows(folder, "calibrated.csv"), runs(folder)
    assert float(one["force"]) == pytest.approx(2.0, rel=1e-6)
    assert np.log(float(one["force_high"]) / float(one["force_low"])) == pytest.approx(2 * NINETY * 0.01, rel=1e-3)
    assert float(one["stiffness"]) == pytest.approx(2.0 / float(found["force"]) * float(found["stiffness"]), rel=1e-4)
    assert one["force_unit"].startswith("N, by known force of 2 N at frame")
    (press,) = json.loads((folder / "forces.json").read_text(encoding="utf-8"))["contacts"]
    assert [press[f"peak{end}"] for end in ("", "_low", "_high")] == pytest.approx(
        [float(one[f"force{end}"]) for end in ("", "_low", "_high")], rel=1e-6
    )
    assert press["unit"] == one["force_unit"]
    said = read_messages(folder / "forces.mcap")
    for end in ("", "_low", "_high"):
        forces = [(stamp / 1e9, float(np.linalg.norm(force))) for _, stamp, _, force, _ in said[f"/palpate/force{end}"]]
        times = zip(press["time_s"], press[f"force{end}"], strict=True)
        assert np.array(forces) == pytest.approx(np.array([pair for pair in times if pair[1] is not None]))
    assert record(folder)["calibration"]["scale"]["source"] in one["force_unit"]


@pytest.mark.parametrize(
    ("known", "options", "said"),
    [
        ("force_N: 2.0", (), "known.yaml can't be used: force_N and force_time_s belong together"),
        ("force_N: 2.0\nforce_time_s: 1.0", (), "tells of a force in one clip, and there are 2; give that alone."),
        (
            "stiffness: 2.0",
            ("--estimator", "online"),
            "--force-scale needs a force, which --estimator online does not give; choose another",
        ),
    ],
)
def test_a_calibration_that_can_t_be_used_is_wrong_usage(known, options, said, inputs, tmp_path, capsys):
    (tmp_path / "known.yaml").write_text(known)
    given = [str(inputs / "clips"), "--output", str(tmp_path / "out"), "--force-scale", str(tmp_path / "known.yaml")]
    assert infer.main([*given, *options]) == 2
    assert said in flat(capsys.readouterr().err)


def test_a_shaft_s_diameter_tells_newtons_a_metre_and_millimetres(synthetic, tmp_path):
    """The drawn shaft's radius is `SHAFT_RADIUS` scene units; its length enters with its uncertainty."""
    truth = json.loads((synthetic / "video01_00000" / "truth.json").read_text(encoding="utf-8"))
    (tmp_path / "known.yaml").write_text(f"force_N: 2.0\nforce_time_s: {truth['onset_s'] + 0.1}\n")
    given = ["--no-overlay", "--force-scale", str(tmp_path / "known.yaml"), "--shaft-diameter", "8"]
    assert infer.main([str(synthetic), "--output", str(tmp_path / "out"), "--onset", "stamp", *given]) == 0
    folder = tmp_path / "out" / "video01_00000"
    (found,) = runs(folder)
    scale = record(folder)["scale"]
    assert scale["mm"] == pytest.approx(4 / SHAFT_RADIUS, rel=0.05)
    assert scale["mm_low"] < 4 / SHAFT_RADIUS < scale["mm_high"]
    assert record(folder)["units"]["length"].endswith("metric by a shaft of 8 mm")
    (row,) = rows(folder, "calibrated.csv")
    assert row["stiffness_unit"].endswith("metric by a shaft of 8 mm")
    assert row["stiffness_unit"].startswith("N/m, by known force of 2 N at frame")
    assert "shaft" not in row["force_unit"]
    newtons = 2.0 / float(found["force"]) * float(found["stiffness"])
    assert float(row["stiffness"]) == pytest.approx(newtons / (scale["mm"] / 1000), rel=1e-3)
    log_sd, own = (
        math.log(float(each[f"{name}_high"]) / float(each[f"{name}_low"])) / (2 * NINETY)
        for each, name in ((row, "stiffness"), (found, "force_over_stiffness"))
    )
    length = math.log(scale["mm_high"] / scale["mm_low"]) / (2 * NINETY)
    assert length > 0.01
    assert log_sd == pytest.approx(math.hypot(own, length), rel=0.01)
    (press,) = json.loads((folder / "forces.json").read_text(encoding="utf-8"))["contacts"]
    expected = float(found["force_over_stiffness"]) * scale["mm"]
    assert press["force_over_stiffness_mm"] == pytest.approx(expected, rel=1e-3)
    spread = math.log(press["force_over_stiffness_mm_high"] / press["force_over_stiffness_mm_low"]) / (2 * NINETY)
    assert spread == pytest.approx(math.hypot(own, length), rel=0.01)
    assert press["metric_by"] == "a shaft of 8 mm"


def test_a_shaft_that_is_not_seen_or_not_asked_for_is_said(inputs, tmp_path, capsys):
    assert call(inputs, tmp_path / "out", "--no-overlay", "--shaft-diameter", "5", clips="clips/drawn.mp4") == 0
    assert record(tmp_path / "out" / "drawn")["scale"]["mm"] is None
    assert "--shaft-diameter tells no millimetres: in no frame are two straight edges" in flat(capsys.readouterr().err)
    camera = {"fx": 150.0, "fy": 150.0, "cx": 63.5, "cy": 35.5, "width": 128, "height": 72}
    (tmp_path / "camera.json").write_text(json.dumps(camera | {"metres_per_depth": 0.1, "metres_per_depth_sd": 0.01}))
    given = ["--no-overlay", "--camera", str(tmp_path / "camera.json")]
    assert call(inputs, tmp_path / "told", *given, clips="clips/folder") == 0
    scale = record(tmp_path / "told" / "folder")["scale"]
    assert (scale["by"], scale["mm"]) == ("the camera file", pytest.approx(100 * scale["depth_at_1"]))
    assert math.log(scale["mm_high"] / scale["mm"]) == pytest.approx(0.1 * NINETY)
    assert call(inputs, tmp_path / "both", *given, "--shaft-diameter", "5", clips="clips/folder") == 1
    assert "--shaft-diameter has no effect where the camera file tells metres; leave it out" in flat(
        capsys.readouterr().err
    )


@pytest.mark.parametrize("metres", [100.0, 1e-4])
def test_a_camera_file_in_another_unit_than_metres_is_a_sentence(metres, inputs, tmp_path, capsys):
    camera = {"fx": 150.0, "fy": 150.0, "cx": 63.5, "cy": 35.5, "width": 128, "height": 72, "metres_per_depth": metres}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    given = ["--no-overlay", "--camera", str(tmp_path / "camera.json")]
    assert call(inputs, tmp_path / "out", *given, clips="clips/folder") == 1
    said = flat(capsys.readouterr().err)
    assert f"folder: by metres_per_depth {metres:g} tissue is" in said
    assert "m away; give metres." in said


# --- several clips at once, and shares of them ---


@pytest.fixture(scope="module")
def named_alike(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips of one name and a file that is no video."""
    folder = tmp_path_factory.mktemp("several")
    write_clip(folder / "a" / "clip", 8, 4)
    write_clip(folder / "b" / "clip", 7, 3)
    (folder / "broken.mp4").write_bytes(b"no video")
    return folder


def several(named_alike: Path, inputs: Path, output: Path, *options: str) -> int:
    return call(inputs, output, "--no-overlay", *options, clips=str(named_alike))


def tables(output: Path) -> dict[str, bytes]:
    return {name: content for name, content in contents(output).items() if name.endswith(".csv")}


@pytest.fixture(scope="module")
def one_by_one(named_alike: Path, inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Tables of these clips by a single process."""
    output = tmp_path_factory.mktemp("serial")
    assert several(named_alike, inputs, output) == 1
    return tables(output)


def test_clips_at_once_give_the_same_tables_and_one_that_fails_is_named(
    named_alike, inputs, one_by_one, tmp_path, capsys
):
    assert len(one_by_one) == 4
    assert len(set(one_by_one.values())) > 2  # the clips differ
    assert several(named_alike, inputs, tmp_path, "--jobs", "2") == 1
    assert tables(tmp_path) == one_by_one
    said = capsys.readouterr()
    assert said.err.count("failed: ") == 1
    assert "broken.mp4" in said.err
    assert said.out.count("done") == 2
    for name in clips_in(tmp_path):
        assert record(tmp_path / name)["providers"] == {"estimator": "CPUExecutionProvider"}
    before = contents(tmp_path)
    assert several(named_alike, inputs, tmp_path) == 1
    assert capsys.readouterr().err.count("up to date") == 2
    assert contents(tmp_path) == before


def test_interrupted_workers_leave_finished_clips_alone(named_alike, inputs, one_by_one, tmp_path, monkeypatch, capsys):
    def interrupted(*tasks, **options):
        with contextlib.closing(run_tasks(*tasks, **options)) as results:
            yield next(results)
            raise KeyboardInterrupt

    (tmp_path / "only").mkdir()
    for name in ("a", "b"):
        shutil.copytree(named_alike / name / "clip", tmp_path / "only" / name)
    with monkeypatch.context() as patch:
        patch.setattr("palpate.results.run.run_tasks", interrupted)
        assert several(tmp_path / "only", inputs, tmp_path / "out", "--jobs", "2") == 130
    assert "1 of 2 clips are complete; run the same command to continue" in capsys.readouterr().err
    assert set(clips_in(tmp_path / "out")) <= {
        "a",
        "b",
    }  # a second may have been done as well; nothing half done is left
    assert several(tmp_path / "only", inputs, tmp_path / "out") == 0
    assert clips_in(tmp_path / "out") == ["a", "b"]
    assert sorted(tables(tmp_path / "out").values()) == sorted(one_by_one.values())


def test_two_workers_of_a_scheduler_give_the_same_tables(
    named_alike, inputs, one_by_one, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = ["--scheduler", cluster.scheduler_address]
        assert several(named_alike, inputs, Path("out"), *address) == 1
        assert several(named_alike, inputs, Path("out"), *address, "--jobs", "2") == 2
    assert tables(tmp_path / "out") == one_by_one
    said = capsys.readouterr()
    assert (said.out.count("done"), said.err.count("failed: ")) == (2, 1)
    assert "leave one of them out" in said.err


def test_a_scheduler_that_cannot_be_used_is_said(named_alike, inputs, tmp_path, monkeypatch, capsys):
    assert several(named_alike, inputs, tmp_path, "--scheduler", "tcp://127.0.0.1:9") == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in flat(capsys.readouterr().err)
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster:
        assert several(named_alike, inputs, tmp_path, "--scheduler", cluster.scheduler_address) == 2
    assert "has workers of 2 threads" in flat(capsys.readouterr().err)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert several(named_alike, inputs, tmp_path, "--scheduler", "tcp://127.0.0.1:9") == 2
    assert "install 'palpate[distributed]'" in flat(capsys.readouterr().err)


def test_a_device_that_is_not_there_is_wrong_usage(inputs, tmp_path, capsys):
    """Whichever network would run on it."""
    missing = next(
        name for name in ("openvino", "cuda") if PROVIDERS[name] not in onnxruntime.get_available_providers()
    )
    said = f"device {missing} is not in this onnxruntime; install onnxruntime-{missing.replace('cuda', 'gpu')},"
    masks = ["--estimator", "direct", "--depth", "stored", "--masks", str(save_model(tmp_path / "m.onnx", BOTH))]
    for options in ([], masks):
        model = [] if options else ["--model", str(inputs / "parameters.onnx")]
        arguments = [str(inputs / "clips"), "--output", str(tmp_path / "out"), "--device", missing]
        assert infer.main([*arguments, *options, *model]) == 2
        assert said in flat(capsys.readouterr().err)


def test_every_network_runs_where_and_as_wide_as_was_asked_and_the_record_says_so(inputs, tmp_path, monkeypatch):
    opened, threads = onnxruntime.InferenceSession, []

    def noted(model, options, **others):
        threads.append(options.intra_op_num_threads)
        return opened(model, options, **others)

    monkeypatch.setattr(onnxruntime, "InferenceSession", noted)
    masks = str(save_model(tmp_path / "m.onnx", BOTH))
    options = ("--no-overlay", "--threads", "1", "--depth", "photometric", "--masks", masks, "--device", "cpu")
    assert call(inputs, tmp_path / "out", *options, clips="clips/folder") == 0
    found = record(tmp_path / "out" / "folder")["providers"]
    assert found == dict.fromkeys(("estimator", "masks"), "CPUExecutionProvider")
    assert set(threads) == {1}


def test_a_killed_worker_fails_what_is_left_and_keeps_the_rest(named_alike, inputs, tmp_path, monkeypatch, capsys):
    def lost(function, tasks, *_, **__):
        yield function(tasks[0])
        raise WorkerLost("A worker process was killed, maybe for want of memory; use fewer workers or jobs.")

    monkeypatch.setattr("palpate.results.run.run_tasks", lost)
    assert several(named_alike, inputs, tmp_path, "--jobs", "2") == 1
    assert capsys.readouterr().err.count("maybe for want of memory; use fewer workers or jobs.") == 2
